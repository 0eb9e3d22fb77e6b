"""The verdict on an adaptive law as data: errors of laws with intervals, an outcome and one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

WORTH_IT, NOT_WORTH_IT, UNDECIDED, BY_PATH, NOT_COMPUTED = (
    "worth it",
    "not worth it",
    "undecided",
    "depends on the path",
    "not computed",
)


@final
@dataclass(frozen=True)
class Judged:
    """One law on one path.

    Parameters
    ----------
    error, interval
        Median, and least and largest error over the draws [mm]; infinite for a run that diverged.
    values
        Tuned parameters.
    adaptive
        True for the law that is compared with the others.
    """

    law: str
    path: str
    error: float
    interval: tuple[float, float]
    values: Mapping[str, float]
    adaptive: bool

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON; null instead of an infinite number."""
        error, low, high = (value if math.isfinite(value) else None for value in (self.error, *self.interval))
        about = {"law": self.law, "path": self.path, "error": error, "interval": [low, high]}
        return about | {"values": dict(self.values), "adaptive": self.adaptive}

    def __str__(self) -> str:
        middle = f"{self.law} {millimetres(self.error)}{'' if math.isinf(self.error) else ' mm'}"
        return f"{middle}, {' to '.join(map(millimetres, self.interval))}"


@final
@dataclass(frozen=True)
class Verdict:
    """Whether the adaptive law is worth it.

    Parameters
    ----------
    sentence
        The answer in words.
    outcome
        worth it, not worth it, undecided, depends on the path, or not computed.
    laws
        Each law on each path, the best first.
    paths
        The paths as parameters of `epicycles`, by name.
    draws, clock, resolution
        Number of draws, sampling period of the controllers [s], and the position noise at the tool [mm].
    """

    sentence: str
    outcome: str = NOT_COMPUTED
    laws: Sequence[Judged] = ()
    paths: Mapping[str, Any] = field(default_factory=dict)
    draws: int = 0
    clock: float = 0.0
    resolution: float = 0.0

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        found: dict[str, Any] = {"sentence": self.sentence, "outcome": self.outcome}
        found |= {"laws": [judged.summary for judged in self.laws], "path": dict(self.paths), "draws": self.draws}
        return found | {"clock": self.clock or None, "resolution": self.resolution or None}


NOT_REQUESTED = Verdict("not computed: it was not requested")
INTERRUPTED = Verdict("not computed: it was interrupted")


def millimetres(value: float) -> str:
    """A length in mm, or that the run diverged."""
    return "diverged" if math.isinf(value) else f"{value:.2g}"
