"""Plots of a study: distributions, errors over the run, influences and maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from dmframe.common.plotting import COLUMN, GREY, PAGE, look, names_above, page, unit_text, verbatim
from dmframe.results.error_figure import log_ticks
from dmframe.results.plotting import shown_unit
from dmframe.study.findings import SHOWN, Findings, PointFindings, PointMap
from dmframe.study.statistics import Axis

MOST: Final = 1500
"""Largest number of points of a curve."""
BARS: Final = 40
"""Largest number of grid points in the plot of divergences."""
FACTORS: Final = 12


def figures_of(found: Findings) -> dict[str, Any]:
    """All plots that the findings allow, by file name."""
    made = {
        "divergence": divergence_figure(found),
        "distribution": distribution_figure(found),
        "eighths": eighths_figure(found),
        "influence": influence_figure(found),
        **{f"map_{place}": map_figure(found, maps) for place, maps in enumerate(grouped(found.maps), start=1)},
    }
    return {name: figure for name, figure in made.items() if figure is not None}


def grouped(maps: Sequence[PointMap]) -> list[list[PointMap]]:
    """Maps grouped by their two factors."""
    pairs = dict.fromkeys((each.x, each.y) for each in maps)
    return [[each for each in maps if (each.x, each.y) == pair] for pair in pairs]


def label(found: Findings, name: str) -> tuple[str, float]:
    """Label of an axis with its unit, and the factor to that unit."""
    column = next((each for each in found.results.study.varied if each.name == name), None)
    if column is not None and column.how == "scale":
        return f"{verbatim(name)}, factor", 1.0
    unit, factor = shown_unit(found.results.units.get(name, ""))
    return verbatim(name) + (f" [{unit_text(unit)}]" if unit != "1" else ""), factor


def divergence_figure(found: Findings) -> Any:
    """Proportion of runs that diverged at each grid point, with its interval; None for one point or no divergence."""
    place = found.events.index(found.diverging)
    points = [each for each in found.points if each.runs]
    if not 2 <= len(points) <= BARS or not any(each.alone[place].count for each in points):
        return None
    fractions = [each.alone[place] for each in points]
    with page(COLUMN, 0.7 + 0.2 * len(points)) as figure:
        axes = figure.subplots()
        for row, proportion in enumerate(fractions):
            if proportion.low is not None and proportion.high is not None:
                axes.plot(
                    [100 * proportion.low, 100 * proportion.high], [row, row], color=look(0)["color"], linewidth=1.6
                )
            axes.plot([100 * proportion.value], [row], "o", color=look(4)["color"], markersize=3.5)
        axes.set_yticks(range(len(points)), [_short(each) for each in points])
        axes.set_ylim(len(points) - 0.5, -0.5)
        axes.set_xlim(left=0)
        axes.set_xlabel("runs that diverged [%]" + (", and 95 % interval" if fractions[0].low is not None else ""))
    return figure


def distribution_figure(found: Findings) -> Any:
    """Cumulative distribution of the main figure; a curve that ends below 100 % lacks the runs that diverged."""
    main, sheet = found.results.main, found.sheet
    shown = [each for each in found.points[:SHOWN] if each.runs > 1]
    if not main or not shown:
        return None
    text, factor = label(found, main)
    with page(COLUMN, 2.6) as figure:
        axes = figure.subplots()
        ends = list[float]()
        for place, each in enumerate(shown):
            values = np.sort(sheet.of(each.index, sheet.figure(main)))
            values = values[~np.isnan(values)]
            if not len(values):
                continue
            fractions = 100 * np.arange(1, len(values) + 1) / len(values)
            finite = np.isfinite(values)
            values, fractions = factor * values[finite], fractions[finite]
            kept = np.unique(np.linspace(0, max(len(values) - 1, 0), min(MOST, len(values))).astype(int))
            axes.step(values[kept], fractions[kept], where="post", label=_short(each), **look(place))
            ends += [] if not len(values) else [values[0], values[-1]]
        _scaled(axes, ends)
        axes.set_ylim(0, 102)
        axes.set_xlabel(f"{text}")
        axes.set_ylabel("runs with at most that [%]")
        if len(shown) > 1:
            names_above(figure, axes, COLUMN)
    return figure


def eighths_figure(found: Findings) -> Any:
    """RMS of the error in each eighth of the run: median, and the 95 % quantile as a thin line."""
    shown = [each for each in found.points[:SHOWN] if each.eighths.size and np.isfinite(each.eighths[1]).any()]
    if not shown:
        return None
    unit, factor = shown_unit(found.results.units.get("rms_1", ""))
    several = any(each.runs > 1 for each in shown)
    with page(COLUMN, 2.4) as figure:
        axes = figure.subplots()
        for place, each in enumerate(shown):
            kind = look(place)
            numbers = np.arange(1, 9)
            for row, width in ((1, 1.3), *(((2, 0.6),) if several else ())):
                values = factor * each.eighths[row]
                seen = np.isfinite(values) & (values > 0)
                name = _short(each) if row == 1 else None
                axes.plot(numbers[seen], values[seen], marker="o", markersize=2, linewidth=width, label=name,
                          color=kind["color"], linestyle=kind["linestyle"])  # fmt: skip
        axes.set_yscale("log")
        log_ticks(axes)
        axes.set_xticks(range(1, 9))
        axes.set_xlabel("eighth of the run")
        axes.set_ylabel(f"RMS of the error [{unit_text(unit)}]")
        if len(shown) > 1:
            names_above(figure, axes, COLUMN)
    return figure


def influence_figure(found: Findings) -> Any:
    """Proportion of the ranks' variance that each factor explains by itself: bars, with a colour per grid point."""
    main = found.results.main
    shown = [each for each in found.points[:SHOWN] if each.influences.get(main)]
    if not main or not shown:
        return None
    factors = [item.factor for item in shown[0].influences[main]][:FACTORS]
    with page(COLUMN, 0.75 + (0.14 * len(shown) + 0.1) * len(factors)) as figure:
        axes = figure.subplots()
        height = 0.8 / len(shown)
        for place, each in enumerate(shown):
            by_factor = {item.factor: item.explained for item in each.influences[main]}
            rows = np.arange(len(factors)) + (place - (len(shown) - 1) / 2) * height
            fractions = [100 * by_factor.get(name, 0.0) for name in factors]
            axes.barh(rows, fractions, 0.9 * height, label=_short(each), color=look(place)["color"])
        axes.set_yticks(range(len(factors)), [verbatim(name) for name in factors])
        axes.set_ylim(len(factors) - 0.5, -0.5)
        axes.set_xlim(left=0)
        axes.set_xlabel(f"of the variance of {verbatim(main)}'s ranks [%]")
        if len(shown) > 1:
            names_above(figure, axes, COLUMN)
    return figure


