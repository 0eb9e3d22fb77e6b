"""Rows of a study's table: what is measured of each closed loop, and the runs of some samples at some grid points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dmframe.batch.columns import Column, Columns, columns_of, joined, limits_in, rows_of, units_of
from dmframe.batch.figures import ERROR, TURN, Wanted
from dmframe.batch.runner import Runs
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, UnknownNameError
from dmframe.study.grammar import raise_placed

if TYPE_CHECKING:
    from dmframe.study.plan import Study


def measures_of(study: Study) -> tuple[Column, ...]:
    """See `Study.measures`."""
    section, known = study.file.measure, set[str]().union(*map(units_of, study.diagrams))
    signals = known - {ERROR, TURN}
    faults = [_unknown("signals", label, signals) for label in section.signals if label not in signals]
    faults += [_unknown("limits", label, known) for label in section.limits if label not in known]
    for diagram in study.diagrams:
        faults += limits_in(units_of(diagram), section.limits, "measure.limits")[1]
    raise_placed(faults, study.document)
    found = dict[str, Column]()
    for diagram in study.diagrams:
        for column in columns_of(diagram, wanted_of(study, diagram)):
            found.setdefault(column.name, column)
    return tuple(found.values())


def wanted_of(study: Study, diagram: Diagram) -> Wanted:
    """What to measure of a loop: the signals of the study's file that it has, and limits in their units."""
    units, section = units_of(diagram), study.file.measure
    limits, faults = limits_in(units, section.limits, "measure.limits")
    raise_placed(faults, study.document)
    signals = dict.fromkeys([*(label for label in section.signals if label in units), *limits])
    return Wanted(tuple(label for label in signals if label not in (ERROR, TURN)), limits)


def _unknown(section: str, label: str, known: Iterable[str]) -> DmframeError:
    return UnknownNameError(f"measure.{section}", "signal", label, known, path=("measure", section))


def rows(study: Study, several: Sequence[tuple[int, np.ndarray]], threads: int) -> Columns:
    """The table's rows of some samples at each of several grid points, one point after another."""
    items = [
        Runs(study.points[point].graph, study.values_of(point, samples), len(samples)) for point, samples in several
    ]
    found = study.runner.measure(items, partial(wanted_of, study), threads=threads)
    heads = [_head(study, point, samples) for point, samples in several]
    return joined([head | rows_of(part, study.measures) for head, part in zip(heads, found, strict=True)])


def _head(study: Study, point: int, samples: np.ndarray) -> Columns:
    """Numbers of the runs, and what varies."""
    count = len(samples)
    head: Columns = {"run": samples * len(study.points) + point, "point": np.full(count, point, dtype=np.int32)}
    head["sample"] = np.asarray(samples, dtype=np.int64)
    for name, value in study.points[point].values.items():
        head[name] = [value] * count if isinstance(value, str) else np.full(count, value)
    return head | study.drawn_at(samples)
