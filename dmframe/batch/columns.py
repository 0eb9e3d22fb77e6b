"""Columns of figures: their names and units in a study's table and in the data set of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.batch.batch import figures_of_run
from dmframe.batch.figures import ERROR, TURN, Figures, Measured, MeasuredSignals
from dmframe.common.errors import DmframeError
from dmframe.common.units import to_unit
from dmframe.diagram import Diagram
from dmframe.results.metrics import EIGHTHS, TurnError, counted_rows, goal_of
from dmframe.simulate import Recording
from dmframe.simulate.keep import rotation_distance_of

FIGURES: Final = ("least", "most", "last", "rms_final")
"""Figures of a signal."""
PREFIX: Final = {ERROR: "rms", TURN: "turn"}
"""Prefix of the RMS columns of the tracking error and of the tool's turn."""

Columns = dict[str, Any]
"""A table by column: arrays, or lists of texts."""


@final
@dataclass(frozen=True)
class Column:
    """A column of a study's table.

    Parameters
    ----------
    kind
        ``grid``, ``sampled`` or ``measured``.
    how
        How a varied quantity is set: by its ``value``, a ``scale`` of the graph's value or a ``shift`` from it.
    """

    name: str
    unit: str
    kind: str = "measured"
    how: str = "value"


def units_of(diagram: Diagram) -> dict[str, str]:
    """Units by label of all measurable quantities of a loop."""
    loop = diagram.loop
    units = {signal.label: signal.unit for signal in loop.outputs}
    units |= {variable.label: variable.unit for variable in loop.variables}
    goal = goal_of(loop)
    if goal is not None:
        shape = next(signal.shape for signal in loop.outputs if signal.label == goal.actual)
        units[ERROR] = counted_rows(diagram, shape, units[goal.actual])[1]
    return units if rotation_distance_of(loop) is None else units | {TURN: TurnError.unit}


def limits_in(
    units: Mapping[str, str], limits: Mapping[str, Any], where: str
) -> tuple[dict[str, float], list[DmframeError]]:
    """Limits as numbers in the units of their signals, and the faults of limits that do not fit; `where` is their key.

    Limits of unknown labels are omitted.
    """
    found, faults = dict[str, float](), list[DmframeError]()
    for label, value in limits.items():
        if label in units:
            try:
                found[label] = to_unit(value.item() if isinstance(value, np.generic) else value, units[label])
            except DmframeError as error:
                faults.append(type(error)(f"{where}.{label}: {error.text}", path=(*where.split("."), label)))
    return found, faults


def error_figures(label: str, figures: Figures) -> dict[str, tuple[np.ndarray, str]]:
    """Columns of the tracking error or the tool's turn, (N,) each, with their units."""
    rms, unit = PREFIX[label], figures.unit
    found = {f"{rms}_{k + 1}": (figures.rms_by_eighth[:, 0, k], unit) for k in range(EIGHTHS)}
    found |= {f"{rms}_final": (figures.rms_final[:, 0], unit), f"{label}_most": (figures.most[:, 0], unit)}
    return found | {f"{label}_crossed": (figures.crossed[:, 0], "s")}


def columns_of(diagram: Diagram, wanted: MeasuredSignals) -> list[Column]:
    """Columns of a loop's figures."""
    found, units = [Column("diverged", ""), Column("diverged_at", "s")], units_of(diagram)
    for label in (ERROR, TURN):
        if label in units:
            names = error_figures(label, Figures(units[label], np.zeros((0, 1, EIGHTHS + 4))))
            found += [
                Column(name, unit)
                for name, (_, unit) in names.items()
                if label in wanted.limits or not name.endswith("_crossed")
            ]
    sizes = {item.label: item.symbol.numel() for item in diagram.loop.variables}
    sizes |= {item.label: item.expression.numel() for item in diagram.loop.outputs}
    for label in wanted.signals:
        for name in element_names(label, sizes[label]):
            found += [Column(f"{name}.{figure}", units[label]) for figure in FIGURES]
            found += [Column(f"{name}.crossed", "s")] * (label in wanted.limits)
    return found


def element_names(label: str, size: int) -> list[str]:
    """Names of a signal's elements: ``servo.u[0]``, or the signal's own name for one element."""
    return [label] if size == 1 else [f"{label}[{k}]" for k in range(size)]


def rows_of(found: Measured, columns: Sequence[Column]) -> Columns:
    """Measured columns of runs, and their faults; NaN if a loop has no such figure."""
    rows: Columns = {column.name: np.full(found.runs, np.nan) for column in columns}
    rows["diverged"], rows["diverged_at"] = np.isfinite(found.diverged), found.diverged
    for label, figures in found.signals.items():
        values = {}
        if label in PREFIX:
            values = {name: column for name, (column, _) in error_figures(label, figures).items()}
        else:
            for k, name in enumerate(element_names(label, figures.last.shape[1])):
                values |= {f"{name}.{figure}": getattr(figures, figure)[:, k] for figure in (*FIGURES, "crossed")}
        rows |= {name: column for name, column in values.items() if name in rows}
    rows["fault"] = [str(found.faults[k]) if k in found.faults else None for k in range(found.runs)]
    return rows


def row_of(run: Recording, wanted: MeasuredSignals, columns: Sequence[Column]) -> dict[str, Any]:
    """Measured columns of one run."""
    rows = rows_of(figures_of_run(run, wanted), columns)
    return {column.name: rows[column.name][0].item() for column in columns}


def joined(parts: Sequence[Columns]) -> Columns:
    """Concatenate tables of runs."""
    return {
        name: np.concatenate([part[name] for part in parts])
        if isinstance(column, np.ndarray)
        else [item for part in parts for item in part[name]]
        for name, column in parts[0].items()
    }
