"""The rows of some runs of a study: samples of one point, and points that differ in numbers alone, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.errors import DmframeError, ValueFault
from dmframe.study.measured import asked_of
from dmframe.study.table import Columns, Group, apart, faulty, joined, rows_of, together
from dmframe.study.varied import START

if TYPE_CHECKING:
    from dmframe.study.plan import Point, Study


def alone(study: Study, point: int, samples: np.ndarray, threads: int) -> Columns:
    """See `Study.rows_of`."""
    return _head(study, point, samples) | _measured(study, study.points[point], samples, threads)


def band(study: Study, point: int, end: int, first: int, stop: int, threads: int) -> Columns:
    """See `Study.band`."""
    found, count = dict[int, Columns](), stop - first
    for group in _alike(study, point, end) if count else ():
        values = [study.values(each, first, stop) for each in group.points]
        batch = study._loops.batch(group.diagram, group.experiment, asked_of(study, group.diagram), threads)
        measured = group.measured(values, count, batch)
        if measured is None:
            continue
        study._loops.engine = measured.engine
        rows = rows_of(measured, study.measures, count * len(group.points))
        for k, each in enumerate(group.points):
            part = {name: column[k * count : (k + 1) * count] for name, column in rows.items()}
            found[each] = _head(study, each, np.arange(first, stop)) | part
    rest = [each for each in range(point, end) if each not in found]
    found |= {each: study.rows(each, first, stop, threads=threads) for each in rest}
    return joined([found[each] for each in range(point, end)])


def _alike(study: Study, point: int, end: int) -> list[Group]:
    """Points of one closed loop, clock, duration and solver, where there are several."""
    if any(_apart(study, label) for factor in study.factors for label in factor.labels):
        return []
    groups = list[Group]()
    for each in range(point, end):
        experiment = study.points[each].graph.experiment
        diagram, numbers = study._loops.of(experiment)
        group = next((group for group in groups if group.takes(experiment, diagram)), None)
        if group is None:
            groups.append(group := Group(experiment, diagram))
        group.points.append(each)
        group.numbers.append(numbers)
    return [group for group in groups if len(group.points) > 1]


def _head(study: Study, point: int, samples: np.ndarray) -> Columns:
    """Which runs they are, and what varies."""
    here, count = study.points[point], len(samples)
    told: Columns = {"run": samples * len(study.points) + point, "point": np.full(count, point, dtype=np.int32)}
    told["sample"] = np.asarray(samples, dtype=np.int64)
    for name, value in here.values.items():
        told[name] = [value] * count if isinstance(value, str) else np.full(count, value)
    return told | study._drawn(samples)


def _measured(study: Study, here: Point, samples: np.ndarray, threads: int) -> Columns:
    experiment, count = here.graph.experiment, len(samples)
    diagram, _ = study._loops.of(experiment)
    wanted = asked_of(study, diagram)
    if count and not any(_apart(study, label) for factor in study.factors for label in factor.labels):
        values = study._values(here, samples)
        found = together(study._loops, experiment, values, count, wanted, threads)
        if found is not None:
            return rows_of(found, study.measures, count)
    graphs = list[Experiment | DmframeError]()
    for sample in samples.tolist():
        try:
            graphs.append(study.graph_of(sample * len(study.points) + here.index).experiment)
        except DmframeError as error:
            graphs.append(error)
    parts = [
        faulty(each, study.measures, 1) if isinstance(each, DmframeError) else rows_of(each, study.measures, 1)
        for each in apart(study._loops, graphs, wanted, threads)
    ]
    return joined(parts) if parts else faulty(ValueFault("none"), study.measures, 0)


def _apart(study: Study, label: str) -> bool:
    """True for what is no parameter of a block that has a value: its runs are prepared one by one."""
    block, _, key = label.partition(".")
    held = study.bases[""].blocks
    return label.startswith(START) or block not in held or getattr(held[block], key, None) is None
