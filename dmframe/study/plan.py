"""A study: a graph, what varies over how many runs, and each of its runs as a row or as a graph of its own."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.config.document import Document
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, ValueFault, raise_all
from dmframe.graph import Graph
from dmframe.simulate import Recording
from dmframe.study.design import Design
from dmframe.study.grammar import StudyFile
from dmframe.study.grid import Axis, Case, changed, scaled
from dmframe.study.measured import asked_of, measures_of, raise_at
from dmframe.study.rows import alone, band
from dmframe.study.table import Column, Columns, Loops, row_of
from dmframe.study.varied import Factor

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
            raise_at([fault], self.document)
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
        return measures_of(self)

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
        return alone(self, point, samples, threads)

    def band(self, point: int, end: int, first: int, stop: int, *, threads: int = 1) -> Columns:
        """The same rows of the points [point, end), one point after another, sooner: many differ in numbers alone.

        A batch advances several runs at once, and a grid of single runs has but one at each point.
        """
        return band(self, point, end, first, stop, threads)

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
        return row_of(run, asked_of(self, graph.diagram), self.measures)

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


def load_study(source: str | Path | Mapping[str, Any] | Study, **options: Any) -> Study:
    """A study from its file; see `dmframe.study.read.load_study`."""
    from dmframe.study import read

    return read.load_study(source, **options)