def map_figure(found: Findings, maps: Sequence[PointMap]) -> Any:
    """A row per grid point: median of the main figure in each bin, and fraction of the runs that diverged."""
    import matplotlib as mpl

    main = found.results.main
    text, factor = label(found, main)
    medians = [factor * each.map.median for each in maps]
    finite = np.concatenate([each[np.isfinite(each)] for each in medians])
    lost = any(np.nanmax(each.map.diverged, initial=0.0) > 0 for each in maps)
    if not finite.size:
        return None
    low, high = float(finite.min()), float(finite.max())
    norm: Any = mpl.colors.Normalize(low, high if high > low else low + 1e-12)
    if low > 0 and high / low > 10:
        norm = mpl.colors.LogNorm(low, high)
    with page(PAGE if lost else COLUMN, 0.45 + 2.15 * len(maps)) as figure:
        grid = figure.subplots(len(maps), 2 if lost else 1, squeeze=False, sharex=True, sharey=True)
        for row, (each, median) in zip(grid, zip(maps, medians, strict=True), strict=True):
            kinds = [(median, norm, "cividis_r", f"median {text}")]
            if lost:
                kinds.append((100 * each.map.diverged, mpl.colors.Normalize(0, 100), "Greys", "diverged [%]"))
            for axes, (values, scale, colours, name) in zip(row, kinds, strict=True):
                _field(found, axes, each, values, scale, colours, name)
                if values is not median and not np.nanmax(values, initial=0.0) > 0:
                    axes.text(0.5, 0.5, "none diverged", ha="center", va="center", transform=axes.transAxes)
                if each.name:
                    axes.set_title(verbatim(each.name))
        for axes in grid[-1]:
            axes.set_xlabel(label(found, maps[0].x)[0])
        for axes in grid[:, 0]:
            axes.set_ylabel(label(found, maps[0].y)[0])
    return figure


