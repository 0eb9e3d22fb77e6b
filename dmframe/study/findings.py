"""Findings of a study for its report: proportions, quantiles, comparisons, influences and maps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.common.units import plain, to_unit
from dmframe.study.results import Results
from dmframe.study.sheet import LEAST, Sheet, is_time
from dmframe.study.statistics import (
    FEWEST,
    Influence,
    Map,
    Paired,
    Proportion,
    Quantile,
    adjusted,
    influence,
    map_of,
    paired,
    proportion,
    quantile,
)

DIVERGED: Final = "diverged"
EIGHTHS: Final = tuple(f"rms_{k}" for k in range(1, 9))
TURNED: Final = "turn_final"
"""Error of the tool's orientation, reported in addition to that of its position."""
SHOWN: Final = 6
"""Grid points with influences, maps and curves in the report."""
_EVENT: Final = re.compile(r"\s*(\S+)\s*(<=|>=|<|>)\s*(.+?)\s*")


@final
@dataclass(frozen=True)
class Event:
    """An event with an estimated probability: divergence, or a figure beyond a limit.

    A run that diverged is beyond every limit: its figure is infinite. A run without the figure is not counted.
    """

    figure: str
    above: bool = True
    limit: float = 0.0
    unit: str = ""

    @property
    def name(self) -> str:
        """The event in words."""
        if self.figure == DIVERGED:
            return DIVERGED
        return f"{self.figure} {'>' if self.above else '<'} {plain(self.limit, self.unit, 6)}"

    def happened(self, sheet: Sheet) -> np.ndarray:
        """(points, samples) bool."""
        if self.figure == DIVERGED:
            return sheet.diverged
        values = sheet.figure(self.figure)
        return np.asarray(values > self.limit if self.above else values < self.limit)

    def known(self, sheet: Sheet) -> np.ndarray:
        """(points, samples) bool: the runs for which the event is defined."""
        return sheet.done if self.figure == DIVERGED else ~np.isnan(sheet.figure(self.figure))


def event_of(text: str, units: Mapping[str, str]) -> Event:
    """``diverged``, or a figure with its limit: ``error_most > 5 mm``. Raises `DmframeError`."""
    if text.strip() == DIVERGED:
        return Event(DIVERGED)
    where = f"report.probability {text!r:.60}"
    found = _EVENT.fullmatch(text)
    if found is None:
        raise ValueFault(f"{where}: expected diverged, or a figure and a limit such as 'error_most > 5 mm'")
    figure, sign, limit = found.groups()
    if figure not in units:
        raise UnknownNameError(where, "figure", figure, units)
    try:
        number = to_unit(limit, units[figure])
    except DmframeError as error:
        raise ValueFault(f"{where}: {error.text}") from None
    return Event(figure, sign[0] == ">", number, units[figure])


@final
@dataclass(frozen=True)
class PointFindings:
    """Findings at one grid point.

    Parameters
    ----------
    runs, failed, missing
        Numbers of completed runs, of runs that could not be prepared, and of runs that have not been computed.
    alone, together
        Proportion of each event, with intervals for this point, and with intervals that hold at all points at once.
    quantiles
        By figure.
    eighths
        Quantiles of the error's RMS in each eighth: rows 5, 50 and 95 %; empty if it is not measured.
    influences
        By figure, and `DIVERGED`: of each sampled factor, the largest first.
    """

    index: int
    name: str
    runs: int
    failed: int
    missing: int
    alone: tuple[Proportion, ...]
    together: tuple[Proportion, ...]
    quantiles: Mapping[str, tuple[Quantile, ...]]
    eighths: np.ndarray
    influences: Mapping[str, tuple[Influence, ...]]


@final
@dataclass(frozen=True)
class Compared:
    """Comparison of a grid point with the first, on the same samples: the main figure, and divergence."""

    index: int
    name: str
    figure: Paired
    only_here: int
    only_there: int
    p: float | None


