"""Tracking errors against time, and their norms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dmframe.common.plotting import (
    COLUMN,
    POINTS,
    VANISHING,
    draw_curve,
    frame,
    look,
    names_above,
    page,
    span,
    tame,
    unit_text,
)
from dmframe.results.metrics import turn_error
from dmframe.results.plotting import (
    Runs,
    coordinate_labels,
    errors_of,
    left_out,
    mark_divergence,
    note_below,
    run_label,
    set_times,
    shown_unit,
    why_not_with,
)
from dmframe.simulate import Recording


def error_figure(runs: Runs) -> Any:
    """Tracking error by coordinate, its norm on a logarithmic scale, and the orientation error; None without a goal."""
    same = errors_of(runs)
    if not same:
        return None
    first = next(iter(same))
    labels = coordinate_labels(runs[first], same[first])
    turns = {name: turn for name in same if (turn := turn_error(runs[name])) is not None}
    below = [1.4, 1.4] if turns else [1.4]
    with page(COLUMN, 0.75 + 0.85 * len(labels) + 1.25 * len(below)) as figure:
        heights = [1.0] * len(labels) + below
        panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        most = max(200, min(2000, POINTS // (len(same) * len(panels))))
        for row, (label, unit, scale) in enumerate(labels):
            for place, (name, error) in enumerate(same.items()):
                draw_curve(
                    panels[row], error.times, tame(error.values[:, row]) * scale, most, **_kind(place, name, runs[name])
                )
            curves = [(tame(e.values[:, row]) * scale, runs[name].divergence is not None) for name, e in same.items()]
            frame(panels[row], curves, zero=True)
            panels[row].set_ylabel(f"{label} [{unit_text(unit)}]")
        kinds = {name: _kind(place, name, runs[name]) for place, name in enumerate(same)}
        unit, scale = shown_unit(same[first].unit)
        norms = {name: (error.times, tame(error.norm) * scale) for name, error in same.items()}
        of = " of the\nrevolute joints" if same[first].prismatic is not None else ""
        _norms(panels[len(labels)], norms, runs, kinds, f"norm{of} [{unit_text(unit)}]", most)
        if turns:
            angles = {name: (turn.times, tame(turn.angle)) for name, turn in turns.items()}
            _norms(panels[-1], angles, runs, kinds, "turn [deg]", most)
        mark_divergence(panels, {name: runs[name] for name in same})
        set_times(panels[-1], [runs[name] for name in same])
        names_above(figure, panels[0], COLUMN)
        note_below(figure, left_out(runs, same, why_not_with(same[first].signal)))
    return figure


def _norms(
    axes: Any,
    norms: Mapping[str, tuple[np.ndarray, np.ndarray]],
    runs: Runs,
    kinds: Mapping[str, Mapping[str, Any]],
    label: str,
    most: int,
) -> None:
    tops, bottoms = list[float](), list[float]()
    for name, (times, norm) in norms.items():
        positive = norm[norm > 0]
        draw_curve(axes, times, norm, most, **kinds[name])
        if positive.size:
            tops.append(span(positive, runs[name].divergence is not None)[1])
            bottoms.append(float(np.quantile(positive, 0.02)))
    axes.set_ylabel(label)
    top = max(tops, default=0.0)
    if top < VANISHING:
        frame(axes, [(np.zeros(1), False)], zero=True)
    else:
        axes.set_yscale("log")
        axes.set_ylim(max(min(bottoms), top * 1e-6) * 0.7, top * 1.5)
        log_ticks(axes)


def log_ticks(axes: Any) -> None:
    """Plain numbers at the decades, and between them if the axis has fewer than two decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_ylim()
    decades = np.floor(np.log10(high)) - np.ceil(np.log10(low)) + 1
    subs = (1.0,) if decades >= 2 else (1.0, 2.0, 5.0)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=8))
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:g}" if 1e-3 <= value < 1e4 else f"{value:.0e}")
    )
    axes.yaxis.set_minor_formatter(NullFormatter())


def _kind(place: int, name: str, run: Recording) -> dict[str, Any]:
    return {"label": run_label(name, run), **look(place)}