def _field(found: Findings, axes: Any, drawn: PointMap, values: np.ndarray, norm: Any, colours: str, name: str) -> None:
    import matplotlib as mpl

    x, y = (_edges(axis, label(found, key)[1]) for axis, key in ((drawn.map.x, drawn.x), (drawn.map.y, drawn.y)))
    shown = np.ma.masked_where(~np.isfinite(values), values)
    mesh = axes.pcolormesh(x, y, shown, norm=norm, cmap=colours, edgecolors="face", linewidth=0.3)
    for row, column in np.argwhere(np.isinf(values)):
        corner, size = (x[column], y[row]), (x[column + 1] - x[column], y[row + 1] - y[row])
        axes.add_patch(
            mpl.patches.Rectangle(corner, *size, facecolor="white", edgecolor=GREY, hatch="////", linewidth=0)
        )
    for axis, key, set_scale, set_ticks in (
        (drawn.map.x, drawn.x, axes.set_xscale, axes.set_xticks),
        (drawn.map.y, drawn.y, axes.set_yscale, axes.set_yticks),
    ):
        if axis.each:
            factor = label(found, key)[1]
            set_ticks(np.arange(axis.size), [f"{factor * value:g}" for value in axis.edges])
        elif axis.log:
            set_scale("log")
            low, high = label(found, key)[1] * axis.edges[[0, -1]]
            marks = plain_marks(float(low), float(high))
            set_ticks(marks, [f"{mark:g}" for mark in marks])
            set_ticks([], minor=True)
    axes.grid(visible=False)
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.02)
    bar.set_label(name)
    bar.outline.set_linewidth(0.4)


def plain_marks(low: float, high: float) -> list[float]:
    """About five numbers with one digit, for a logarithmic axis."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1, 2, 3, 4, 5, 6, 8), (1, 2, 5), (1,)):
        found = [float(f"{digit}e{power}") for power in decades for digit in digits]
        found = [mark for mark in found if low * (1 - 1e-9) <= mark <= high * (1 + 1e-9)]
        if len(found) <= 6:
            break
    return found or [low, high]


def _edges(axis: Axis, factor: float) -> np.ndarray:
    return np.arange(axis.size + 1) - 0.5 if axis.each else factor * axis.edges


def _scaled(axes: Any, ends: Sequence[float]) -> None:
    """A logarithmic x-axis if the values span more than a factor of five."""
    if ends and min(ends) > 0 and max(ends) / min(ends) >= 5:
        axes.set_xscale("log")
        plain_log_axis(axes, few=max(ends) / min(ends) < 300)


def plain_log_axis(axes: Any, *, few: bool = True) -> None:
    """Plain numbers on a logarithmic x-axis: 1, 2, 5 of each decade if there are `few` decades, else 1."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=9))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _short(each: PointFindings) -> str:
    """Name of a grid point for a legend."""
    return verbatim(each.name or "all runs")
