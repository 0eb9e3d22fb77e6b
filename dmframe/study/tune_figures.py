"""Figures of a search: its progress, the Pareto front, and the objective over each searched value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from dmframe.common.plotting import COLUMN, GREY, PAGE, look, names_above, page, unit_text, verbatim
from dmframe.results.error_figure import log_ticks
from dmframe.results.plotting import shown_unit
from dmframe.study.figures import plain_log_axis
from dmframe.study.objective import Statistic
from dmframe.study.trials import front_of

if TYPE_CHECKING:
    from dmframe.study.trials import Trial
    from dmframe.study.tuned import Tuned

ACROSS: Final = 3
"""Panels per row."""
_DECADE: Final = 5.0
"""Ratio of the largest to the smallest value from which an axis is logarithmic."""


def figures_of(found: Tuned) -> dict[str, Any]:
    """All figures for which there are trials, by file name."""
    ran = [each for each in found.trials if each.state == "ran"]
    if not ran:
        return {}
    made = {"search": search_figure(found), "values": values_figure(found)}
    if len(found.tuning.objectives) > 1 and len(ran) > 1:
        made["front"] = front_figure(found)
    return made


def search_figure(found: Tuned) -> Any:
    """The first objective of each trial, and the best so far."""
    from matplotlib.ticker import MaxNLocator

    of, trials = found.tuning.objectives[0], found.trials
    with page(COLUMN, 2.6) as figure:
        axes = figure.subplots()
        factor = _labelled(axes, of, "y")
        for state, marker, text in (
            ("ran", "o", "ran over all plants"),
            ("stopped", "v", "stopped early, lower bound"),
        ):
            mine = [each for each in trials if each.state == state and math.isfinite(each.figures[0])]
            if mine:
                kind: dict[str, Any] = {"color": look(0)["color"] if state == "ran" else GREY, "markersize": 3}
                x, y = [each.number for each in mine], [factor * each.figures[0] for each in mine]
                axes.plot(x, y, marker, linestyle="none", label=text, **kind)
        ran = [each for each in trials if each.state == "ran"]
        best = np.minimum.accumulate([each.figures[0] for each in ran])
        axes.step(
            [each.number for each in ran], factor * best, where="post", color=look(2)["color"], label="best so far"
        )
        lost = [each.number for each in trials if each.state in ("broken", "refused")]
        _scaled(axes, [factor * each.figures[0] for each in ran], "y")
        if lost:
            axes.plot(
                lost,
                np.full(len(lost), 0.02),
                "|",
                color=look(4)["color"],
                transform=axes.get_xaxis_transform(),
                label="refused or infeasible",
            )
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("trial")
        names_above(figure, axes, COLUMN)
    return figure


def front_figure(found: Tuned) -> Any:
    """The second objective over the first, with the Pareto front."""
    first, second = found.tuning.objectives[:2]
    ran = [each for each in found.trials if each.state == "ran"]
    with page(COLUMN, 2.8) as figure:
        axes = figure.subplots()
        x, y = _labelled(axes, first, "x"), _labelled(axes, second, "y")
        points = np.array([each.figures[:2] for each in ran]) * [x, y]
        axes.plot(*points.T, "o", color=GREY, markersize=3, linestyle="none", label="tried")
        if found.own is not None and found.own.searched:
            own = [x * found.own.searched[0], y * found.own.searched[1]]
            axes.plot(*([value] for value in own), "s", color=look(4)["color"], markersize=4, label="the graph's own")
        best = np.array([each.figures[:2] for each in front_of(ran)]) * [x, y]
        axes.plot(*best.T, "o-", color=look(2)["color"], markersize=4, label="Pareto front")
        _scaled(axes, points[:, 0].tolist(), "x")
        _scaled(axes, points[:, 1].tolist(), "y")
        names_above(figure, axes, COLUMN)
    return figure


def values_figure(found: Tuned) -> Any:
    """The first objective over each searched value."""
    columns, of = found.tuning.columns, found.tuning.objectives[0]
    ran = [each for each in found.trials if each.state == "ran"]
    lines = math.ceil(len(columns) / ACROSS)
    with page(PAGE, 0.5 + 1.7 * lines) as figure:
        panels = figure.subplots(lines, ACROSS, squeeze=False, sharey=True)
        for place, (name, factor) in enumerate(columns.items()):
            axes = panels.flat[place]
            scale = _labelled(axes, of, "y") if place % ACROSS == 0 else shown_unit(of.unit)[1]
            _points(axes, ran, name, scale)
            for each in found.front:
                axes.plot(
                    [each.values[name]], [scale * each.searched[0]], "o", color=look(2)["color"], markersize=4, zorder=3
                )
            if factor.spread is not None and factor.spread.kind == "log":
                axes.set_xscale("log")
                plain_log_axis(axes)
            unit = unit_text(factor.unit)
            axes.set_xlabel(
                verbatim(name) + (", factor" if factor.how == "scale" else f" [{unit}]" if factor.unit else "")
            )
        _scaled(panels.flat[0], [scale * each.figures[0] for each in ran], "y")
        for axes in panels.flat[len(columns) :]:
            axes.set_visible(False)
    return figure


def _points(axes: Any, ran: Sequence[Trial], name: str, scale: float) -> None:
    x, y = [each.values[name] for each in ran], [scale * each.figures[0] for each in ran]
    axes.plot(x, y, "o", color=GREY, markersize=2.5, linestyle="none")


def _labelled(axes: Any, of: Statistic, side: str) -> float:
    """Label an axis with an objective, and return the factor to its unit."""
    unit, factor = shown_unit(of.unit)
    text = verbatim(of.text) + (f" [{unit_text(unit)}]" if unit != "1" else "")
    (axes.set_xlabel if side == "x" else axes.set_ylabel)(text)
    return factor


def _scaled(axes: Any, values: Sequence[float], side: str) -> None:
    if min(values) > 0 and max(values) > _DECADE * min(values):
        (axes.set_xscale if side == "x" else axes.set_yscale)("log")
        if side == "y":
            log_ticks(axes)
        else:
            plain_log_axis(axes)
