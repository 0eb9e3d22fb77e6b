"""Study: a graph, its varied quantities, and its runs as table rows or as graphs."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.batch.columns import Column, Columns, columns_of, joined, limits_in, row_of, rows_of, units_of
from dmframe.batch.figures import ERROR, TURN, MeasuredSignals
from dmframe.batch.runner import Runner, Runs
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.config.document import Document
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording
from dmframe.study.design import Design
from dmframe.study.grammar import StudyFile, raise_placed
from dmframe.study.grid import Axis, Case, changed, scaled
from dmframe.study.identity import identity_of, key_of
from dmframe.study.packing import folder_files
from dmframe.study.varied import Factor

if TYPE_CHECKING:
    from dmframe.study.results import Results

_READY: Final = 4
"""Number of unpickled studies, with their closed loops, in a worker's cache."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Point:
    """A point of the grid.

    Parameters
    ----------
    index
        Index of the point; the last axis varies fastest.
    values
        Values by column of the grid.
    """

    index: int
    values: Mapping[str, float | str]
    cases: tuple[Case, ...] = field(repr=False)
    study: Study = field(repr=False)

    @cached_property
    def graph(self) -> Graph:
        """Graph at this point, without sampled quantities. Raises `DmframeError` at its place in the study."""
        study = self.study
        base = study.bases[next((case.graph for case in reversed(self.cases) if case.graph), "")]
        found = changed(base, [given for case in self.cases for given in case.sets])
        pairs = zip(study.axes, self.cases, strict=True)
        return scaled(found, [(axis, case.factor) for axis, case in pairs if case.factor is not None])

    def __repr__(self) -> str:
        values = ", ".join(f"{key}={value}" for key, value in self.values.items())
        return f"<Point {self.index}: {values or 'no grid'}>"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Study:
    """Graphs, varied quantities, and the number of runs; immutable.

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
        The same, validated.
    bases
        The graphs with the section ``set`` applied: the study's graph under "", others by their name in the grid.
    axes
        Axes of the grid.
    factors
        Sampled quantities.
    """

    name: str
    path: Path | None
    text: str
    document: Document = field(repr=False)
    file: StudyFile
    bases: Mapping[str, Graph]
    axes: tuple[Axis, ...]
    factors: tuple[Factor, ...]

    @property
    def title(self) -> str:
        """The title of the study's file, or of its graph."""
        return self.file.title or self.bases[""].file.title

    @property
    def samples(self) -> int:
        """Runs per grid point."""
        return self.file.sample.runs

    @property
    def runs(self) -> int:
        """Number of all runs."""
        return len(self.points) * self.samples

    @cached_property
    def points(self) -> tuple[Point, ...]:
        """Points of the grid; a single one without a grid."""
        sizes = [len(axis.cases) for axis in self.axes]
        found = list[Point]()
        for index, places in enumerate(np.ndindex(*sizes)):
            cases = tuple(axis.cases[place] for axis, place in zip(self.axes, places, strict=True))
            values = {axis.name: case.value for axis, case in zip(self.axes, cases, strict=True)}
            found.append(Point(index, values, cases, self))
        return tuple(found)

    @cached_property
    def noisy(self) -> bool:
        """True if a loop has noise or jitter; all samples of a point get the same realisation."""
        jitter = any(bool(graph.file.jitter) for graph in self.bases.values())
        jitter |= any(label == "jitter" for axis in self.axes for label in axis.labels)
        jitter |= any("jitter" in factor.labels for factor in self.factors)
        return jitter or any(diagram.loop.noises for diagram in self.diagrams)

    @property
    def design(self) -> Design:
        """The samples in the unit cube; the same at each point."""
        section = self.file.sample
        names = tuple(name for factor in self.factors for name in factor.columns)
        try:
            return Design(section.method, section.seed, names, section.runs)
        except ValueFault as fault:
            raise_placed([fault], self.document)
            raise

    @property
    def varied(self) -> tuple[Column, ...]:
        """Columns of varied quantities in the table."""
        grid = [Column(axis.name, axis.unit, "grid", "scale" if axis.scaled else "value") for axis in self.axes]
        sampled = [
            Column(name, factor.unit, "sampled", factor.how) for factor in self.factors for name in factor.columns
        ]
        return (*grid, *sampled)

    @cached_property
    def measures(self) -> tuple[Column, ...]:
        """Columns of figures in the table, for all closed loops of the grid.

        Raises
        ------
        DmframeError
            A graph that cannot be built, a signal that none of them has, a limit with the wrong unit.
        """
        section, known = self.file.measure, set[str]().union(*map(units_of, self.diagrams))
        signals = known - {ERROR, TURN}
        faults = [_unknown("signals", label, signals) for label in section.signals if label not in signals]
        faults += [_unknown("limits", label, known) for label in section.limits if label not in known]
        for diagram in self.diagrams:
            faults += limits_in(units_of(diagram), section.limits, "measure.limits")[1]
        raise_placed(faults, self.document)
        found = dict[str, Column]()
        for diagram in self.diagrams:
            for column in columns_of(diagram, self.wanted(diagram)):
                found.setdefault(column.name, column)
        return tuple(found.values())

    def wanted(self, diagram: Diagram) -> MeasuredSignals:
        """What to measure of a loop: the signals of the study's file that it has, and limits in their units."""
        units, section = units_of(diagram), self.file.measure
        limits, faults = limits_in(units, section.limits, "measure.limits")
        raise_placed(faults, self.document)
        signals = dict.fromkeys([*(label for label in section.signals if label in units), *limits])
        return MeasuredSignals(tuple(label for label in signals if label not in (ERROR, TURN)), limits)

    @cached_property
    def key(self) -> str:
        """Digest of all inputs that determine the numbers of a row; the number of rows is not included."""
        return key_of(self.identity)

    @cached_property
    def identity(self) -> Mapping[str, Any]:
        """Data whose digest is `key`, for the comparison of two studies."""
        return identity_of(self)

    def drawn(self, first: int, stop: int) -> dict[str, np.ndarray]:
        """Drawn values of the samples [first, stop), by column."""
        return self.drawn_at(np.arange(first, stop, dtype=np.int64))

    def drawn_at(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        """Drawn values of some samples, by column."""
        design, first = self.design, int(samples.min(initial=self.samples))
        points = design.points(first, int(samples.max(initial=first - 1)) + 1)[samples - first]
        found = dict[str, np.ndarray]()
        for factor in self.factors:
            for name, spread in zip(factor.columns, factor.spreads, strict=True):
                found[name] = spread.at(points[:, design.names.index(name)])
        return found

    def values(self, point: int, first: int, stop: int) -> dict[str, np.ndarray]:
        """Values of the samples [first, stop) at a point: rows by ``block.parameter``, in the parameter's own unit."""
        return self.values_of(point, np.arange(first, stop, dtype=np.int64))

    def values_of(self, point: int, samples: np.ndarray) -> dict[str, np.ndarray]:
        """`values` of any samples."""
        drawn, graph = self.drawn_at(samples), self.points[point].graph
        found = dict[str, np.ndarray]()
        for factor in self.factors:
            factor.put(found, np.stack([drawn[name] for name in factor.columns], axis=1), graph)
        return found

    def rows(self, point: int, first: int, stop: int, *, threads: int = 1) -> Columns:
        """Run the samples [first, stop) of a point; a sample's row does not depend on the others.

        Raises
        ------
        DmframeError
            A point whose graph cannot be built. (A run that cannot be prepared, or diverges, is a row.)
        """
        return self.band(point, point + 1, first, stop, threads=threads)

    def band(self, point: int, end: int, first: int, stop: int, *, threads: int = 1) -> Columns:
        """`rows` of the points [point, end), one after another; points that differ in numbers run in one batch."""
        samples = np.arange(first, stop, dtype=np.int64)
        return self.rows_at([(each, samples) for each in range(point, end)], threads)

    def rows_at(self, several: Sequence[tuple[int, np.ndarray]], threads: int) -> Columns:
        """The table's rows of some samples at each of several grid points, one point after another."""
        items = [Runs(self.points[point].graph, self.values_of(point, some), len(some)) for point, some in several]
        found = self.runner.measure(items, self.wanted, threads=threads)
        heads = [self._head(point, some) for point, some in several]
        return joined([head | rows_of(part, self.measures) for head, part in zip(heads, found, strict=True)])

    def _head(self, point: int, samples: np.ndarray) -> Columns:
        """Numbers of the runs, and the values of varied quantities."""
        count = len(samples)
        head: Columns = {"run": samples * len(self.points) + point, "point": np.full(count, point, dtype=np.int32)}
        head["sample"] = np.asarray(samples, dtype=np.int64)
        for name, value in self.points[point].values.items():
            head[name] = [value] * count if isinstance(value, str) else np.full(count, value)
        return head | self.drawn_at(samples)

    def graph_of(self, run: int) -> Graph:
        """One run as a graph of its own, with exactly the numbers of its row.

        Raises
        ------
        ValueFault
            There is no such run.
        """
        if isinstance(run, bool) or not isinstance(run, int) or not 0 <= run < self.runs:
            raise ValueFault(f"run: expected one from 0 to {self.runs - 1}, found {run!r:.40}")
        sample, point = divmod(run, len(self.points))
        numbers = {label: found[0].tolist() for label, found in self.values(point, sample, sample + 1).items()}
        graph = self.points[point].graph
        graph = graph.set(numbers) if numbers else graph
        return replace(graph, name=f"{self.name}_{run}")

    def run(
        self,
        out: str | Path | None = None,
        *,
        workers: int | None = None,
        scheduler: str | None = None,
        force: bool = False,
        progress: bool | None = None,
    ) -> Results:
        """Compute the rows that its folder lacks, as ``dmframe study`` does; `out` is ``studies/NAME`` by default.

        Raises
        ------
        DmframeError
            The folder holds something else, or not all rows could be computed; see `dmframe.study.execute.run_study`.
        """
        from dmframe.study.results import run_whole

        return run_whole(self, out, workers=workers, scheduler=scheduler, force=force, progress=progress)

    @property
    def engine(self) -> str:
        """Engine of the last rows in this process: ``SIMD batch of 8``, ``compiled``, ``interpreted``."""
        return self.runner.engine

    @cached_property
    def runner(self) -> Runner:
        """Closed loops that this process has built."""
        return Runner()

    def altered(self, **changes: Any) -> Study:
        """Copy of the study with other fields and the same closed loops."""
        other = replace(self, **changes)
        other.__dict__["runner"] = self.runner
        return other

    def check(self) -> None:
        """Build each closed loop, and prepare the values of a run at each point.

        Raises
        ------
        DmframeError
            The study's file names something that its graphs do not have.
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
    def diagrams(self) -> list[Diagram]:
        """Closed loops of the cases of each axis, with the other axes at their first case."""
        points = [self.points[0], *self.cases_that(_shapes)]
        found = [self.runner.loop_of(point.graph)[0] for point in points]
        return list({id(diagram): diagram for diagram in found}.values())

    def cases_that(self, shape: Callable[[Axis], bool]) -> list[Point]:
        """A point for each case of the axes for which `shape` is true, the other axes at their first case."""
        sizes = [len(axis.cases) for axis in self.axes]
        found = list[Point]()
        for k, axis in enumerate(self.axes):
            for place in range(sizes[k]) if shape(axis) else ():
                places = [place if j == k else 0 for j in range(len(sizes))]
                found.append(self.points[int(np.ravel_multi_index(places, sizes))])
        return found

    def files(self) -> dict[str, bytes]:
        """Contents of the files that make the study's folder self-contained, by name."""
        return folder_files(self)

    def row_of(self, run: Recording, graph: Graph) -> dict[str, Any]:
        """The table's figures of a whole run of one of the study's graphs."""
        return row_of(run, self.wanted(graph.diagram), self.measures)

    def __reduce__(self) -> Any:
        """Pickled as the file's data and the graphs' documents; a process that has the study ready uses its own."""
        state = tuple(getattr(self, name) for name in self.__dataclass_fields__)
        return _unpickled, (f"{self.key} {self.samples}", state)

    def __repr__(self) -> str:
        what = ", ".join(column.name for column in self.varied) or "nothing varies"
        return f"<Study {self.name}: {self.runs} runs, {len(self.points)} points x {self.samples} samples; {what}>"


_STUDIES: OrderedDict[str, Study] = OrderedDict()


def _unpickled(name: str, state: tuple[Any, ...]) -> Study:
    if name not in _STUDIES:
        _STUDIES[name] = Study(*state)
        while len(_STUDIES) > _READY:
            _STUDIES.popitem(last=False)
    _STUDIES.move_to_end(name)
    return _STUDIES[name]


def _shapes(axis: Axis) -> bool:
    """True for an axis that changes graphs, whole blocks, wires or the robot."""
    labels = [label for label in axis.labels if label.startswith(("blocks.", "robot", "wires"))]
    return any(case.graph for case in axis.cases) or any(label.count(".") < 2 for label in labels)


def _unknown(section: str, label: str, known: Iterable[str]) -> DmframeError:
    return UnknownNameError(f"measure.{section}", "signal", label, known, path=("measure", section))
