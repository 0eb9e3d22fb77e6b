"""Objectives and constraints of tuning: statistics of a figure over the sampled plants, and bounds on them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.batch.columns import Column
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.common.units import plain, to_unit
from dmframe.diagram import Diagram

EFFORT: Final = "effort"
"""Figure of the servo's voltages: Euclidean norm of their RMS in the last eighth."""
CONDITIONS, EVERYWHERE, PERIOD = "conditions", "conditions everywhere", "stable period"
_FORM: Final = re.compile(r"(?:(worst|median|mean)|quantile\s+([0-9.]+))\s+([^\s<>=]+)")
_LIMIT: Final = re.compile(r"(.+?)\s*(<=|>=|<|>)\s*(.+)")
_NOT_NEGATIVE: Final = re.compile(r"(rms|turn)_(\d|final)|(error|turn)_most|diverged|.*\.(rms_final|peak)|effort")
_KINDS: Final = {"rms_final": ("rms_final",), "peak": ("least", "most"), "most": ("most",)}
"""Figures of a signal with statistics, and the columns that they need."""
_OTHER: Final = ("diverged_at", "error_crossed", "turn_crossed")
"""Columns without statistics: most runs have no value there."""


@final
@dataclass(frozen=True)
class Statistic:
    """A statistic of a figure over a family of runs.

    Parameters
    ----------
    text
        In the study's file, ``worst rms_final``.
    probability
        Probability of the quantile: 1 for the worst, 0.5 for the median; None for the mean.
    figure
        Name of the figure, or `EFFORT`.
    columns
        Columns of the table; RMS values of a signal's rows are combined by their norm, other figures by their maximum.
    unit
        Unit of the figure.
    """

    text: str
    probability: float | None
    figure: str
    columns: tuple[str, ...]
    unit: str

    def figures(self, rows: Mapping[str, Any]) -> np.ndarray:
        """The figure of each run; infinite for a run that diverged or could not be prepared."""
        data = np.stack([np.asarray(rows[name], dtype=float) for name in self.columns])
        if self.figure.endswith("rms_final") or self.figure == EFFORT:
            found = np.sqrt((data**2).sum(axis=0)) if len(data) > 1 else data[0]
        else:
            found = (np.abs(data) if self.figure.endswith(".peak") else data).max(axis=0)
        if self.figure == "diverged":
            return np.asarray(np.where([fault is not None for fault in rows["fault"]], 1.0, found))
        lost = np.asarray(rows["diverged"], dtype=bool) | ~np.isfinite(found)
        return np.where(lost, np.inf, found)

    def of(self, figures: np.ndarray) -> float:
        """The statistic over all runs of the family."""
        return self.at_least(figures, len(figures))

    def at_least(self, figures: np.ndarray, runs: int) -> float:
        """Lower bound of the statistic over `runs` runs if only these figures are known."""
        rest, floor = runs - len(figures), 0.0 if _NOT_NEGATIVE.fullmatch(self.figure) else -math.inf
        if self.probability is None:
            return float((figures.sum() + (rest * floor if rest else 0.0)) / runs)
        place = max(math.ceil(self.probability * runs - 1e-9), 1) - 1 - rest
        return float(np.sort(figures)[place]) if place >= 0 else floor

    def shown(self, value: float) -> str:
        """A value with its unit."""
        return plain(value, self.unit, 4) if math.isfinite(value) else "diverged"


@final
@dataclass(frozen=True)
class Bound:
    """A constraint: a statistic at most a limit or, with `above`, at least."""

    statistic: Statistic
    limit: float
    above: bool

    @property
    def text(self) -> str:
        """The constraint in words."""
        return f"{self.statistic.text} {'>=' if self.above else '<='} {plain(self.limit, self.statistic.unit, 4)}"

    def violation(self, value: float) -> float:
        """Violation relative to the limit; at most zero if the constraint holds."""
        beyond = self.limit - value if self.above else value - self.limit
        return min(beyond / (abs(self.limit) or 1.0), 1e6)

    def broken(self, figures: np.ndarray, runs: int) -> bool:
        """True if the figures of some runs prove that the constraint fails over all."""
        return not self.above and self.statistic.at_least(figures, runs) > self.limit


