"""Batch runner for many graphs; graphs that differ only in numbers share one closed loop."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import numpy as np

from dmframe.batch.batch import Batch
from dmframe.batch.figures import FigureTable, Measured, MeasuredSignals, merged
from dmframe.block.parameter import PAIRS, specs
from dmframe.common.errors import DmframeError, NeedsDiagramError
from dmframe.config import BaseGraph
from dmframe.config.places import placed
from dmframe.diagram import Diagram
from dmframe.diagram.values import changed_numbers
from dmframe.simulate.engine import Choice

KEPT: Final = 8
"""Number of closed loops, and of prepared batches, in a runner's cache."""


@final
@dataclass(frozen=True, eq=False)
class Runs:
    """`count` runs of one graph.

    Parameters
    ----------
    values
        By ``block.parameter`` a row per run, in the parameter's unit; other labels are keys of the graph file.
    """

    graph: BaseGraph
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    count: int = 1

    @property
    def batched(self) -> bool:
        """True if all values are parameters that the graph sets; other values require a graph per run."""
        blocks = self.graph.blocks
        labels = (label.partition(".") for label in self.values)
        return all(block in blocks and getattr(blocks[block], key, None) is not None for block, _, key in labels)


@final
@dataclass(eq=False)
class _Group:
    """Items with one closed loop, duration and settings; `numbers` are their parameters that differ from the loop."""

    diagram: Diagram
    members: list[Runs] = field(default_factory=list)
    numbers: list[dict[str, Any]] = field(default_factory=list)

    def rows(self) -> dict[str, np.ndarray] | None:
        """Columns of one batch for all items; None if their values have no common shape."""
        found = dict[str, np.ndarray]()
        labels = [label for item in self.members for label in item.values]
        for label in dict.fromkeys([label for numbers in self.numbers for label in numbers] + labels):
            block, _, key = label.partition(".")
            own = getattr(self.diagram.blocks[block], key)
            full = self.diagram.models[block].values[key].shape
            if specs(type(self.diagram.blocks[block]))[key].form in PAIRS:
                full = np.shape(own)  # two bounds; each may be one number for all elements
            parts = list[np.ndarray]()
            for item, numbers in zip(self.members, self.numbers, strict=True):
                given = item.values.get(label)
                given = np.asarray(numbers.get(label, own), dtype=float)[None] if given is None else given
                given = given.reshape(-1, *(1 for _ in full)) if given.ndim == 1 else given
                try:
                    parts.append(np.broadcast_to(given, (item.count, *full)))
                except ValueError:
                    return None
            found[label] = np.concatenate(parts)
        return found


