"""Runs of a study as rows of its table: each point's closed loop is built once, and its samples are run together."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from dmframe.batch import Batch, Figures, Measured, Wanted
from dmframe.batch.figures import ERROR, TURN
from dmframe.batch.whole import of_run
from dmframe.config.experiment import Experiment
from dmframe.config.places import placed
from dmframe.diagram import Diagram
from dmframe.diagram.values import changed_numbers
from dmframe.errors import DmframeError, NeedsDiagramError
from dmframe.parameter import PAIRS, specs
from dmframe.results.metrics import EIGHTHS, TurnError, goal_of
from dmframe.simulate import Recording
from dmframe.simulate.keep import apart_of

KEPT: Final = 8
"""Closed loops that a process keeps ready."""
FIGURES: Final = ("least", "most", "last", "rms_final")
Columns = dict[str, Any]


@final
@dataclass(frozen=True)
class Column:
    """A column of a study's table.

    Parameters
    ----------
    kind
        ``grid``, ``sampled`` or ``measured``.
    how
        Of what varies: its ``value``, a ``scale`` of the graph's own or a ``shift`` from it.
    """

    name: str
    unit: str
    kind: str
    how: str = "value"


@final
@dataclass
class Loops:
    """Closed loops by what they are built of: graphs that differ in numbers alone share one.

    Attributes
    ----------
    batches
        What is ready to measure them, by diagram and by how they are run.
    engine
        What ran the last of them.
    """

    held: OrderedDict[int, tuple[Experiment, Diagram]] = field(default_factory=OrderedDict)
    batches: OrderedDict[str, Batch] = field(default_factory=OrderedDict)
    engine: str = ""

    def batch(self, diagram: Diagram, experiment: Experiment, wanted: Wanted, threads: int) -> Batch:
        """Always compiled, where it can be: one engine for chunks of any size."""
        settings = {**experiment.settings, "engine": "compiled", "threads": threads}
        key = repr((id(diagram), experiment.file.duration, wanted, settings))
        if key not in self.batches:
            self.batches[key] = Batch.of(diagram, experiment.file.duration, wanted=wanted, **settings)
            while len(self.batches) > KEPT:
                self.batches.popitem(last=False)
        self.batches.move_to_end(key)
        return self.batches[key]

    def of(self, experiment: Experiment) -> tuple[Diagram, dict[str, Any]]:
        """A diagram, and the parameters in which the graph differs from it. Raises what `Experiment.diagram` does."""
        for key, (other, diagram) in self.held.items():
            if experiment.file.robot != other.file.robot or experiment.file.wires != other.file.wires:
                continue
            numbers = changed_numbers(other.blocks, experiment.blocks)
            if numbers is not None:
                self.held.move_to_end(key)
                return diagram, numbers
        return self.own(experiment), {}

    def own(self, experiment: Experiment) -> Diagram:
        """The graph's own diagram, kept."""
        for other, diagram in self.held.values():
            if other is experiment:
                return diagram
        diagram = experiment.diagram()
        self.held[max(self.held, default=0) + 1] = (experiment, diagram)
        while len(self.held) > KEPT:
            self.held.popitem(last=False)
        return diagram


@final
@dataclass
class Group:
    """Grid points of one closed loop, clock, duration and solver, that differ in numbers alone.

    Attributes
    ----------
    points, numbers
        Their indices, and of each the parameters in which it differs from the diagram.
    """

    experiment: Experiment
    diagram: Diagram
    points: list[int] = field(default_factory=list)
    numbers: list[dict[str, Any]] = field(default_factory=list)

    def takes(self, experiment: Experiment, diagram: Diagram) -> bool:
        """A graph of that loop may join."""
        own = self.experiment
        alike = (experiment.file.duration, experiment.settings) == (own.file.duration, own.settings)
        return diagram is self.diagram and alike

    def measured(self, values: Sequence[Mapping[str, np.ndarray]], count: int, batch: Batch) -> Measured | None:
        """`count` runs of each point in one batch, `values` being what is drawn at each; None where that cannot be."""
        labels = dict.fromkeys(label for part in (*self.numbers, *values) for label in part)
        rows = dict[str, np.ndarray]()
        for label in labels:
            block, _, key = label.partition(".")
            own = getattr(self.diagram.blocks[block], key)
            full = self.diagram.models[block].values[key].shape
            if specs(type(self.diagram.blocks[block]))[key].form in PAIRS:
                full = np.shape(own)  # two ends, each of which may stand for all elements
            parts = list[np.ndarray]()
            for numbers, drawn in zip(self.numbers, values, strict=True):
                given = drawn[label] if label in drawn else np.asarray(numbers.get(label, own), dtype=float)[None]
                parts.append(given.reshape(-1, *(1 for _ in full)) if given.ndim == 1 else given)
            try:
                rows[label] = np.concatenate([np.broadcast_to(part, (count, *full)) for part in parts])
            except ValueError:  # written in ways that no array holds
                return None
        return _measured(batch, self.experiment, rows, count)


def wanted_of(signals: Sequence[str], limits: Mapping[str, float]) -> Wanted:
    """What `measure` is asked for: signals with a limit are measured, too."""
    return Wanted(tuple(dict.fromkeys([*signals, *(key for key in limits if key not in (ERROR, TURN))])), dict(limits))


