"""A study's table as matrices: a row per grid point, a column per sample."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.common.units import plain

if TYPE_CHECKING:
    import polars as pl

LEAST: Final = ".least"
"""Suffix of figures whose smallest value is the worst."""

TIMES: Final = ("diverged_at", "_crossed", ".crossed")
"""Suffixes of figures that are the time of an event, whose earliest value is the worst."""


def is_time(name: str) -> bool:
    """True for a figure that is the time of an event."""
    return name.endswith(TIMES)


def least_is_worst(name: str) -> bool:
    """True for a figure whose smallest value is the worst."""
    return name.endswith((LEAST, *TIMES))


@final
@dataclass(frozen=True, repr=False, eq=False)
class Sheet:
    """Some columns of a study's table.

    Parameters
    ----------
    done : (points, samples) bool
        The run is in the table, without a fault.
    failed : (points, samples) bool
        The run is in the table, with a fault.
    diverged : (points, samples) bool
    diverged_at : (points, samples) [s]
    columns
        Figures and factors of the table, (points, samples); NaN without a row. Texts are omitted.
    """

    done: np.ndarray
    failed: np.ndarray
    diverged: np.ndarray
    diverged_at: np.ndarray
    columns: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def points(self) -> int:
        """Number of grid points."""
        return len(self.done)

    @property
    def samples(self) -> int:
        """Samples at each grid point."""
        return int(self.done.shape[1])

    def figure(self, name: str) -> np.ndarray:
        """(points, samples): a figure, with the worst value for a run that diverged; nan for a run with a fault.

        The worst value is infinite, minus infinite for a `LEAST`. The time of an event that did not happen is infinite;
        a run that diverged exceeds every limit at that time.
        """
        values = np.where(self.done, self.columns[name], np.nan)
        if is_time(name):
            values = np.where(np.isnan(values) & self.diverged, self.diverged_at, values)
            return np.where(np.isnan(values) & self.done, np.inf, values)
        return np.where(self.diverged, -np.inf if name.endswith(LEAST) else np.inf, values)

    def draws(self, name: str, point: int) -> np.ndarray:
        """(samples,): values of a factor."""
        return np.asarray(self.columns[name][point])

    def of(self, point: int, values: np.ndarray) -> np.ndarray:
        """A row of a matrix, without runs with a fault."""
        return np.asarray(values[point][self.done[point]])


def sheet_of(frame: pl.LazyFrame, points: int, samples: int, names: Collection[str]) -> Sheet:
    """Read some columns of a table; one row per run, in any order.

    Raises
    ------
    ValueFault
        A run is twice in the table, or outside of the study.
    """
    import polars as pl

    schema = frame.collect_schema()
    numeric = [name for name in dict.fromkeys(names) if name in schema and schema[name].is_numeric()]
    wanted = [*dict.fromkeys(["point", "sample", "diverged", "diverged_at", *numeric])]
    failed = pl.col("fault").is_not_null() if "fault" in schema else pl.lit(False)
    table = frame.select(*wanted, failed.alias("failed")).collect()
    point, sample = (table[name].to_numpy() for name in ("point", "sample"))
    if len(table) and (point.max() >= points or sample.max() >= samples or point.min() < 0 or sample.min() < 0):
        raise ValueFault(
            f"runs: expected points below {points} and samples below {samples}, found point {point.max()} and "
            f"sample {sample.max()}; the table belongs to another study"
        )
    seen = np.bincount(point * samples + sample, minlength=points * samples) if len(table) else np.zeros(1)
    if seen.max() > 1:
        run = int(seen.argmax())
        raise ValueFault(f"runs: sample {run % samples} of point {run // samples} is {seen.max()} times in the table")

    def matrix(values: np.ndarray, empty: object) -> np.ndarray:
        found = np.full((points, samples), empty)
        found[point, sample] = values
        return found

    bad = table["failed"].to_numpy()
    lost = table["diverged"].fill_null(value=False).to_numpy() & ~bad
    return Sheet(
        matrix(~bad, empty=False),
        matrix(bad, empty=False),
        matrix(lost, empty=False),
        matrix(_floats(table["diverged_at"]), np.nan),
        {name: matrix(_floats(table[name]), np.nan) for name in numeric},
    )


def _floats(column: pl.Series) -> np.ndarray:
    import polars as pl

    return column.cast(pl.Float64).fill_null(float("nan")).to_numpy()


def names_of(values: Sequence[dict[str, Any]], units: Mapping[str, str], scales: Collection[str] = ()) -> list[str]:
    """Names of grid points from the values in which they differ, ``Gamma = 10, clock = 8 ms, servo x 3``.

    The values of `scales` are factors.
    """
    differ = [key for key in (values[0] if values else {}) if len({str(each.get(key)) for each in values}) > 1]
    keys = differ or list(values[0] if values else {})
    last = [key.rpartition(".")[2] for key in keys]
    short = {key: end if last.count(end) == 1 else key for key, end in zip(keys, last, strict=True)}

    def shown(key: str, value: Any) -> str:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return f"{short[key]} = {value}"
        return f"{short[key]} x {value:g}" if key in scales else f"{short[key]} = {plain(value, units.get(key, ''), 6)}"

    return [", ".join(shown(key, each.get(key)) for key in keys) for each in values]