def signals_of(text: str) -> list[str]:
    """The signals whose figures a statistic or a bound needs, ``servo.u`` for ``worst servo.u[0].most``."""
    found = _FORM.match(text)
    name = found[3] if found else ""
    signal, _, figure = name.rpartition(".")
    return [signal.partition("[")[0]] if figure in _KINDS and signal else []


def efforts(diagram: Diagram) -> list[str]:
    """Labels of the plant's voltages."""
    return [
        signal.label
        for signal in diagram.loop.outputs
        if signal.unit == "V" and signal.shape == "n" and diagram.blocks[signal.block].side is Side.PLANT
    ]


def statistic(text: str, columns: Sequence[Column], diagram: Diagram) -> Statistic:
    """Parse a statistic of the table's columns.

    Raises
    ------
    ValueFault, UnknownNameError
        The text is not a statistic, or names an unknown figure.
    """
    found = _FORM.fullmatch(text.strip())
    if not found:
        raise ValueFault(
            f"expected worst, median, mean or quantile 0.95 and a figure, such as worst rms_final, found {text!r:.60}"
        )
    word, quantile, figure = found.groups()
    probability = {"worst": 1.0, "median": 0.5, "mean": None}[word] if word else _probability(quantile)
    names, unit = _columns(figure, columns, diagram)
    return Statistic(text.strip(), probability, figure, names, unit)


def bound(text: str, columns: Sequence[Column], diagram: Diagram) -> Bound:
    """Parse a constraint. Raises as `statistic` does, and for a limit with the wrong unit."""
    found = _LIMIT.fullmatch(text.strip())
    if not found:
        known = f"{CONDITIONS}, {EVERYWHERE}, {PERIOD} >= 10 ms, or worst rms_final <= 5 mm"
        raise ValueFault(f"expected {known}, found {text!r:.60}")
    of = statistic(found[1], columns, diagram)
    return Bound(of, to_unit(found[3], of.unit), found[2].startswith(">"))


def least_period(text: str) -> float | None:
    """Period of ``stable period >= 10 ms`` [s]; None for another constraint. Raises `UnitError` and `ValueFault`."""
    found = _LIMIT.fullmatch(text.strip())
    if not text.strip().startswith(PERIOD):
        return None
    if not found or found[1] != PERIOD or not found[2].startswith(">"):
        raise ValueFault(f"expected {PERIOD} >= 10 ms, found {text!r:.60}")
    return to_unit(found[3], "s")


def _probability(text: str) -> float:
    try:
        probability = float(text)
    except ValueError:
        probability = math.nan
    if not 0 < probability <= 1:
        raise ValueFault(f"expected a quantile between 0 and 1, found {text}")
    return probability


def _columns(figure: str, columns: Sequence[Column], diagram: Diagram) -> tuple[tuple[str, ...], str]:
    units = {column.name: column.unit for column in columns}
    if figure == EFFORT:
        labels = efforts(diagram)
        if not labels:
            raise ValueFault(f"{EFFORT}: the plant has no voltages; name a signal's figure, block.signal.rms_final")
        rows = "|".join(map(re.escape, labels))
        return tuple(name for name in units if re.fullmatch(rf"({rows})(\[\d+\])?\.rms_final", name)), "V"
    signal, _, kind = figure.rpartition(".")
    if not signal and figure in units and figure not in _OTHER:
        return (figure,), units[figure]
    ends = "|".join(_KINDS.get(kind, ()))
    names = [name for name in units if ends and re.fullmatch(rf"{re.escape(signal)}(\[\d+\])?\.({ends})", name)]
    if not names:
        figures = [name for name in units if "." not in name and name not in _OTHER]
        wholes = {re.sub(r"(\[\d+\])?\.\w+$", "", name) for name in units if "." in name}
        of_signals = [f"{whole}.{end}" for whole in wholes for end in _KINDS]
        raise UnknownNameError(figure, "figure", figure, [*figures, *of_signals, EFFORT])
    return tuple(names), units[names[0]]


def at_path(error: DmframeError, path: tuple[str | int, ...]) -> DmframeError:
    """The fault with its place in the study's file."""
    error.path = path
    error.text = f"{'.'.join(map(str, path[:2]))}: {error.text}"
    return error