@final
@dataclass(eq=False)
class Runner:
    """Cache of closed loops and prepared batches in one process.

    Attributes
    ----------
    engine
        Engine of the last batch, see `Measured.engine`.
    """

    engine: str = ""
    _loops: OrderedDict[int, tuple[BaseGraph, Diagram]] = field(default_factory=OrderedDict, repr=False)
    _batches: OrderedDict[str, Batch] = field(default_factory=OrderedDict, repr=False)

    def measure(
        self,
        several: Sequence[Runs],
        wanted: Callable[[Diagram], MeasuredSignals],
        *,
        engine: Choice = "compiled",
        threads: int | None = None,
    ) -> list[Measured]:
        """Measure the figures of each item, in order.

        Items that differ only in numbers run in one batch. A run whose values change the equations gets its own closed
        loop.

        Parameters
        ----------
        wanted
            Selects what to measure of a closed loop.

        Raises
        ------
        DmframeError
            A graph that cannot be built. (Faults of single runs are in `Measured.faults`.)
        """
        found, how = dict[int, Measured](), {"engine": engine, "threads": threads}
        for group in self._groups(several):
            rows = group.rows() if len(group.members) > 1 else None
            count = sum(item.count for item in group.members)
            whole = None if rows is None else self._batch(group.diagram, group.members[0], wanted, rows, count, how)
            if whole is not None:
                ends = np.cumsum([item.count for item in group.members]).tolist()
                for item, end in zip(group.members, ends, strict=True):
                    found[id(item)] = whole.part(end - item.count, end)
        return [found.get(id(item)) or self._one(item, wanted, how) for item in several]

    def loop_of(self, graph: BaseGraph) -> tuple[Diagram, dict[str, Any]]:
        """Cached closed loop, and the parameters in which the graph differs from it.

        Raises
        ------
        DmframeError
            The graph cannot be built.
        """
        for key, (other, diagram) in self._loops.items():
            numbers = numbers_between(other, graph)
            if numbers is not None:
                self._loops.move_to_end(key)
                return diagram, numbers
        return self.own_loop(graph), {}

    def own_loop(self, graph: BaseGraph, diagram: Diagram | None = None) -> Diagram:
        """Closed loop of the graph; `diagram` if it is already built."""
        for other, own in self._loops.values():
            if other is graph:
                return own
        diagram = diagram or graph.diagram
        self._loops[max(self._loops, default=0) + 1] = (graph, diagram)
        _trim(self._loops)
        return diagram

    def _groups(self, several: Sequence[Runs]) -> list[_Group]:
        groups = dict[str, _Group]()
        for item in several if len(several) > 1 else ():
            if item.batched and item.count:
                diagram, numbers = self.loop_of(item.graph)
                key = repr((id(diagram), item.graph.file.duration, item.graph.settings))
                group = groups.setdefault(key, _Group(diagram))
                group.members.append(item)
                group.numbers.append(numbers)
        return list(groups.values())

    def _one(self, item: Runs, wanted: Callable[[Diagram], MeasuredSignals], how: Mapping[str, Any]) -> Measured:
        """Measure one item: on a shared loop, else on its own, else with a graph per run."""
        diagram, numbers = self.loop_of(item.graph)
        found: Measured | None = None
        if item.batched and item.count:
            fixed = {label: np.asarray(value, dtype=float) for label, value in numbers.items()}
            rows = {label: np.broadcast_to(value, (item.count, *value.shape)) for label, value in fixed.items()}
            found = self._batch(diagram, item, wanted, {**rows, **item.values}, item.count, how)
            if found is None and fixed:
                own = self.own_loop(item.graph)
                found = self._batch(own, item, wanted, item.values, item.count, how)
            assert found is not None or item.values  # the graph's own numbers fit its own loop
        return found or self._run_by_run(item, diagram, wanted, how)

    def _run_by_run(
        self, item: Runs, diagram: Diagram, wanted: Callable[[Diagram], MeasuredSignals], how: Mapping[str, Any]
    ) -> Measured:
        """Measure one item with a graph per run."""
        parts, faults = list[tuple[np.ndarray, Measured]](), dict[int, DmframeError]()
        for run in range(item.count):
            try:
                numbers = {label: rows[run].tolist() for label, rows in item.values.items()}
                (one,) = self.measure([Runs(item.graph.set(numbers))], wanted, **how)
                parts.append((np.array([run]), one))
            except DmframeError as error:
                faults[run] = error
        if not parts:
            layout = Batch.of(diagram, item.graph.file.duration, wanted=wanted(diagram)).layout
            return replace(FigureTable(layout, item.count).measured(), faults=faults)
        found = merged(parts, item.count)
        return replace(found, faults={**found.faults, **faults})

    def _batch(
        self,
        diagram: Diagram,
        item: Runs,
        wanted: Callable[[Diagram], MeasuredSignals],
        values: Mapping[str, np.ndarray],
        count: int,
        how: Mapping[str, Any],
    ) -> Measured | None:
        """Run one batch with the settings of an item's graph; None if a value changes the equations."""
        graph = item.graph
        settings, measured = {**graph.settings, **how}, wanted(diagram)
        key = repr((id(diagram), graph.file.duration, measured, settings))
        if key not in self._batches:
            self._batches[key] = Batch.of(diagram, graph.file.duration, wanted=measured, **settings)
            _trim(self._batches)
        self._batches.move_to_end(key)
        try:
            found = self._batches[key].measure(values, count)
        except NeedsDiagramError:
            return None
        except DmframeError as error:
            raise placed(error, graph.document) from None
        self.engine = found.engine
        return found


def numbers_between(base: BaseGraph, other: BaseGraph) -> dict[str, Any] | None:
    """Parameters, by label, in which two graphs of one closed loop differ; None if the loops differ."""
    if base.file.robot != other.file.robot or base.file.wires != other.file.wires:
        return None
    return changed_numbers(base.blocks, other.blocks)


def _trim(kept: OrderedDict[Any, Any]) -> None:
    while len(kept) > KEPT:
        kept.popitem(last=False)
