"""Helpers shared by the figures of runs: labels, units, time axes, divergence marks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from dmframe.common.names import unicode_name
from dmframe.common.plotting import look, verbatim
from dmframe.common.units import plain, sliding
from dmframe.results.dataset import axis_labels, joint_labels
from dmframe.results.metrics import TrackingError, tracking_error
from dmframe.simulate import Recording

Runs = Mapping[str, Recording]
"""Runs by legend name."""

STRETCH = 12.0
"""Length of the end of a run shown in figures of fast signals [s]."""


def coordinate_labels(run: Recording, error: TrackingError) -> list[tuple[str, str, float]]:
    """Label, plotted unit and scale factor of each coordinate of the error."""
    rows, name = error.values.shape[1], error.signal.split(" ")[0]
    diagram, unit = run.diagram, error.unit
    if name == "x" and len(axis_labels(diagram)) == rows:
        return [(f"{axis} error", *shown_unit(unit)) for axis in axis_labels(diagram)]
    joints = joint_labels(diagram)
    if len(joints) == rows:
        slides = joint_slides(run)
        return [
            (f"{short(joint)}\nerror", *shown_unit(sliding(unit) if slide else unit))
            for joint, slide in zip(joints, slides, strict=True)
        ]
    return [(f"{unicode_name(name)}, {row + 1}:\nerror", *shown_unit(unit)) for row in range(rows)]


def errors_of(runs: Runs) -> dict[str, TrackingError]:
    """Tracking errors with the signal and unit of the first one."""
    errors = {name: error for name, run in runs.items() if (error := tracking_error(run)) is not None}
    alike = {(error.signal, error.unit) for error in list(errors.values())[:1]}
    return {name: error for name, error in errors.items() if (error.signal, error.unit) in alike}


def same_joints(runs: Runs, names: Collection[str]) -> dict[str, Recording]:
    """Named runs with the same joints as the first of them."""
    joints = [joint_labels(runs[name].diagram) for name in names]
    return {name: runs[name] for name, own in zip(names, joints, strict=True) if own == joints[0]}


def joint_slides(run: Recording) -> list[bool]:
    """Which joints are prismatic."""
    robot = run.diagram.robot
    count = len(joint_labels(run.diagram))
    return [joint.kind == "prismatic" for joint in robot.joints] if robot is not None else [False] * count


def shown_unit(unit: str) -> tuple[str, float]:
    """Plotted unit of an error and its scale factor: millimetres and milliradians."""
    return (f"m{unit}", 1e3) if unit in ("m", "rad", "m/s", "rad/s") else (unit or "1", 1.0)


def short(joint: str) -> str:
    """Short joint name for an axis label."""
    return verbatim(joint.removesuffix("_joint").replace("_", " "))


def run_label(name: str, run: Recording) -> str:
    """Legend name of a run, with the time of divergence or interruption."""
    name = verbatim(name)
    if run.divergence is not None:
        return f"{name} (diverged at {run.divergence.time:.3g} s)"
    return f"{name} (stopped at {run.time[-1]:.3g} s)" if run.interrupted else name


def mark_divergence(panels: Any, runs: Runs) -> None:
    """Draw a vertical line at each divergence."""
    for place, run in enumerate(runs.values()):
        if run.divergence is not None:
            for axes in panels:
                color = look(place)["color"]
                axes.axvline(run.divergence.time, color=color, linestyle=(0, (1, 1.5)), linewidth=0.9, zorder=1)
                axes.plot(
                    [run.divergence.time], [1.0], "x", color=color, markersize=4, transform=axes.get_xaxis_transform(),
                    clip_on=False,
                )  # fmt: skip


def last_stretch(runs: Collection[Recording]) -> tuple[float, float]:
    """Last `STRETCH` seconds that all runs reached."""
    end = min(float(run.time[-1]) for run in runs)
    return max(0.0, end - STRETCH), end if end > 0 else 1.0


def show_stretch(figure: Any, bottom: Any, runs: list[Recording], without: str, ticks: int) -> None:
    """Time axis of `last_stretch`, with a note on the interval and the omitted runs."""
    from matplotlib.ticker import MaxNLocator

    begin, end = last_stretch(runs)
    for axes in bottom:
        axes.set_xlabel("time [s]")
        axes.set_xlim(begin, end)
        axes.xaxis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 5, 10]))
    note_below(figure, window_text(begin, end, runs), without)


def set_times(axes: Any, runs: list[Recording]) -> None:
    """Time axis from 0 to the longest planned end."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlim(0.0, max(run.duration if run.divergence is None else run.divergence.time * 1.02 for run in runs))
    axes.set_xlabel("time [s]")
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))


def window_text(begin: float, end: float, runs: list[Recording]) -> str:
    """Interval shown and sampling, ``from 188 s to 200 s of 200 s; controller every 8 ms``."""
    whole = max(run.duration for run in runs)
    shown = "" if begin <= 0 else f"from {plain(begin, 's')} to {plain(end, 's')} of {plain(whole, 's')}"
    clocks = dict.fromkeys("continuous" if run.clock is None else f"every {plain(run.clock, 's')}" for run in runs)
    sampled = f"controller {' and '.join(clocks)}"
    return f"{shown}; {sampled}" if shown else sampled


def left_out(runs: Runs, shown: Collection[str], why: Callable[[Recording], str]) -> str:
    """Note on runs omitted from a figure, with reasons; may be empty."""
    texts = [f"{verbatim(name)}, {why(run)}" for name, run in runs.items() if name not in shown]
    return f"not shown: {'; '.join(texts)}" if texts else ""


def note_below(figure: Any, *texts: str) -> None:
    """Add a note below all panels."""
    if note := "\n".join(filter(None, texts)):
        figure.supxlabel(note, fontsize=7, x=0.01, ha="left")


def why_not_with(signal: str) -> Callable[[Recording], str]:
    """Reason to omit a run from a figure of the error `signal`."""

    def why(run: Recording) -> str:
        error = tracking_error(run)
        if error is None:
            return "without a goal"
        return f"whose error is {error.signal}" if error.signal != signal else f"whose error is in {error.unit}"

    return why
