"""A study: a graph, what varies over how many runs, and each of its runs as a row or as a graph of its own."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.batch import Wanted
from dmframe.batch.figures import ERROR, TURN
from dmframe.config.document import Document
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.graph import Graph
from dmframe.results.metrics import TurnError, goal_of
from dmframe.simulate import Recording
from dmframe.simulate.keep import apart_of
from dmframe.study.design import Design
from dmframe.study.grammar import StudyFile
from dmframe.study.grid import Axis, Case, changed, scaled
from dmframe.study.table import (
    Column,
    Columns,
    Group,
    Loops,
    apart,
    columns_of,
    faulty,
    joined,
    row_of,
    rows_of,
    together,
    wanted_of,
)
from dmframe.study.varied import START, Factor
from dmframe.units import to_unit

if TYPE_CHECKING:
    from dmframe.study.results import Results

_READY: Final = 4
"""Studies whose closed loops a worker keeps."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Point:
    """A point of the grid.

    Parameters
    ----------
    index
        Its place; the last axis changes first.
    values
        What the grid's columns hold.
    """

    index: int
    values: Mapping[str, float | str]
    cases: tuple[Case, ...] = field(repr=False)
    study: Study = field(repr=False)

    @cached_property
    def graph(self) -> Graph:
        """The study's graph at this point, without what is sampled. Raises `DmframeError` at its place in the study."""
        held = self.study
        base = held.bases[next((case.graph for case in reversed(self.cases) if case.graph), "")]
        found = changed(base, [given for case in self.cases for given in case.sets])
        pairs = zip(held.axes, self.cases, strict=True)
        return Graph(scaled(found, [(axis, case.factor) for axis, case in pairs if case.factor is not None]))

    def __repr__(self) -> str:
        return f"<Point {self.index}: {', '.join(f'{key}={value}' for key, value in self.values.items()) or 'alone'}>"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Study:
    """What is run, and how often; it never changes.

    Parameters
    ----------
    name
        The file's name without its ending.
    path
        The file; None for a text or data.
    text
        The file as it was read.
    document
        The same as data with lines and columns.
    file
        The same, checked.
    bases
        Its graphs with what the whole study sets: its own under "", others by the name that the grid gives them.
    axes
        Of the grid.
    factors
        What is sampled.
    """

    name: str
    path: Path | None
    text: str
    document: Document = field(repr=False)
    file: StudyFile
    bases: Mapping[str, Experiment]
    axes: tuple[Axis, ...]
    factors: tuple[Factor, ...]

    @property
    def title(self) -> str:
        """One line that a reader understands."""
        return self.file.title or self.bases[""].file.title

    @property
    def samples(self) -> int:
        """Runs a point."""
        return self.file.sample.runs

    @property
    def runs(self) -> int:
        """All of them."""
        return len(self.points) * self.samples

    @cached_property
    def points(self) -> tuple[Point, ...]:
        """Of the grid; one where there is none."""
        found, count = list[Point](), 1
        for axis in self.axes:
            count *= len(axis.cases)
        for index in range(count):
            rest, cases = index, list[Case]()
            for axis in reversed(self.axes):
                rest, place = divmod(rest, len(axis.cases))
                cases.insert(0, axis.cases[place])
            values = {axis.name: case.told for axis, case in zip(self.axes, cases, strict=True)}
            found.append(Point(index, values, tuple(cases), self))
        return tuple(found)

    @cached_property
    def noisy(self) -> bool:
        """Some loop draws random numbers, or the length of its samples; all samples of a point draw the same ones."""
        jitter = any(bool(experiment.file.jitter) for experiment in self.bases.values())
        jitter |= any(label == "jitter" for axis in self.axes for label in axis.labels)
        jitter |= any("jitter" in factor.labels for factor in self.factors)
        return jitter or any(diagram.loop.noises for diagram in self._diagrams)

    @property
    def design(self) -> Design:
        """Where the samples lie; the same at each point."""
        section = self.file.sample
        names = tuple(name for factor in self.factors for name in factor.columns)
        try:
            return Design(section.method, section.seed, names, section.runs)
        except ValueFault as fault:
            _raise_placed([fault], self.document)
            raise

    @property
    def varied(self) -> tuple[Column, ...]:
        """The table's columns of what varies."""
        grid = [Column(axis.name, axis.unit, "grid", "scale" if axis.scaled else "value") for axis in self.axes]
        sampled = [
            Column(name, factor.unit, "sampled", factor.how) for factor in self.factors for name in factor.columns
        ]
        return (*grid, *sampled)

    @cached_property
    def measures(self) -> tuple[Column, ...]:
        """The table's columns of figures, over all closed loops that the grid has.

        Raises
        ------
        DmframeError
            A graph that cannot be built, a signal that none of them has, a limit in a unit that does not fit.
        """
        section, known = self.file.measure, set[str]().union(*map(_units_of, self._diagrams))
        faults = [
            _unknown("signals", label, known - {ERROR, TURN})
            for label in section.signals
            if label not in known - {ERROR, TURN}
        ]
        faults += [_unknown("limits", label, known) for label in section.limits if label not in known]
        _raise_placed([*faults, *(fault for each in self._diagrams for fault in self._limits(each)[1])], self.document)
        found = dict[str, Column]()
        for diagram in self._diagrams:
            for column in columns_of(diagram, self._wanted(diagram)):
                found.setdefault(column.name, column)
        return tuple(found.values())

    @cached_property
    def key(self) -> str:
        """A hash of all that decides a row's numbers; not of how many rows there are."""
        from dmframe.study.identity import key_of

        return key_of(self.identity)

    @cached_property
    def identity(self) -> Mapping[str, Any]:
        """What `key` is the hash of, as plain data, to tell how two studies differ."""
        from dmframe.study.identity import identity_of

        return identity_of(self)

    def drawn(self, first: int, stop: int) -> dict[str, np.ndarray]:
        """What is drawn for the samples [first, stop), by column."""
        return self._drawn(np.arange(first, stop, dtype=np.int64))

    def _drawn(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        design, first = self.design, int(samples.min(initial=self.samples))
        points = design.points(first, int(samples.max(initial=first - 1)) + 1)[samples - first]
        found = dict[str, np.ndarray]()
        for factor in self.factors:
            for name in factor.columns:
                assert factor.spread is not None  # only a grid's factors have none
                found[name] = factor.spread.at(points[:, design.names.index(name)])
        return found

    def values(self, point: int, first: int, stop: int) -> dict[str, np.ndarray]:
        """What the samples [first, stop) set at a point: rows by ``block.parameter``, in its own unit."""
        return self._values(self.points[point], np.arange(first, stop, dtype=np.int64))

    def _values(self, here: Point, samples: np.ndarray) -> dict[str, np.ndarray]:
        drawn, experiment = self._drawn(samples), here.graph.experiment
        found = dict[str, np.ndarray]()
        for factor in self.factors:
            factor.put(found, np.stack([drawn[name] for name in factor.columns], axis=1), experiment)
        return found

    def rows(self, point: int, first: int, stop: int, *, threads: int = 1) -> Columns:
        """Run the samples [first, stop) of a point: the table's columns. The same for a sample, whatever the others.

        Raises
        ------
        DmframeError
            A point whose graph cannot be built. (A run that cannot be made, or diverges, is a row.)
        """
        return self.rows_of(point, np.arange(first, stop, dtype=np.int64), threads=threads)

    def rows_of(self, point: int, samples: np.ndarray, *, threads: int = 1) -> Columns:
        """`rows` of any samples of a point, in their order."""
        return self._head(point, samples) | self._measured(self.points[point], samples, threads)

    def band(self, point: int, end: int, first: int, stop: int, *, threads: int = 1) -> Columns:
        """The same rows of the points [point, end), one point after another, sooner: many differ in numbers alone.

        A batch advances several runs at once, and a grid of single runs has but one at each point.
        """
        found, count = dict[int, Columns](), stop - first
        for group in self._alike(point, end) if count else ():
            values = [self.values(each, first, stop) for each in group.points]
            batch = self._loops.batch(group.diagram, group.experiment, self._wanted(group.diagram), threads)
            together = group.measured(values, count, batch)
            if together is None:
                continue
            self._loops.engine = together.engine
            rows = rows_of(together, self.measures, count * len(group.points))
            for k, each in enumerate(group.points):
                part = {name: column[k * count : (k + 1) * count] for name, column in rows.items()}
                found[each] = self._head(each, np.arange(first, stop)) | part
        rest = [each for each in range(point, end) if each not in found]
        found |= {each: self.rows(each, first, stop, threads=threads) for each in rest}
        return joined([found[each] for each in range(point, end)])

    def _alike(self, point: int, end: int) -> list[Group]:
        """Points of one closed loop, clock, duration and solver, where there are several."""
        if any(self._apart(label) for factor in self.factors for label in factor.labels):
            return []
        groups = list[Group]()
        for each in range(point, end):
            experiment = self.points[each].graph.experiment
            diagram, numbers = self._loops.of(experiment)
            group = next((group for group in groups if group.takes(experiment, diagram)), None)
            if group is None:
                groups.append(group := Group(experiment, diagram))
            group.points.append(each)
            group.numbers.append(numbers)
        return [group for group in groups if len(group.points) > 1]

    def _head(self, point: int, samples: np.ndarray) -> Columns:
        """Which runs they are, and what varies."""
        here, count = self.points[point], len(samples)
        told: Columns = {"run": samples * len(self.points) + point, "point": np.full(count, point, dtype=np.int32)}
        told["sample"] = np.asarray(samples, dtype=np.int64)
        for name, value in here.values.items():
            told[name] = [value] * count if isinstance(value, str) else np.full(count, value)
        return told | self._drawn(samples)

    def graph_of(self, run: int) -> Graph:
        """One run as a graph of its own, with the very numbers of its row.

        Raises
        ------
        ValueFault
            There is no such run.
        """
        if isinstance(run, bool) or not isinstance(run, int) or not 0 <= run < self.runs:
            raise ValueFault(f"run: expected one from 0 to {self.runs - 1}, found {run!r:.40}")
        sample, point = divmod(run, len(self.points))
        graph = self.points[point].graph
        numbers = {label: rows[0].tolist() for label, rows in self.values(point, sample, sample + 1).items()}
        experiment = graph.experiment.changed(numbers) if numbers else graph.experiment
        return Graph(replace(experiment, name=f"{self.name}_{run}"))

    def run(
        self,
        out: str | Path | None = None,
        *,
        workers: int | None = None,
        scheduler: str | None = None,
        force: bool = False,
        progress: bool | None = None,
    ) -> Results:
        """Compute the rows that its folder does not hold yet, as ``dmframe study`` does; `out` is ``studies/NAME``.

        Raises
        ------
        DmframeError
            The folder holds something else, or not all rows could be computed; see `dmframe.study.execute.run_study`.
        """
        from dmframe.study.run import run_whole

        return run_whole(self, out, workers=workers, scheduler=scheduler, force=force, progress=progress)

    @property
    def engine(self) -> str:
        """What ran the last `rows` of this process: ``lanes of 8``, ``compiled``, ``interpreted``."""
        return self._loops.engine

    def box(self, point: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """The least and the most that samples can set at a point, by ``block.parameter``; infinite without ends."""
        found = dict[str, tuple[np.ndarray, np.ndarray]]()
        for factor in self.factors:
            assert factor.spread is not None  # only a grid's factors have none
            ends = np.array([[factor.spread.lower], [factor.spread.upper]])
            ends = np.repeat(ends, len(factor.columns), axis=1)
            tried = list[dict[str, np.ndarray]]()
            for side in (0, 1):
                held = {label: ends_[side][None] for label, ends_ in found.items() if label in factor.labels}
                factor.put(held, ends, self.points[point].graph.experiment)
                tried.append(held)
            for label in factor.labels:
                corners = np.concatenate([held[label] for held in tried])
                found[label] = (corners.min(axis=0), corners.max(axis=0))
        return found

    def loop_of(self, experiment: Experiment) -> tuple[Diagram, dict[str, Any]]:
        """A closed loop that this process has ready, and the parameters in which a graph differs from it."""
        return self._loops.of(experiment)

    def on(self, bases: Mapping[str, Experiment]) -> Study:
        """The same study of other graphs, on the closed loops that are ready."""
        other = replace(self, bases=bases)
        other.__dict__["_loops"] = self._loops
        return other

    def check(self) -> None:
        """Build each closed loop, and prepare a run's values at each point.

        Raises
        ------
        DmframeError
            What the study's file promises, and its graphs do not have.
        """
        _ = self.measures
        faults = list[DmframeError]()
        for point in self.points:
            try:
                self.values(point.index, 0, 1)
            except DmframeError as error:
                faults += error.faults
        raise_all(faults)

    def _measured(self, here: Point, samples: np.ndarray, threads: int) -> Columns:
        experiment, count = here.graph.experiment, len(samples)
        diagram, _ = self._loops.of(experiment)
        wanted = self._wanted(diagram)
        if count and not any(self._apart(label) for factor in self.factors for label in factor.labels):
            values = self._values(here, samples)
            found = together(self._loops, experiment, values, count, wanted, threads)
            if found is not None:
                return rows_of(found, self.measures, count)
        alone = list[Experiment | DmframeError]()
        for sample in samples.tolist():
            try:
                alone.append(self.graph_of(sample * len(self.points) + here.index).experiment)
            except DmframeError as error:
                alone.append(error)
        parts = [
            faulty(each, self.measures, 1) if isinstance(each, DmframeError) else rows_of(each, self.measures, 1)
            for each in apart(self._loops, alone, wanted, threads)
        ]
        return joined(parts) if parts else faulty(ValueFault("none"), self.measures, 0)

    def _apart(self, label: str) -> bool:
        """True for what is no parameter of a block that has a value: its runs are prepared one by one."""
        block, _, key = label.partition(".")
        held = self.bases[""].blocks
        return label.startswith(START) or block not in held or getattr(held[block], key, None) is None

    @cached_property
    def _loops(self) -> Loops:
        return Loops()

    @cached_property
    def _diagrams(self) -> list[Diagram]:
        """The closed loops that the cases of each axis have, the others at their first case."""
        first, found = [0] * len(self.axes), list[Diagram]()
        for k, axis in enumerate(self.axes):
            if not all(_numbers_alone(given.label, axis) for case in axis.cases for given in case.sets) or any(
                case.graph for case in axis.cases
            ):
                for place in range(len(axis.cases)):
                    found.append(self._loops.of(self._point([*first[:k], place, *first[k + 1 :]]).graph.experiment)[0])
        found.insert(0, self._loops.of(self.points[0].graph.experiment)[0])
        return list({id(diagram): diagram for diagram in found}.values())

    def _point(self, places: Sequence[int]) -> Point:
        index = 0
        for axis, place in zip(self.axes, places, strict=True):
            index = index * len(axis.cases) + place
        return self.points[index]

    def row_of(self, run: Recording, graph: Graph) -> dict[str, Any]:
        """What the table would measure of a whole run of one of the study's graphs."""
        return row_of(run, self._wanted(graph.diagram), self.measures)

    def _wanted(self, diagram: Diagram) -> Wanted:
        """What is measured of a loop: the asked signals that it has, limits in their units."""
        units, (limits, faults) = _units_of(diagram), self._limits(diagram)
        _raise_placed(faults, self.document)
        signals = self.file.measure.signals
        return wanted_of([label for label in signals if label in units and label not in (ERROR, TURN)], limits)

    def _limits(self, diagram: Diagram) -> tuple[dict[str, float], list[DmframeError]]:
        """The limits of what a loop has, in its units; and the faults of those that do not fit."""
        units, faults, limits = _units_of(diagram), list[DmframeError](), dict[str, float]()
        for label, value in self.file.measure.limits.items():
            if label in units:
                try:
                    limits[label] = to_unit(value, units[label])
                except DmframeError as error:
                    text = f"measure.limits.{label}: {error.text}"
                    faults.append(type(error)(text, path=("measure", "limits", label)))
        return limits, faults

    def __reduce__(self) -> Any:
        """Small: the file's data and the graphs' documents; a process that has it ready uses that."""
        state = tuple(getattr(self, name) for name in self.__dataclass_fields__)
        return _again, (f"{self.key} {self.samples}", state)

    def __repr__(self) -> str:
        what = ", ".join(column.name for column in self.varied) or "nothing varies"
        return f"<Study {self.name}: {self.runs} runs, {len(self.points)} points x {self.samples} samples; {what}>"


_STUDIES: OrderedDict[str, Study] = OrderedDict()


def _again(name: str, state: tuple[Any, ...]) -> Study:
    """One that was pickled; that of this process where it is there, since its closed loops are built."""
    if name not in _STUDIES:
        _STUDIES[name] = Study(*state)
        while len(_STUDIES) > _READY:
            _STUDIES.popitem(last=False)
    _STUDIES.move_to_end(name)
    return _STUDIES[name]


def _numbers_alone(label: str, axis: Axis) -> bool:
    """True for a key that changes no wires and no blocks."""
    return not label.startswith(("blocks.", "robot", "wires")) or label.count(".") > 1


def _units_of(diagram: Diagram) -> dict[str, str]:
    """Of all that can be measured of a loop."""
    loop = diagram.loop
    units = {signal.label: signal.unit for signal in loop.outputs}
    units |= {variable.label: variable.unit for variable in loop.variables}
    goal = goal_of(loop)
    units |= {} if goal is None else {ERROR: units[goal.actual]}
    return units if apart_of(loop) is None else units | {TURN: TurnError.unit}


def _unknown(section: str, label: str, known: Iterable[str]) -> DmframeError:
    return UnknownNameError(f"measure.{section}", "signal", label, known, path=("measure", section))


def _raise_placed(faults: Sequence[DmframeError], document: Document) -> None:
    from dmframe.study.read import raise_placed

    raise_placed(faults, document)


def load_study(source: str | Path | Mapping[str, Any] | Study, **options: Any) -> Study:
    """A study from its file; see `dmframe.study.read.load_study`."""
    from dmframe.study import read

    return read.load_study(source, **options)
