"""Figure of the efforts: servo voltages and controller torques."""

from __future__ import annotations

from typing import Any

import numpy as np

from dmframe.common.plotting import DASHES, PAGE, POINTS, draw_curve, frame, look, names_above, page, tame, unit_text
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
)
from dmframe.simulate import Recording

UNITS = ("V", "N m")


def effort_figure(runs: Runs) -> Any:
    """Voltages and torques of each joint over the end of the runs; None without such signals.

    Colours distinguish runs, dashes signals.
    """
    from matplotlib.lines import Line2D

    found = {name: efforts(run) for name, run in runs.items()}
    found = {name: signals for name, signals in found.items() if signals}
    if not found:
        return None
    first = next(iter(found))
    joints, slides = joint_labels(runs[first].diagram), joint_slides(runs[first])
    names = same_joints(runs, found)
    labels = list(dict.fromkeys(label for name in names for label in found[name]))
    units = [unit for unit in UNITS if any(unit in found[name].values() for name in names)]
    begin, end = last_stretch(names.values())
    with page(PAGE, 0.9 + 1.2 * len(joints)) as figure:
        panels = figure.subplots(len(joints), len(units), sharex=True, squeeze=False)
        most = max(200, min(1500, POINTS // (len(names) * len(joints) * len(labels))))
        for row, joint in enumerate(joints):
            for column, unit in enumerate(units):
                axes, curves = panels[row, column], list[tuple[np.ndarray, bool]]()
                for place, (name, run) in enumerate(names.items()):
                    inside = (run.time >= begin) & (run.time <= end)
                    for label in (label for label, its in found[name].items() if its == unit):
                        values = tame(run[label][inside, row])
                        kind = {"color": look(place)["color"], "linestyle": _dash(labels, label)}
                        draw_curve(axes, run.time[inside], values, most, **kind)
                        curves.append((values, run.divergence is not None))
                frame(axes, curves, zero=True)
                shown = sliding(unit) if slides[row] else unit
                axes.set_ylabel((f"{short(joint)}\n" if column == 0 else "") + f"[{unit_text(shown)}]")
        keys = [Line2D([], [], color="black", linestyle=_dash(labels, label), label=label) for label in labels]
        runs_too = [
            Line2D([], [], color=look(place)["color"], label=run_label(name, run))
            for place, (name, run) in enumerate(names.items())
            if len(names) > 1
        ]
        names_above(figure, None, PAGE, [*runs_too, *keys])
        without = left_out(runs, names, lambda run: "with other joints" if efforts(run) else "without such signals")
        show_stretch(figure, panels[-1], list(names.values()), without, 5)
    return figure


def efforts(run: Recording) -> dict[str, str]:
    """Units of the recorded joint voltages and torques, by label."""
    loop = run.diagram.loop
    return {
        signal.label: signal.unit
        for signal in loop.outputs
        if signal.unit in UNITS and signal.shape == "n" and signal.label in run.outputs
    }


def _dash(labels: list[str], label: str) -> Any:
    return DASHES[labels.index(label) % len(DASHES)]
