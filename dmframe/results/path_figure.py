"""Figure of desired and actual path over the last lap, with magnified deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dmframe.common.plotting import GREY, PAGE, draw_curve, frame, look, names_above, page, tame, unit_text
from dmframe.common.units import plain
from dmframe.results.dataset import axis_labels
from dmframe.results.metrics import TrackingError
from dmframe.results.plotting import Runs, coordinate_labels, errors_of, left_out, note_below, run_label, why_not_with
from dmframe.simulate import Recording

MOST = 2000
_VISIBLE = 0.35
"""Magnified largest deviation as a fraction of the extent of the path."""


def path_figure(runs: Runs) -> Any:
    """Path in its plane of largest extent, or over time for a joint goal; None without a goal."""
    errors = errors_of(runs)
    if not errors:
        return None
    first = next(iter(errors.values()))
    return (_in_plane if first.signal.startswith("x ") and first.values.shape[1] > 1 else _over_time)(runs, errors)


def last_lap(times: np.ndarray, path: np.ndarray) -> int:
    """Index at which the last lap of a closed path begins; 0 for a path that does not return to its end point.

    A return requires the same velocity, so that crossing the point does not count.
    """
    times, kept = np.unique(times, return_index=True)  # path time stops while a robot waits
    path = path[kept]
    if len(path) < 3:
        return 0
    rate = np.gradient(path, times, axis=0, edge_order=2)
    distance, turned = (np.linalg.norm(values - values[-1], axis=1) for values in (path, rate))
    largest, fastest = float(np.max(distance)), float(np.max(np.linalg.norm(rate, axis=1)))
    if largest <= 0:
        return 0
    away = np.flatnonzero(distance > 0.5 * largest)
    same = (distance < 0.05 * largest) & (turned < 0.1 * fastest)
    back = np.flatnonzero(same[: away[-1]])
    if not back.size:
        return 0
    last = back[-1]
    while last > 0 and distance[last - 1] < distance[last]:  # on to the nearest sample
        last -= 1
    return int(kept[last])


def magnification(extent: float, deviation: float) -> float:
    """Factor 1, 2, 5, 10, ... that makes a deviation visible next to the path."""
    if deviation <= 0 or extent <= 0:
        return 1.0
    wanted = _VISIBLE * extent / deviation
    if wanted < 2:
        return 1.0
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= wanted))


def _in_plane(runs: Runs, errors: Mapping[str, TrackingError]) -> Any:
    laps = {name: slice(last_lap(e.times, runs[name][e.desired]), None) for name, e in errors.items()}
    desired = {name: runs[name][e.desired][laps[name]] for name, e in errors.items()}
    actual = {name: desired[name] + tame(e.values[laps[name]]) for name, e in errors.items()}
    wide = np.ptp(np.concatenate(list(desired.values())), axis=0)
    still = not np.any(wide > 1e-9)
    if still:
        wide = np.max([np.ptp(path, axis=0) for path in actual.values()], axis=0)
    plane = sorted(np.argsort(-wide, kind="stable")[:2])
    sound = [name for name in errors if runs[name].divergence is None] or list(errors)
    largest = max(float(np.quantile(np.abs(errors[name].values[laps[name]][:, plane]), 0.98)) for name in sound)
    factor = 1.0 if still else magnification(float(np.max(wide)), largest)
    factors = [1.0] if factor == 1.0 else [1.0, factor]
    first = next(iter(errors))
    labels = axis_labels(runs[first].diagram)
    with page(PAGE if len(factors) > 1 else PAGE / 2, 3.5) as figure:
        panels = figure.subplots(1, len(factors), squeeze=False)[0]
        for axes, times in zip(panels, factors, strict=True):
            _plane_panel(axes, runs, desired, actual, plane, times)
            axes.set_xlabel(f"{labels[plane[0]]} [m]")
            axes.set_ylabel(f"{labels[plane[1]]} [m]")
            shown = [_magnified(desired[name], actual[name], times)[:, plane] for name in sound]
            _fit(axes, shown, desired, plane, diverged=runs[sound[0]].divergence is not None)
        begin = float(runs[first].time[laps[first].start or 0])
        panels[0].set_title(f"path, last lap from {plain(begin, 's')}" if begin > 0 else "path")
        if len(factors) > 1:
            panels[1].set_title(f"deviation × {factor:g}")
            _scale_bar(panels[1], factor, largest)
        names_above(figure, panels[0], PAGE if len(factors) > 1 else PAGE / 2)
        note_below(figure, left_out(runs, errors, why_not_with(errors[first].signal)))
    return figure


def _magnified(desired: np.ndarray, actual: np.ndarray, factor: float) -> np.ndarray:
    return np.asarray(desired + factor * (actual - desired))


def _plane_panel(
    axes: Any,
    runs: Runs,
    desired: Mapping[str, np.ndarray],
    actual: Mapping[str, np.ndarray],
    plane: list[int],
    factor: float,
) -> None:
    from matplotlib.ticker import MaxNLocator

    drawn = list[np.ndarray]()
    for path in desired.values():
        box = np.array([path.min(axis=0), path.max(axis=0)])
        if not any(np.allclose(box, other, atol=0.02 * float(np.max(np.ptp(box, axis=0)))) for other in drawn):
            kept = _thin(path)
            kind = {"marker": "+", "markersize": 8} if np.ptp(box[:, plane], axis=0).max() < 1e-9 else {}
            label = "desired" if not drawn else None
            axes.plot(path[kept, plane[0]], path[kept, plane[1]], color=GREY, linewidth=2.4, label=label, **kind)
            drawn.append(box)
    for place, name in enumerate(actual):
        path = _magnified(desired[name], actual[name], factor)
        kept = _thin(path)
        axes.plot(path[kept, plane[0]], path[kept, plane[1]], label=run_label(name, runs[name]), **look(place))
        if runs[name].divergence is not None:
            axes.plot(path[-1, plane[0]], path[-1, plane[1]], "x", color=look(place)["color"], markersize=5)
    axes.set_aspect("equal", adjustable="box")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))


def _thin(path: np.ndarray) -> np.ndarray:
    return np.unique(np.linspace(0, len(path) - 1, min(len(path), MOST)).astype(int))


def _fit(
    axes: Any, paths: list[np.ndarray], desired: Mapping[str, np.ndarray], plane: list[int], *, diverged: bool
) -> None:
    """Axis limits for the desired path and bounded runs; diverged runs are clipped."""
    goal = np.concatenate([path[:, plane] for path in desired.values()])
    half = max(float(np.max(np.ptp(goal, axis=0))), 0.1) if diverged else np.inf
    low, high = goal.min(axis=0) - half, goal.max(axis=0) + half
    shown = np.concatenate([goal, *(np.clip(path, low, high) for path in paths)])
    low, high = shown.min(axis=0), shown.max(axis=0)
    lacking = np.maximum(0.4 * np.max(high - low) - (high - low), 0) / 2  # a straight path still gets a panel
    low, high = low - lacking, high + lacking
    margin = 0.06 * max(float(np.max(high - low)), 1e-3)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)


def _scale_bar(axes: Any, factor: float, deviation: float) -> None:
    """Draw a scale bar of the deviation in the middle of the panel."""
    decade = 10.0 ** np.floor(np.log10(deviation))
    length = float(decade * max(step for step in (1, 2, 5) if step * decade <= deviation))
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    x, y, half = (left + right) / 2, (low + high) / 2, factor * length / 2
    axes.plot([x - half, x + half], [y, y], color="black", linewidth=1.4, marker="|", markersize=5)
    axes.annotate(f"{length * 1e3:g} mm", (x, y), (0, 4), textcoords="offset points", ha="center", va="bottom")


def _over_time(runs: Runs, errors: Mapping[str, TrackingError]) -> Any:
    """Desired and actual value of each coordinate against time."""
    from matplotlib.lines import Line2D

    first = next(iter(errors))
    rows = errors[first].values.shape[1]
    labels = [label.removesuffix("error").strip() for label, _, _ in coordinate_labels(runs[first], errors[first])]
    with page(PAGE / 2, 0.8 + 1.3 * rows) as figure:
        panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        begin, end = _last_laps([runs[name] for name in errors], [runs[name][e.desired] for name, e in errors.items()])
        for row, axes in enumerate(panels):
            curves = list[tuple[np.ndarray, bool]]()
            for place, (name, error) in enumerate(errors.items()):
                inside = error.times >= begin
                desired = runs[name][error.desired][inside, row]
                draw_curve(axes, error.times[inside], desired, MOST, color=GREY, linewidth=2.4)
                actual = desired + tame(error.values[inside, row])
                draw_curve(axes, error.times[inside], actual, MOST, label=run_label(name, runs[name]), **look(place))
                curves += [(desired, False), (actual, runs[name].divergence is not None)]
            frame(axes, curves)
            axes.set_ylabel(f"{labels[row]} [{unit_text(errors[first].unit)}]")
            axes.set_xlim(begin, end)
        if begin > 0:
            panels[0].set_title(f"last lap, from {plain(begin, 's')}")
        panels[-1].set_xlabel("time [s]")
        note_below(figure, left_out(runs, errors, why_not_with(errors[first].signal)))
        names_above(figure, panels[0], PAGE / 2, [Line2D([], [], color=GREY, linewidth=2.4, label="desired")])
    return figure


def _last_laps(runs: list[Recording], paths: list[np.ndarray]) -> tuple[float, float]:
    """Time interval with the last laps of all runs, or the whole time."""
    begin = min(float(run.time[last_lap(run.time, path)]) for run, path in zip(runs, paths, strict=True))
    end = max(float(run.time[-1]) for run in runs)
    return begin, end if end > begin else begin + 1.0
