"""Figure of the adapted parameters over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from dmframe.certify.true_values import estimates_of
from dmframe.common.names import Element, unicode_name
from dmframe.common.plotting import (
    GREY,
    POINTS,
    draw_curve,
    frame,
    look,
    new_figure,
    settle,
    styled,
    tame,
    unit_text,
    verbatim,
)
from dmframe.diagram.closed_loop import Variable
from dmframe.results.dataset import elements
from dmframe.results.plotting import mark_divergence, run_label, set_times, short
from dmframe.simulate import Recording

WIDTH = 5.4
NAMED = 7
"""Number of curves with a legend entry in a panel."""


def estimate_figure(name: str, run: Recording) -> Any:
    """One panel for each estimate; None for a controller without estimates.

    Of many elements those with the largest changes are named, the others are grey, constant ones omitted. Legend and
    marks show the true values; for a run on hardware those of the graph, since the true ones may differ.
    """
    truths = estimates_of(run.diagram)
    shown = [item for item in run.diagram.loop.controller if item.label in truths and item.label in run.states]
    if not shown:
        return None
    with styled():
        heights = [1.9 if variable.symbol.numel() > NAMED else 1.15 for variable in shown]
        figure = new_figure(WIDTH, 0.6 + sum(heights))
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        most = max(200, min(2000, POINTS // sum(variable.symbol.numel() for variable in shown)))
        for place, (axes, variable) in enumerate(zip(panels, shown, strict=True)):
            truth = truths[variable.label]
            repeated = truth is None and any(other.shape == variable.shape for other in shown[:place])
            _panel(axes, run, variable, most, truth, legend=not repeated)
        mark_divergence(panels, {name: run})
        set_times(panels[-1], [run])
        panels[0].set_title(run_label(name, run), loc="left")
        settle(figure)
    return figure


def _panel(axes: Any, run: Recording, variable: Variable, most: int, truth: np.ndarray | None, *, legend: bool) -> None:
    values = tame(run[variable.label])
    size, letter = values.shape[1], variable.shape
    counted = elements(run.diagram, letter, size)
    diverged = run.divergence is not None
    seen = values[: max(1, int(0.9 * len(values)))] if diverged else values
    moves = np.ptp(seen, axis=0)
    order = list(np.argsort(-moves, kind="stable"))
    named = sorted(order[:NAMED]) if size > NAMED else list(range(size))
    named = [row for row in named if moves[row] > 0 or size <= NAMED]
    grey = [row for row in order[NAMED:] if moves[row] > 0] if size > NAMED else []
    for place, row in enumerate(grey):
        label = f"{len(grey)} more" if place == 0 else None
        draw_curve(axes, run.time, values[:, row], most, color=GREY, linewidth=0.6, label=label, zorder=1.5)
    for place, row in enumerate(named):
        label = element(counted[row], letter, variable.unit)
        if truth is not None:
            label += f"  ({'in the graph' if run.beside else 'true'} {truth[row]:.3g})"
        draw_curve(axes, run.time, values[:, row], most, label=label, **look(place))
    frame(axes, [(values[:, row], diverged) for row in (*named, *grey)])
    if truth is not None:
        _truths(axes, truth, named)
    unit = variable.unit or ("SI units" if letter == "p" and not any(each.unit for each in counted) else "")
    axes.set_ylabel(unicode_name(variable.name) + (f" [{unit_text(unit)}]" if unit else ""))
    handles, texts = axes.get_legend_handles_labels()
    last = [i for i, text in enumerate(texts) if text.endswith(" more")]
    keep = [i for i in range(len(texts)) if i not in last] + last
    if texts and (legend or len(texts) > NAMED):
        axes.legend(
            [handles[i] for i in keep], [texts[i] for i in keep], loc="center left", bbox_to_anchor=(1.01, 0.5),
            borderaxespad=0.0,
        )  # fmt: skip


def _truths(axes: Any, truth: np.ndarray, named: list[int]) -> None:
    """Mark true values within the panel at its right edge; others would compress the curves."""
    low, high = axes.get_ylim()
    for place, row in enumerate(named):
        if low <= truth[row] <= high:
            mark = {"marker": 4, "markersize": 5, "clip_on": False, "color": look(place)["color"]}
            axes.plot([1.0], [truth[row]], linestyle="none", transform=axes.get_yaxis_transform(), **mark)


def element(counted: Element, letter: str, unit: str) -> str:
    """Legend entry of an element, with its unit if the signal has no common `unit`."""
    name = counted.name
    if letter == "n":
        text = short(name)
    elif letter == "h":
        place, _, axis = name.rpartition(" ")
        text = f"{short(place)} {axis}".strip()
    else:
        text = unicode_name(name) if name.isidentifier() else verbatim(name)
    return f"{text} [{unit_text(counted.unit)}]" if counted.unit and not unit else text
