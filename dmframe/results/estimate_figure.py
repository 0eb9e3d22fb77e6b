"""What the controller has learned, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from dmframe.diagram.closed_loop import Variable
from dmframe.plotting import GREY, POINTS, draw_curve, frame, look, new_figure, styled, tame, unit_text
from dmframe.results.dataset import element_labels
from dmframe.results.drawn_runs import mark_divergence, set_times, short, told
from dmframe.simulate import Recording

WIDTH = 5.4
NAMED = 6
"""How many curves of a panel a legend names."""


def estimate_figure(name: str, run: Recording) -> Any:
    """One panel for each estimated quantity; None where the controller estimates nothing.

    Of many elements those that move most are named, the others stay grey, and those that never move are left out.
    """
    shown = [
        variable for variable in run.diagram.loop.controller if is_estimate(variable) and variable.label in run.states
    ]
    if not shown:
        return None
    with styled():
        heights = [1.9 if variable.symbol.numel() > NAMED else 1.15 for variable in shown]
        figure = new_figure(WIDTH, 0.6 + sum(heights))
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        most = max(200, min(2000, POINTS // sum(variable.symbol.numel() for variable in shown)))
        for place, (axes, variable) in enumerate(zip(panels, shown, strict=True)):
            repeated = any(other.shape == variable.shape for other in shown[:place])
            _panel(axes, run, variable, most, legend=not repeated)
        mark_divergence(panels, {name: run})
        set_times(panels[-1], [run])
        panels[0].set_title(told(name, run), loc="left")
        figure.align_ylabels(panels)
    return figure


def is_estimate(variable: Variable) -> bool:
    """Columns named ``..._hat``, and the servo's scales w, w_P, w_I."""
    name = variable.name
    return variable.symbol.is_column() and (name.endswith("_hat") or name == "w" or name.startswith("w_"))


def _panel(axes: Any, run: Recording, variable: Variable, most: int, *, legend: bool) -> None:
    values = tame(run[variable.label])
    size, letter = values.shape[1], variable.shape
    labels = element_labels(run.diagram, letter, size)
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
        draw_curve(axes, run.time, values[:, row], most, label=element(labels[row], letter), **look(place))
    frame(axes, [(values[:, row], diverged) for row in (*named, *grey)])
    unit = variable.unit or ("SI units" if variable.shape == "p" else "")
    axes.set_ylabel(_symbol(variable.name) + (f" [{unit_text(unit)}]" if unit else ""))
    handles, texts = axes.get_legend_handles_labels()
    last = [i for i, text in enumerate(texts) if text.endswith(" more")]
    keep = [i for i in range(len(texts)) if i not in last] + last
    if texts and (legend or len(texts) > NAMED):
        axes.legend(
            [handles[i] for i in keep], [texts[i] for i in keep], loc="center left", bbox_to_anchor=(1.01, 0.5),
            borderaxespad=0.0,
        )  # fmt: skip


def element(label: str, letter: str) -> str:
    """A name of `element_labels` as a legend shows it."""
    if letter == "n":
        return short(label)
    if letter == "h":
        place, _, axis = label.rpartition(" ")
        return f"{short(place)} {axis}".strip()
    base, under, index = label.partition("_")
    return rf"${base}_{{{index}}}$" if under and base.isalpha() else label


def _symbol(name: str) -> str:
    r"""``a_d_hat`` as ``\hat a_d``."""
    base, _, index = name.removesuffix("_hat").partition("_")
    base = rf"\hat{{{base}}}" if name.endswith("_hat") else base
    return rf"${base}_\mathrm{{{index}}}$" if index else f"${base}$"
