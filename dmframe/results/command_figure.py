"""Figure of commanded and measured joint signals, and their difference (servo error)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dmframe.block.port import Access, Side
from dmframe.common.names import unicode_name
from dmframe.common.plotting import PAGE, POINTS, draw_curve, frame, look, names_above, page, tame, unit_text
from dmframe.common.units import sliding
from dmframe.results.dataset import joint_labels
from dmframe.results.plotting import (
    Runs,
    joint_slides,
    last_stretch,
    left_out,
    run_label,
    same_joints,
    short,
    show_stretch,
    shown_unit,
)
from dmframe.simulate import Recording


def command_figure(runs: Runs) -> Any:
    """Commanded and measured velocity of each joint, and the differences in velocity and in position.

    Shows the end of the runs; None without commanded signals.
    """
    pairs = {name: command_pairs(run) for name, run in runs.items()}
    pairs = {name: found for name, found in pairs.items() if found}
    if not pairs:
        return None
    first = next(iter(pairs))
    joints, slides = joint_labels(runs[first].diagram), joint_slides(runs[first])
    names = same_joints(runs, pairs)
    shown = _columns([pairs[name] for name in names])
    with page(PAGE, 0.8 + 1.2 * len(joints)) as figure:
        panels = figure.subplots(len(joints), len(shown), sharex=True, squeeze=False)
        most = max(200, min(1500, POINTS // (2 * len(names) * len(joints) * len(shown))))
        for row, joint in enumerate(joints):
            for column, (signal, kind) in enumerate(shown):
                unit = _unit(names[first], pairs[first], signal)
                unit = sliding(unit) if slides[row] else unit
                unit, scale = shown_unit(unit) if kind == "difference" else (unit, 1.0)
                _panel(panels[row, column], names, pairs, signal, kind, row, scale, most)
                about = (
                    f"{unicode_name(signal + '_c')} − {unicode_name(signal)}"
                    if kind == "difference"
                    else unicode_name(signal)
                )
                panels[row, column].set_ylabel(
                    (f"{short(joint)}\n" if column == 0 else "") + f"{about} [{unit_text(unit)}]"
                )
        without = left_out(
            runs, names, lambda run: "with other joints" if command_pairs(run) else "without commanded signals"
        )
        show_stretch(figure, panels[-1], list(names.values()), without, 4)
        names_above(figure, panels[0, 0], PAGE, _explained() if any(kind == "both" for _, kind in shown) else ())
    return figure


def command_pairs(run: Recording) -> dict[str, tuple[str, str]]:
    """Labels of command ``s_c`` and measurement ``s`` of each plant signal that has both.

    On hardware, the velocity sent to the robot replaces the command, which refers to the controller's time.
    """
    measured, wanted = dict[str, str](), dict[str, str]()
    for name, block in run.diagram.blocks.items():
        for port in block.outputs:
            label = f"{name}.{port.name}"
            if label not in run.outputs and label not in run.states:
                continue
            if block.side is Side.PLANT and port.access is Access.MEASURED:
                measured[port.name] = label
            if port.access in (Access.COMMANDED, Access.MEASURED) and port.name.endswith("_c"):
                wanted[port.name.removesuffix("_c")] = label
    if "dq" in wanted and "robot.sent" in run.beside:
        wanted["dq"] = "robot.sent"
    return {
        name: (wanted[name], measured[name]) for name in ("dq", "q", *wanted) if name in wanted and name in measured
    }


def _columns(pairs: list[dict[str, tuple[str, str]]]) -> list[tuple[str, str]]:
    """The first common signal in full and as a difference; the others as differences."""
    common = [name for name in pairs[0] if all(name in found for found in pairs)]
    return [(common[0], "both"), *((name, "difference") for name in common)] if common else []


def _panel(
    axes: Any,
    runs: Runs,
    pairs: dict[str, dict[str, tuple[str, str]]],
    signal: str,
    kind: str,
    row: int,
    scale: float,
    most: int,
) -> None:
    begin, end = last_stretch(runs.values())
    curves = list[tuple[np.ndarray, bool]]()
    for place, (name, run) in enumerate(runs.items()):
        inside = (run.time >= begin) & (run.time <= end)
        commanded, measured = (tame(run[label][inside, row]) for label in pairs[name][signal])
        times, diverged, color = run.time[inside], run.divergence is not None, look(place)["color"]
        if not times.size:
            continue
        if kind == "difference":
            draw_curve(axes, times, (commanded - measured) * scale, most, label=run_label(name, run), **look(place))
            curves.append(((commanded - measured) * scale, diverged))
        else:
            draw_curve(axes, times, measured, most, color=color, linewidth=1.1, label=run_label(name, run))
            draw_curve(axes, times, commanded, most, color=color, linewidth=0.8, linestyle=(0, (1.2, 1.2)))
            curves += [(commanded, diverged), (measured, diverged)]
        if diverged:
            axes.axvline(run.time[-1], color=color, linestyle=(0, (1, 1.5)), linewidth=0.9)
    frame(axes, curves, zero=kind == "difference")


def _unit(run: Recording, pairs: dict[str, tuple[str, str]], signal: str) -> str:
    label = pairs[signal][1]
    return next(output.unit for output in run.diagram.loop.outputs if output.label == label)


def _explained() -> list[Any]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color="black", linewidth=1.1, label="measured"),
        Line2D([], [], color="black", linewidth=0.8, linestyle=(0, (1.2, 1.2)), label="commanded"),
    ]