@final
@dataclass(frozen=True)
class PointMap:
    """A map of one grid point, or of all if one of its axes is a grid quantity."""

    x: str
    y: str
    name: str
    map: Map


@final
@dataclass(frozen=True, repr=False)
class Findings:
    """Findings at all grid points."""

    results: Results
    sheet: Sheet
    events: tuple[Event, ...]
    points: tuple[PointFindings, ...]
    comparisons: tuple[Compared, ...]
    maps: tuple[PointMap, ...]

    @property
    def steady(self) -> list[PointFindings]:
        """The points with runs, none of which diverged."""
        place = [event.figure for event in self.events].index(DIVERGED)
        return [found for found in self.points if found.runs and not found.alone[place].count]

    @property
    def diverging(self) -> Event:
        """The event of divergence."""
        return next(event for event in self.events if event.figure == DIVERGED)


def findings_of(results: Results) -> Findings:
    """Read a table and compute its findings.

    Raises
    ------
    DmframeError
        The report names a figure that is not measured, or a quantity that does not vary; all such faults at once.
    """
    section, units, main = results.study.file.report, results.units, results.main
    there, measured = set(results.frame.collect_schema()), [column.name for column in results.study.measures]
    faults = list[DmframeError]()
    events = list[Event]()
    for text in dict.fromkeys((DIVERGED, *section.probability)):
        try:
            events.append(event_of(text, {key: units[key] for key in measured if key in there}))
        except DmframeError as error:
            faults.append(error)
    varied = [column.name for column in results.study.varied]
    for pair in section.map:
        faults += [
            UnknownNameError(f"report.map {list(pair)}", "varied quantity", n, varied) for n in pair if n not in varied
        ]
    turned = [TURNED] if TURNED in measured else []
    figures = [name for name in dict.fromkeys((main, *turned, *section.worst)) if name in there and not is_time(name)]
    raise_all(faults)
    names = [*figures, *(event.figure for event in events if event.figure != DIVERGED), *varied, *EIGHTHS]
    sheet = results.sheet(*(name for name in dict.fromkeys(names) if name in there))
    return Findings(
        results,
        sheet,
        tuple(events),
        tuple(_found(results, sheet, events, figures, k) for k in range(sheet.points)),
        _compared(results, sheet) if main else (),
        tuple(_maps(results, sheet)) if main else (),
    )


def _found(results: Results, sheet: Sheet, events: Sequence[Event], figures: Sequence[str], k: int) -> PointFindings:
    independent = results.independent
    happened = [event.happened(sheet)[k][event.known(sheet)[k]] for event in events]
    values = {figure: sheet.of(k, sheet.figure(figure)) for figure in figures}
    values = {figure: column[~np.isnan(column)] for figure, column in values.items()}
    ps = results.study.file.report.quantiles if sheet.samples > 1 else ()
    return PointFindings(
        k,
        results.names[k],
        int(sheet.done[k].sum()),
        int(sheet.failed[k].sum()),
        int((~sheet.done[k] & ~sheet.failed[k]).sum()),
        tuple(proportion(each, independent=independent) for each in happened),
        tuple(proportion(each, independent=independent, together=sheet.points) for each in happened),
        {
            figure: tuple(quantile(column, p, independent=independent) for p in ps)
            for figure, column in values.items()
            if len(column)
        },
        _eighths(sheet, k),
        _influences(results, sheet, k) if k < SHOWN else {},
    )


def _eighths(sheet: Sheet, k: int) -> np.ndarray:
    """(3, 8): quantiles 5, 50 and 95 % of the error's RMS in each eighth; infinite for runs that diverged before."""
    if any(name not in sheet.columns for name in EIGHTHS) or not sheet.done[k].any():
        return np.empty((3, 0))
    values = np.stack([sheet.of(k, sheet.columns[name]) for name in EIGHTHS])
    lost = sheet.of(k, sheet.diverged)
    values = np.where(np.isnan(values) & lost, np.inf, values)
    if np.isnan(values).any():
        return np.empty((3, 0))
    return np.asarray(np.quantile(values, [0.05, 0.5, 0.95], axis=1, method="inverted_cdf"))


