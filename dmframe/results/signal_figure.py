"""Figure of selected signals over time: one panel per signal, one curve per element and run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dmframe.common.errors import UnknownNameError, raise_all
from dmframe.common.plotting import PAGE, POINTS, draw_curve, frame, look, page, tame, unit_text
from dmframe.diagram.closed_loop import Signal, Variable
from dmframe.results.dataset import elements
from dmframe.results.estimate_figure import element
from dmframe.results.plotting import Runs, mark_divergence, run_label, set_times
from dmframe.simulate import Recording

NAMED = 12
"""Largest number of curves with legend entries in a panel."""


def signal_figure(runs: Runs, labels: Sequence[str]) -> Any:
    """Draw the signals; raises `UnknownNameError` for a signal that no run recorded."""
    known = {label for run in runs.values() for label in (*run.states, *run.outputs)}
    strangers = [label for label in dict.fromkeys(labels) if label not in known]
    raise_all([UnknownNameError(f"plot {label}", "signal", label, known) for label in strangers])
    most = max(200, min(2000, POINTS // (len(labels) * max(1, sum(_width(runs, label) for label in labels)))))
    with page(PAGE, 0.5 + 1.7 * len(labels)) as figure:
        panels = figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0]
        for axes, label in zip(panels, labels, strict=True):
            _panel(axes, runs, label, most)
        mark_divergence(panels, runs)
        set_times(panels[-1], list(runs.values()))
    return figure


def _width(runs: Runs, label: str) -> int:
    return sum(run[label].shape[1] for run in runs.values() if _has(run, label))


def _has(run: Recording, label: str) -> bool:
    return label in run.states or label in run.outputs


def _panel(axes: Any, runs: Runs, label: str, most: int) -> None:
    curves, count, unit, mixed = list[tuple[np.ndarray, bool]](), 0, "", False
    for name, run in runs.items():
        if not _has(run, label):
            continue
        item, values = _declared(run, label), tame(run[label])
        unit = item.unit
        letter = item.shape if len(item.shape.split()) == 1 else ""
        counted = elements(run.diagram, letter, values.shape[1])
        mixed = mixed or any(each.unit for each in counted)
        for column in range(values.shape[1]):
            part = element(counted[column], letter, unit) if values.shape[1] > 1 else ""
            legend = " ".join(word for word in (run_label(name, run) if len(runs) > 1 else "", part) if word)
            draw_curve(axes, run.time, values[:, column], most, label=legend or None, **look(count))
            curves.append((values[:, column], run.divergence is not None))
            count += 1
    frame(axes, curves)
    axes.set_ylabel(label if mixed and not unit else f"{label}\n[{unit_text(unit or '1')}]")
    if 1 < count <= NAMED:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), borderaxespad=0.0)


def _declared(run: Recording, label: str) -> Variable | Signal:
    loop = run.diagram.loop
    items: list[Variable | Signal] = [*loop.controller, *loop.plant, *loop.outputs]
    return next(item for item in items if item.label == label)
