"""Protocol of a race: tuning on training cells, choice of values, and comparison on held-out cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import DisagreementError
from dmframe.race.compute import Errors
from dmframe.race.plan import Cell, Race, Run, Values
from dmframe.study.statistics import quantile

RESAMPLES: Final = 2000
LEVEL: Final = 0.95
"""Confidence level of the bootstrap intervals."""
QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
LEAST: Final = 1e-9
"""Lower limit of errors, for a finite logarithm [mm]."""


@final
@dataclass(frozen=True)
class Tried:
    """Result of a candidate on the training cells.

    Parameters
    ----------
    score
        Mean over the training cells of the logarithm of the error in mm; infinite if it is rejected.
    why
        Reason of the rejection; empty if there is none.
    """

    values: Values
    score: float
    why: str


@final
@dataclass(frozen=True)
class Choice:
    """Results of the candidates of a law at a sampling period, in their order."""

    law: str
    clock: float
    tried: tuple[Tried, ...]

    @property
    def best(self) -> Tried | None:
        """First candidate with the lowest score; None if all are rejected."""
        found = min(self.tried, key=lambda each: each.score)
        return found if math.isfinite(found.score) else None


def tuning_runs(race: Race) -> list[Run]:
    """Runs of all candidates of all laws on the training cells, with and without the margins."""
    return [
        run
        for law in race.file.laws
        for clock in race.file.clocks
        for values in race.candidates(law, clock)
        for run in race.trials(law, clock, values)
    ]


def chosen(race: Race, errors: Errors) -> list[Choice]:
    """Choose the parameter values of each law at each sampling period.

    A candidate is rejected if it diverges on a training cell, without or with the margins. Of the others, that with the
    least mean of log error over the training cells wins, without the margins: the median over cells with and without
    noise would depend on the two cells in the middle only.

    Raises
    ------
    DisagreementError
        A law has no error for one of the runs that the protocol prescribes.
    """
    found = list[Choice]()
    for law in race.file.laws:
        for clock in race.file.clocks:
            tried = [_tried(race, law, clock, values, errors) for values in race.candidates(law, clock)]
            found.append(Choice(law, clock, tuple(tried)))
    return found


def _tried(race: Race, law: str, clock: float, values: Values, errors: Errors) -> Tried:
    runs = list(race.trials(law, clock, values))
    if absent := [run for run in runs if run not in errors]:
        raise DisagreementError(
            f"{law} was not tuned by the protocol: its candidate {dict(values)} has no run in the training cell "
            f"{absent[0].cell.name}{', with margins' if absent[0].margin else ''}"
        )
    lost = [run for run in runs if not math.isfinite(errors[run])]
    if lost:
        how = "with the margins" if lost[0].margin else "as it is"
        return Tried(values, math.inf, f"diverges {how} in {lost[0].cell.name}")
    return Tried(values, float(np.mean([math.log(max(errors[run], LEAST)) for run in runs if not run.margin])), "")


def judged_runs(race: Race, choices: Sequence[Choice]) -> list[Run]:
    """Runs of each law with its chosen values on the held-out cells; none for a law without an accepted candidate."""
    best = {(choice.law, choice.clock): choice.best for choice in choices}
    found = list[Run]()
    for cell in race.held_out:
        for law in race.file.laws:
            if (tried := best[law, cell.clock]) is not None:
                found.append(Run(law, cell, tried.values, race.file.seed + 1))
    return found


@final
@dataclass(frozen=True)
class Row:
    """Errors of the entrant and its rivals in a cell [mm]; infinite for a law that diverged or has no values."""

    cell: Cell
    law: str
    errors: Mapping[str, float]

    @property
    def error(self) -> float:
        """Error of the entrant."""
        return self.errors[self.law]

    @property
    def best_rival(self) -> str:
        """Rival with the lowest error."""
        rivals = [law for law in self.errors if law != self.law]
        return min(rivals, key=lambda law: self.errors[law])

    @property
    def rival_error(self) -> float:
        """Error of the best rival."""
        return self.errors[self.best_rival]

    @property
    def ratio(self) -> float:
        """Ratio of the error of the entrant to that of the best rival; infinite if the entrant diverged."""
        if math.isinf(self.error) or math.isinf(self.rival_error):
            return math.inf if math.isinf(self.error) else 0.0
        return self.error / self.rival_error if self.rival_error else math.inf

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON; null instead of an infinite number."""
        numbers = {"error": self.error, "rival_error": self.rival_error, "ratio": self.ratio}
        plain = {key: value if math.isfinite(value) else None for key, value in numbers.items()}
        row = {"cell": self.cell.name, "law": self.law, "error": plain["error"], "best_rival": self.best_rival}
        return {**row, "rival_error": plain["rival_error"], "ratio": plain["ratio"]}


def rows_of(race: Race, errors: Errors) -> list[Row]:
    """Comparison on each held-out cell."""
    found = {cell: dict.fromkeys(race.file.laws, math.inf) for cell in race.held_out}
    for run, error in errors.items():
        found[run.cell][run.law] = error
    return [Row(cell, race.file.entrant, by_law) for cell, by_law in found.items()]


@final
@dataclass(frozen=True)
class Spread:
    """Quantiles, and the bootstrap interval [low, high] of the median over cells."""

    quantiles: Mapping[float, float]
    low: float
    high: float

    @property
    def median(self) -> float:
        """The median."""
        return self.quantiles[0.5]


def spread(values: Sequence[float], seed: int) -> Spread:
    """Quantiles as order statistics, and the percentile bootstrap interval of the median.

    The median of an even number is the geometric mean of the two in the middle, infinite if one of them is. The
    interval takes the cells as independent draws. They share plants and paths, so it is too short for new ones.
    """
    found = np.asarray(values, dtype=float)
    draws = np.random.default_rng(seed).integers(0, found.size, (RESAMPLES, found.size))
    medians = _medians(found[draws])
    low, high = (quantile(medians, p, independent=False).value for p in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    quantiles = {p: quantile(found, p, independent=False).value for p in QUANTILES}
    return Spread(quantiles | {0.5: float(_medians(found))}, low, high)


def _medians(values: np.ndarray) -> np.ndarray:
    """Median along the last axis, of the logarithms."""
    ordered, count = np.sort(values, axis=-1), values.shape[-1]
    lower, upper = ordered[..., (count - 1) // 2], ordered[..., count // 2]
    product = np.prod([np.where(np.isfinite(each), each, 0) for each in (lower, upper)], axis=0)
    return np.where(np.isfinite(upper) & (lower < upper), np.sqrt(product), upper)