def _influences(results: Results, sheet: Sheet, k: int) -> dict[str, tuple[Influence, ...]]:
    factors = [c.name for c in results.study.varied if c.kind == "sampled" and c.name in sheet.columns]
    targets = dict[str, np.ndarray]()
    if results.main:
        targets[results.main] = sheet.figure(results.main)[k] * (-1 if results.main.endswith(LEAST) else 1)
    lost = sheet.diverged[k].sum()
    if 0 < lost < sheet.done[k].sum():
        targets[DIVERGED] = np.where(sheet.done[k], sheet.diverged[k].astype(float), np.nan)
    found = dict[str, tuple[Influence, ...]]()
    for figure, values in targets.items():
        known = values[~np.isnan(values)]
        if len(np.unique(known)) < 2 or len(known) < FEWEST:
            continue  # no variation, or too few runs
        each = [influence(name, sheet.draws(name, k), values, independent=results.independent) for name in factors]
        ps = adjusted([item.chance for item in each])
        each = [
            Influence(item.factor, item.explained, None if item.p is None else p, p)
            for item, p in zip(each, ps, strict=True)
        ]
        if each:
            found[figure] = tuple(sorted(each, key=lambda item: -item.explained))
    return found


def _compared(results: Results, sheet: Sheet) -> tuple[Compared, ...]:
    if sheet.points < 2 or sheet.samples < 2:
        return ()
    values = sheet.figure(results.main) * (-1 if results.main.endswith(LEAST) else 1)
    ran = sheet.done[0] & sheet.done
    each = [paired(values[0], values[k], independent=results.independent) for k in range(1, sheet.points)]
    ps = adjusted([item.p if item.p is not None else 1.0 for item in each])
    return tuple(
        Compared(
            k,
            results.names[k],
            item,
            int((sheet.diverged[k] & ~sheet.diverged[0] & ran[k]).sum()),
            int((sheet.diverged[0] & ~sheet.diverged[k] & ran[k]).sum()),
            None if item.p is None else p,
        )
        for k, (item, p) in enumerate(zip(each, ps, strict=True), start=1)
    )


def _maps(results: Results, sheet: Sheet) -> list[PointMap]:
    grid = {column.name for column in results.study.varied if column.kind == "grid"}
    logs = {
        name: factor.spread is not None and factor.spread.kind == "log"
        for factor in results.study.factors
        for name in factor.columns
    }
    values, found = sheet.figure(results.main), list[PointMap]()
    for x, y in _pairs(results, sheet):
        if not {x, y} <= sheet.columns.keys():
            continue  # texts cannot be on an axis
        both = logs.get(x, False), logs.get(y, False)
        if {x, y} & grid:
            across, up = sheet.columns[x], sheet.columns[y]
            found.append(PointMap(x, y, "", map_of(across.ravel(), up.ravel(), values.ravel(), logs=both)))
            continue
        found += [
            PointMap(x, y, results.names[k], map_of(sheet.draws(x, k), sheet.draws(y, k), values[k], logs=both))
            for k in range(min(sheet.points, SHOWN))
        ]
    return found


def _pairs(results: Results, sheet: Sheet) -> Sequence[tuple[str, str]]:
    """The maps of the study's file; by default the two factors with the largest influence at the first point."""
    if results.study.file.report.map:
        return results.study.file.report.map
    if sheet.samples < 2:
        numbers = [c.name for c in results.study.varied if c.kind == "grid" and c.name in sheet.columns]
        return [(numbers[0], numbers[1])] if len(numbers) == 2 else []
    found = _influences(results, sheet, 0).get(results.main, ())
    return [(found[0].factor, found[1].factor)] if len(found) > 1 else []
