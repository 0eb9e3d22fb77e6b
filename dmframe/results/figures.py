"""The figures of a run, and of several runs overlaid."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dmframe.results.dataset import axis_labels, joint_labels, sliding
from dmframe.results.metrics import TrackingError, tracking_error
from dmframe.results.plotting import (
    COLUMN,
    POINTS,
    draw_curve,
    frame,
    look,
    names_above,
    new_figure,
    save,
    span,
    styled,
    tame,
    unit_text,
)
from dmframe.simulate import Run

Runs = Mapping[str, Run]
"""Runs by the names that the legends show."""


def save_figures(runs: Runs, folder: Path) -> list[str]:
    """Write every figure that the runs allow, as PNG and SVG, and return their names.

    ``error``, ``path``, ``commands``, and for each run that estimates something ``estimates`` (``estimates_<name>``
    where there are several runs).
    """
    from dmframe.results.command_figure import command_figure
    from dmframe.results.estimate_figure import estimate_figure
    from dmframe.results.path_figure import path_figure

    made = {"error": error_figure(runs), "path": path_figure(runs), "commands": command_figure(runs)}
    for name, run in runs.items():
        made["estimates" if len(runs) == 1 else f"estimates_{name}"] = estimate_figure(name, run)
    written = {name: figure for name, figure in made.items() if figure is not None}
    for name, figure in written.items():
        save(figure, folder, name, about=", ".join(runs))
    return list(written)


def error_figure(runs: Runs) -> Any:
    """Tracking error against time, a panel a coordinate, and its norm on a logarithmic scale; None without a goal."""
    errors = {name: error for name, run in runs.items() if (error := tracking_error(run)) is not None}
    if not errors:
        return None
    first = next(iter(errors))
    signal = errors[first].signal
    same = {name: e for name, e in errors.items() if e.signal == signal and e.unit == errors[first].unit}
    labels = coordinate_labels(runs[first], errors[first])
    with styled():
        figure = new_figure(COLUMN, 0.75 + 0.85 * len(labels) + 1.25)
        panels = figure.subplots(
            len(labels) + 1, 1, sharex=True, squeeze=False, height_ratios=[1.0] * len(labels) + [1.4]
        )[:, 0]
        most = max(200, min(2000, POINTS // (len(same) * len(panels))))
        for row, (label, unit, scale) in enumerate(labels):
            for place, (name, error) in enumerate(same.items()):
                draw_curve(
                    panels[row], error.times, tame(error.values[:, row]) * scale, most, **_kind(place, name, runs[name])
                )
            curves = [(tame(e.values[:, row]) * scale, runs[name].divergence is not None) for name, e in same.items()]
            frame(panels[row], curves, zero=True)
            panels[row].set_ylabel(f"{label} [{unit_text(unit)}]")
        _norms(panels[-1], same, runs, labels, most)
        mark_divergence(panels, {name: runs[name] for name in same})
        set_times(panels[-1], [runs[name] for name in same])
        figure.align_ylabels(panels)
        names_above(figure, panels[0], COLUMN)
    return figure


def _norms(
    axes: Any, errors: Mapping[str, TrackingError], runs: Runs, labels: list[tuple[str, str, float]], most: int
) -> None:
    units, scale = list(dict.fromkeys(unit for _, unit, _ in labels)), labels[0][2]
    tops, bottoms = list[float](), list[float]()
    for place, (name, error) in enumerate(errors.items()):
        norm = tame(error.norm) * scale
        positive = norm[norm > 0]
        draw_curve(axes, error.times, norm, most, **_kind(place, name, runs[name]))
        if positive.size:
            tops.append(span(positive, runs[name].divergence is not None)[1])
            bottoms.append(float(np.quantile(positive, 0.02)))
    axes.set_ylabel(f"norm [{', '.join(units)}]")
    if tops:
        axes.set_yscale("log")
        top = max(tops)
        axes.set_ylim(max(min(bottoms), top * 1e-6) * 0.7, top * 1.5)
        log_ticks(axes)


def log_ticks(axes: Any) -> None:
    """Plain numbers at the decades, and between them where there are fewer than two."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_ylim()
    decades = np.floor(np.log10(high)) - np.ceil(np.log10(low)) + 1
    subs = (1.0,) if decades >= 2 else (1.0, 2.0, 5.0)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=8))
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:g}" if 1e-3 <= value < 1e4 else f"{value:.0e}")
    )
    axes.yaxis.set_minor_formatter(NullFormatter())


def coordinate_labels(run: Run, error: TrackingError) -> list[tuple[str, str, float]]:
    """Of each coordinate of the error: its label, the unit in which it is drawn, and the factor to it."""
    rows, name = error.values.shape[1], error.signal.split(" ")[0]
    diagram, unit = run.diagram, error.unit
    if name == "x" and len(axis_labels(diagram)) == rows:
        return [(f"${axis}$ error", *shown_unit(unit)) for axis in axis_labels(diagram)]
    joints = joint_labels(diagram)
    if len(joints) == rows:
        slides = joint_slides(run)
        return [
            (f"{short(joint)}\nerror", *shown_unit(sliding(unit) if slide else unit))
            for joint, slide in zip(joints, slides, strict=True)
        ]
    return [(f"error {row + 1}", *shown_unit(unit)) for row in range(rows)]


def joint_slides(run: Run) -> list[bool]:
    """Which joints are prismatic."""
    robot = run.diagram.robot
    count = len(joint_labels(run.diagram))
    return [joint.kind == "prismatic" for joint in robot.joints] if robot is not None else [False] * count


def shown_unit(unit: str) -> tuple[str, float]:
    """The unit in which errors are drawn, and the factor to it: millimetres and milliradians."""
    return (f"m{unit}", 1e3) if unit in ("m", "rad", "m/s", "rad/s") else (unit or "1", 1.0)


def short(joint: str) -> str:
    """A joint's name as it fits beside a panel."""
    return joint.removesuffix("_joint").replace("_", " ")


def told(name: str, run: Run) -> str:
    """A run's name in a legend, with how it ended where it did not end well."""
    if run.divergence is not None:
        return f"{name} (diverged at {run.divergence.time:.3g} s)"
    return f"{name} (stopped at {run.time[-1]:.3g} s)" if run.interrupted else name


def mark_divergence(panels: Any, runs: Runs) -> None:
    """A vertical line where a run left the finite numbers."""
    for place, run in enumerate(runs.values()):
        if run.divergence is not None:
            for axes in panels:
                color = look(place)["color"]
                axes.axvline(run.divergence.time, color=color, linestyle=(0, (1, 1.5)), linewidth=0.9, zorder=1)
                axes.plot(
                    [run.divergence.time], [1.0], "x", color=color, markersize=4, transform=axes.get_xaxis_transform(),
                    clip_on=False,
                )  # fmt: skip


def set_times(axes: Any, runs: list[Run]) -> None:
    """The time axis from 0 to the longest run's planned end."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlim(0.0, max(run.duration if run.divergence is None else run.divergence.time * 1.02 for run in runs))
    axes.set_xlabel("time [s]")
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def _kind(place: int, name: str, run: Run) -> dict[str, Any]:
    return {"label": told(name, run), **look(place)}