def columns_of(diagram: Diagram, wanted: Wanted) -> list[Column]:
    """The columns of a loop's figures."""
    loop, limits = diagram.loop, wanted.limits or {}
    found = [Column("diverged", "", "measured"), Column("diverged_at", "s", "measured")]
    goal = goal_of(loop)
    if goal is not None:
        unit = next(signal.unit for signal in loop.outputs if signal.label == goal.actual)
        names = [*(f"rms_{k}" for k in range(1, EIGHTHS + 1)), "rms_final", "error_most"]
        found += [Column(name, unit, "measured") for name in names]
        if ERROR in limits:
            found.append(Column("error_crossed", "s", "measured"))
    if apart_of(loop) is not None:
        names = [*(f"turn_{k}" for k in range(1, EIGHTHS + 1)), "turn_final", "turn_most"]
        found += [Column(name, TurnError.unit, "measured") for name in names]
        if TURN in limits:
            found.append(Column("turn_crossed", "s", "measured"))
    sizes = {item.label: (item.symbol.numel(), item.unit) for item in loop.variables}
    sizes |= {item.label: (item.expression.numel(), item.unit) for item in loop.outputs}
    for label in wanted.signals:
        rows, unit = sizes[label]
        for k in range(rows):
            name = label if rows == 1 else f"{label}[{k}]"
            found += [Column(f"{name}.{figure}", unit, "measured") for figure in FIGURES]
            if label in limits:
                found.append(Column(f"{name}.crossed", "s", "measured"))
    return found


def together(
    loops: Loops, experiment: Experiment, values: Mapping[str, np.ndarray], count: int, wanted: Wanted, threads: int
) -> Measured | None:
    """Runs whose values are columns of one batch; None where some value needs a diagram of its own."""
    diagram, numbers = loops.of(experiment)
    fixed = {label: np.asarray(value, dtype=float) for label, value in numbers.items()}
    rows = {label: np.broadcast_to(value, (count, *value.shape)) for label, value in fixed.items()} | dict(values)
    found = _measured(loops.batch(diagram, experiment, wanted, threads), experiment, rows, count)
    if found is None and fixed:  # what differs from the shared loop may shape it
        found = _measured(loops.batch(loops.own(experiment), experiment, wanted, threads), experiment, values, count)
    if found is not None:
        loops.engine = found.engine
    return found


def apart(
    loops: Loops, experiments: Iterable[Experiment | DmframeError], wanted: Wanted, threads: int
) -> list[Measured | DmframeError]:
    """Runs one by one, each on its own graph."""
    found = list[Measured | DmframeError]()
    for experiment in experiments:
        if isinstance(experiment, DmframeError):
            found.append(experiment)
            continue
        try:
            one = together(loops, experiment, {}, 1, wanted, threads)
            assert one is not None  # on a diagram of its own nothing differs
            found.append(one)
        except DmframeError as error:
            found.append(error)
    return found


def _measured(batch: Batch, experiment: Experiment, values: Mapping[str, np.ndarray], count: int) -> Measured | None:
    """None where a value shapes the diagram."""
    try:
        return batch.measure(values, count)
    except NeedsDiagramError:
        return None
    except DmframeError as error:
        raise placed(error, experiment.document) from None


def rows_of(found: Measured, columns: Sequence[Column], count: int) -> Columns:
    """The measured columns of some runs; nan where a loop has no such figure."""
    told: Columns = {column.name: np.full(count, np.nan) for column in columns}
    told["diverged"], told["diverged_at"] = np.isfinite(found.diverged), found.diverged
    for label, figures in found.signals.items():
        of = _OF.get(label)
        for name, values in (_of_signal(label, figures) if of is None else _of_error(figures, *of)).items():
            if name in told:
                told[name] = values
    told["fault"] = [str(found.faults[k]) if k in found.faults else None for k in range(count)]
    return told


_OF: Final = {ERROR: ("rms", "error"), TURN: ("turn", "turn")}
"""What the figures of the errors are called: of RMS values, and of others."""


def _of_error(figures: Figures, rms: str, name: str) -> dict[str, np.ndarray]:
    eighths = {f"{rms}_{k + 1}": figures.rms_by_eighth[:, 0, k] for k in range(EIGHTHS)}
    return eighths | {
        f"{rms}_final": figures.rms_final[:, 0],
        f"{name}_most": figures.most[:, 0],
        f"{name}_crossed": figures.crossed[:, 0],
    }


def _of_signal(label: str, figures: Figures) -> dict[str, np.ndarray]:
    rows = figures.last.shape[1]
    found = dict[str, np.ndarray]()
    for k in range(rows):
        name = label if rows == 1 else f"{label}[{k}]"
        found |= {f"{name}.{figure}": getattr(figures, figure)[:, k] for figure in (*FIGURES, "crossed")}
    return found


def row_of(run: Recording, wanted: Wanted, columns: Sequence[Column]) -> dict[str, Any]:
    """The measured columns of one whole run."""
    told = of_run(run, wanted)
    signals = {
        label: Figures(each.unit, each.rms_by_eighth[None], each.least[None], each.most[None], each.last[None],
                       each.crossed[None])
        for label, each in told.figures.items()
    }  # fmt: skip
    rows = rows_of(Measured(signals, np.array([told.diverged]), {}, (), told.engine), columns, 1)
    return {column.name: rows[column.name][0].item() for column in columns}


def faulty(fault: DmframeError, columns: Sequence[Column], count: int) -> Columns:
    """The measured columns of runs that cannot be made."""
    told: Columns = {column.name: np.full(count, np.nan) for column in columns}
    return told | {"diverged": np.zeros(count, dtype=bool), "fault": [str(fault)] * count}


def joined(parts: Sequence[Columns]) -> Columns:
    """Columns of runs, one after another."""
    return {
        name: [item for part in parts for item in part[name]]
        if isinstance(parts[0][name], list)
        else np.concatenate([part[name] for part in parts])
        for name in parts[0]
    }
