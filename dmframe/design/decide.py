"""Which law is handed over: the adaptive one only where it is clearly better than the best simple one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.race.protocol import Row
from dmframe.race.run import Finished

WORTH: Final = 0.8
"""Largest median ratio of the errors at which an adaptive law is worth its complexity."""
NEARLY: Final = 1.15
OFTEN: Final = 0.85
"""Least share of the cells in which its error is at most `NEARLY` of that of the simple law."""


@final
@dataclass(frozen=True)
class Candidate:
    """A tuned law.

    Parameters
    ----------
    errors
        On the held-out cells, in the unit of the race; infinite where it diverged.
    """

    law: str
    adaptive: bool
    values: Mapping[str, float]
    errors: Sequence[float]

    @property
    def error(self) -> float:
        """Median over the cells; infinite if it diverged in any of them."""
        return float(np.median(self.errors)) if np.all(np.isfinite(self.errors)) else math.inf

    @property
    def worst(self) -> float:
        """Largest error."""
        return max(self.errors)

    @property
    def score(self) -> float:
        """Mean logarithm of the errors."""
        return float(np.mean(np.log(np.maximum(self.errors, 1e-9)))) if math.isfinite(self.error) else math.inf


@final
@dataclass(frozen=True)
class Ranking:
    """All laws; those that did not diverge in order of their scores."""

    candidates: Sequence[Candidate]
    unit: str

    def best(self, *, adaptive: bool) -> Candidate | None:
        """The best law of a kind; None if each diverged somewhere."""
        return next(iter(self.ordered(adaptive=adaptive)), None)

    def including(self, candidate: Candidate) -> Ranking:
        """With another candidate of a law in place of the present one."""
        return Ranking([candidate if item.law == candidate.law else item for item in self.candidates], self.unit)

    def ordered(self, *, adaptive: bool) -> Iterator[Candidate]:
        """Laws of a kind that diverged in no cell, the best first."""
        able = (item for item in self.candidates if item.adaptive is adaptive and math.isfinite(item.score))
        yield from sorted(able, key=lambda item: item.score)


def ranked(finished: Finished, adaptive: Sequence[str]) -> Ranking:
    """The laws of a finished race; `adaptive` are the names of the adaptive ones."""
    values = {choice.law: dict(choice.best.values) for choice in finished.choices if choice.best is not None}
    file, rows = finished.race.file, finished.rows
    found = [Candidate(law, law in adaptive, values.get(law, {}), _errors(rows, law)) for law in file.laws]
    return Ranking(found, file.unit)


def _errors(rows: Sequence[Row], law: str) -> list[float]:
    return [row.errors[law] for row in rows]


def worth(candidate: Candidate, simple: Candidate | None) -> str:
    """Why an adaptive law is not worth it; empty if it is."""
    if simple is None:
        return ""
    ratios = np.array(candidate.errors) / np.maximum(simple.errors, 1e-12)
    median, often = float(np.median(ratios)), float(np.mean(ratios <= NEARLY))
    own = f"the error of {candidate.law}"
    if median > WORTH:
        return f"{own} is {median:.2g} of that of {simple.law} in the median, and at most {WORTH:g} is required"
    if often < OFTEN:
        return (
            f"{own} is at most {NEARLY:g} of that of {simple.law} in {100 * often:.0f} % of the cells, and "
            f"{100 * OFTEN:.0f} % are required"
        )
    return ""
