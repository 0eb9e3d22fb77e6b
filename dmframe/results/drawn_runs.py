"""What the figures of runs share: names, labels with units, times, and the mark of a run that diverged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dmframe.plotting import look
from dmframe.results.dataset import axis_labels, joint_labels, sliding
from dmframe.results.metrics import TrackingError
from dmframe.simulate import Recording

Runs = Mapping[str, Recording]
"""Runs by the names that the legends show."""


def coordinate_labels(run: Recording, error: TrackingError) -> list[tuple[str, str, float]]:
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


def joint_slides(run: Recording) -> list[bool]:
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


def told(name: str, run: Recording) -> str:
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


def set_times(axes: Any, runs: list[Recording]) -> None:
    """The time axis from 0 to the longest run's planned end."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlim(0.0, max(run.duration if run.divergence is None else run.divergence.time * 1.02 for run in runs))
    axes.set_xlabel("time [s]")
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
