"""An experiment, as a graph file describes it: blocks, wires and a robot, and how they are run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from pydantic import ValidationError

from dmframe.block import AbstractBlock
from dmframe.block.model import SYMBOLIC
from dmframe.catalogue import find_block, find_graph
from dmframe.config.document import Document, mapping_of, read_file
from dmframe.config.grammar import KEYS, GraphFile, fault_of
from dmframe.config.overrides import changed, overridden, put, texts_of
from dmframe.config.places import placed
from dmframe.config.reality import KEY, names_reality, split, with_reality
from dmframe.config.renamed import Find, with_new_names
from dmframe.config.sections import at_name, blocks_of, check_baseline, robot_of, start_of, tolerance_in
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, MissingError, raise_all, visible
from dmframe.exact.rational import Interval
from dmframe.seal import faults, folder_of
from dmframe.simulate import Log, Recording, Solver, simulate
from dmframe.simulate.engine import Choice
from dmframe.simulate.march import Progress
from dmframe.simulate.run import check_run

if TYPE_CHECKING:
    from dmframe.certify import Verdict


Step = Callable[[Document], Document]
"""Puts a value into a document; it can be pickled."""


@final
@dataclass(frozen=True)
class Stating:
    """A document that still has its key ``reality``, and what was set after that, so that it can be asked for anew."""

    document: Document
    later: tuple[Step, ...] = ()


@final
@dataclass(frozen=True, repr=False)
class Experiment:
    """A graph file that has been read and checked, with its blocks made.

    Its clock, solver, start, log and intervals go along with whatever is asked of it.

    Parameters
    ----------
    name
        The file's name without its ending.
    data
        The file as plain data, after overrides: what `run` writes beside its results.
    overrides
        What was set, as ``--set`` has it.
    swapped
        In a file's baseline the blocks that are there for others of the file; None for the graph itself.
    asked
        Where ``reality`` put blocks in, what was asked of it.
    """

    name: str
    file: GraphFile
    data: Mapping[str, Any]
    document: Document
    blocks: Mapping[str, AbstractBlock]
    robot: Any
    start: Mapping[str, Any]
    overrides: tuple[str, ...] = ()
    swapped: tuple[str, ...] | None = None
    asked: Stating | None = None

    @property
    def solver(self) -> Solver:
        """The solver that the file asks for."""
        section = self.file.solver
        return Solver(section.method, section.step, section.output, section.tolerance, section.share)

    @property
    def log(self) -> Log:
        """What the file asks to be kept."""
        return Log(self.file.log.every, self.file.log.signals)

    @property
    def settings(self) -> dict[str, Any]:
        """All that `simulate` is told of a run beside the diagram and the duration."""
        file = self.file
        return {
            "clock": file.clock,
            "solver": self.solver,
            "log": self.log,
            "start": self.start,
            "seed": file.seed,
            "jitter": file.jitter,
        }

    def diagram(self) -> Diagram:
        """Wire and flatten it, and check what the file says of runs; faults carry their place in the file.

        What needs a pose, or a proof, is left to `simulate` and `verify`.
        """
        file = self.file
        try:
            with SYMBOLIC:
                diagram = Diagram.build(self.blocks, file.wires, self.robot)
            check_run(diagram, file.duration, **self.settings)
            if file.tolerance is not None and (goal := diagram.loop.goal) is not None:
                unit = next(out.unit for out in diagram.loop.outputs if out.label == goal.actual)
                tolerance_in(unit, file, self.document)
            return diagram
        except DmframeError as error:
            raise placed(error, self.document) from None

    def check_units(self, diagram: Diagram) -> None:
        """Raise what disagrees in the units of the blocks' equations, certificates and conditions."""
        try:
            raise_all(diagram.unit_faults)
        except DmframeError as error:
            raise placed(error, self.document) from None

    def simulate(
        self,
        diagram: Diagram | None = None,
        *,
        engine: Choice = "auto",
        progress: Progress | None = None,
        log: Log | None = None,
    ) -> Recording:
        """Run it; faults carry their place in the file. See `dmframe.simulate.simulate`.

        Parameters
        ----------
        diagram
            Its own, where that is there already, or one with other numbers.
        log
            What is kept, where that is not what the file says.
        """
        try:
            return simulate(
                diagram or self.diagram(),
                self.file.duration,
                progress=progress,
                engine=engine,
                **(self.settings if log is None else {**self.settings, "log": log}),
            )
        except DmframeError as error:
            raise placed(error, self.document) from None

    def verify(self, diagram: Diagram | None = None, *, seed: int = 0) -> Verdict:
        """Prove it, or say why not; faults carry their place in the file. See `dmframe.certify.verify`."""
        from dmframe.certify import verify

        diagram = diagram or self.diagram()
        try:
            with SYMBOLIC:
                return verify(diagram, seed=seed, uncertain=self.intervals(diagram), start=self.start)
        except DmframeError as error:
            raise placed(error, self.document) from None

    def intervals(self, diagram: Diagram) -> Mapping[str, Sequence[Interval]]:
        """The true parameters that the file knows up to an interval; faults carry their place in the file.

        A run does without: it may be one outside of them.
        """
        from dmframe.certify.uncertain import intervals

        try:
            return intervals(diagram, self.file.uncertain)
        except DmframeError as error:
            raise placed(error, self.document) from None

    def baseline(self) -> Experiment:
        """The same graph with the blocks of its key `baseline`, and without wires of blocks that are left out.

        Raises
        ------
        MissingError
            The file has no such key.
        """
        if not self.file.baseline:
            raise MissingError(f"{self.name}: expected a key baseline, which says what to compare with; found none")
        root: Any = self.document.root.value
        sections = {key: node.value for key, (_, node) in root.items()}
        changed = {**sections["blocks"], **sections["baseline"]}
        blocks = {name: pair for name, pair in changed.items() if pair[1].value is not None}
        gone = changed.keys() - blocks.keys()
        wires = {
            end: pair
            for end, pair in (sections.get("wires") or {}).items()
            if not {end.partition(".")[0], pair[1].value.partition(".")[0]} & gone
        }
        others = {"blocks": blocks, "wires": wires}
        entries = {
            key: (word, replace(node, value=others[key]) if key in others else node)
            for key, (word, node) in root.items()
            if key != "baseline"
        }
        path, node = Path(self.document.name), replace(self.document.root, value=entries)
        made = _made(Document(self.document.name, mapping_of(node), node), path.with_stem(f"{path.stem}_baseline"))
        swapped = tuple(name for name in sections["baseline"] if name in blocks)
        return replace(made, overrides=self.overrides, swapped=swapped)

    def changed(self, values: Mapping[str, Any]) -> Experiment:
        """The same with other values, ``{"task.gamma": 2, "clock": "2 ms"}``, as ``--set`` has them.

        Raises
        ------
        DmframeError
            All faults of the values at once.
        """
        real, others = split(values)
        overrides, faults = texts_of({**real, **others}), list[DmframeError]()
        steps = [[partial(_changed, values=part)] if part else [] for part in (real, others)]
        document = self.with_steps(steps[0], steps[1], faults)
        raise_all(faults)
        mine = [f"baseline.{text}" if text.partition(".")[0] in (self.swapped or ()) else text for text in overrides]
        return self.remade(document, mine)

    def with_steps(
        self, real: Sequence[Step], others: Sequence[Step], faults: list[DmframeError]
    ) -> tuple[Document, Stating | None]:
        """The document with values put in, those of ``reality`` first; blocks that it had put in go, as with ``--set``.

        Faults of the values are added to `faults`; one of the sets themselves is raised.
        """
        document, asked = self.document, self.asked
        if real:
            document = _after(asked.document if asked else document, real, faults)
            asked = Stating(document, asked.later if asked else ())
            document = _after(_expanded(document, find_block), asked.later, faults)
        return _after(document, others, faults), _then(asked, *others)

    def remade(self, changed: tuple[Document, Stating | None], overrides: Sequence[str]) -> Experiment:
        """The graph of a changed document, see `with_steps`, with these overrides added to its own."""
        document, asked = changed
        made = experiment_of(document, like=self)
        overrides = (*self.overrides, *overrides)
        return replace(made, name=self.name, overrides=overrides, swapped=self.swapped, asked=asked)

    def with_duration(self, duration: float) -> Experiment:
        """The same graph, run for another time [s]."""
        document = put(self.document, "duration", duration, f"--until {duration:g}")
        file = self.file.model_copy(update={"duration": duration})
        data, asked = (
            {**self.data, "duration": duration},
            _then(self.asked, partial(_changed, values={"duration": duration})),
        )
        return replace(self, file=file, data=data, document=document, asked=asked)

    def __reduce__(self) -> Any:
        """Pickled as its document: a process elsewhere makes its blocks anew."""
        return _again, (self.document, self.name, self.overrides, self.swapped, self.asked)

    def __repr__(self) -> str:
        return f"<Experiment {self.name}>"


def load_experiment(source: str | Path, overrides: Sequence[str] = ()) -> Experiment:
    """Read a graph file or a packaged graph.

    Parameters
    ----------
    source
        A path, or the name of a packaged graph.
    overrides
        ``block.parameter=value`` or ``key=value``, ``clock=4 ms``; the value as in YAML.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column.

    Notes
    -----
    A name from before is read as the new one, with a notice on stderr; see `dmframe.config.renamed`.
    """
    path = find_graph(str(source))
    document = read_file(path)
    _tell_changes(path)
    first, others = _parted(overrides)
    asked = overridden(document, first, KEYS)
    made, later = (
        experiment_of(_overridden(_expanded(asked, find_block), others)),
        (partial(_overridden, overrides=others),),
    )
    return replace(made, overrides=tuple(overrides), asked=Stating(asked, later) if KEY in asked.data else None)


def _tell_changes(path: Path) -> None:
    """Tell on stderr which files beside a graph of a sealed folder are not what was written; signals are not read."""
    folder = folder_of(path)
    if folder is not None:
        near = path.parent.resolve()
        for text in faults(folder, lambda name: (folder / name).resolve().parent == near and not name.endswith(".nc")):
            sys.stderr.write(f"{visible(f'{folder}: notice: {text}')}\n")


def with_overrides(document: Document, overrides: Sequence[str], find: Find = find_block) -> Document:
    """The document with ``--set`` values put in; what they say of ``reality`` first, so that its blocks are there."""
    first, others = _parted(overrides)
    return _overridden(_expanded(overridden(document, first, KEYS), find), others)


def _parted(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """What overrides say of ``reality``, and all others."""
    first = [text for text in overrides if names_reality(text.partition("=")[0])]
    return first, [text for text in overrides if text not in first]


def _overridden(document: Document, overrides: Sequence[str]) -> Document:
    return overridden(document, overrides, KEYS)


def _changed(document: Document, values: Mapping[str, Any]) -> Document:
    return changed(document, values, KEYS)


def _after(document: Document, steps: Sequence[Step], faults: list[DmframeError]) -> Document:
    """The document after some steps, the faults of each added to `faults`."""
    for step in steps:
        try:
            document = step(document)
        except DmframeError as error:
            faults += error.faults
    return document


def _then(asked: Stating | None, *steps: Step) -> Stating | None:
    """What was asked of ``reality``, and other values set after it."""
    return replace(asked, later=(*asked.later, *steps)) if asked else None


def _expanded(document: Document, find: Find) -> Document:
    """With the blocks of its key ``reality``; what is left out is told on stderr."""
    found = with_reality(document, Path(document.name).parent, find)
    for notice in found.notices:
        sys.stderr.write(f"{visible(notice)}\n")
    return found.document


def experiment_of(document: Document, find: Find = find_block, like: Experiment | None = None) -> Experiment:
    """An experiment from its document, whose old names are read as the new ones; `find` gives the class of a type.

    Where its robot is asked for in the words of another, `like`, that one's is taken: a model takes longer to read than
    all the rest. Raises what `load_experiment` does.
    """
    path, asked = Path(document.name), Stating(document) if KEY in document.data else None
    document = _expanded(document, find)
    read = with_new_names(document, path.parent, find)
    raise_all(read.faults)
    for notice in read.notices:
        sys.stderr.write(f"{visible(notice)}\n")
    return replace(_made(read.document, path, find, like), asked=asked)


def _again(
    document: Document,
    name: str,
    overrides: tuple[str, ...],
    swapped: tuple[str, ...] | None = None,
    asked: Stating | None = None,
) -> Experiment:
    """One that was pickled."""
    return replace(experiment_of(document), name=name, overrides=overrides, swapped=swapped, asked=asked)


def _made(document: Document, path: Path, find: Find = find_block, like: Experiment | None = None) -> Experiment:
    """An experiment from its document; `path` names it, and files are looked for beside it. See `experiment_of`."""
    data = document.data
    faults = list[DmframeError]()
    try:
        file = GraphFile.model_validate(data)
    except ValidationError as error:
        faults += [fault_of(detail) for detail in error.errors(include_url=False)]
        file = None
    blocks = blocks_of("blocks", data.get("blocks"), path.parent, faults, find)
    check_baseline(data.get("baseline"), data.get("blocks"), path.parent, faults, find)
    if like is not None and (like.data.get("robot"), like.document.name) == (data.get("robot"), document.name):
        robot = like.robot
    else:
        robot = robot_of(data.get("robot"), path.parent, faults)
    if isinstance(data.get("robot"), str):
        faults = [at_name(fault) for fault in faults]
    start = start_of(data.get("start"), faults)
    try:
        raise_all(faults)
    except DmframeError as error:
        raise placed(error, document) from None
    assert file is not None  # a file that is not valid left a fault
    return Experiment(path.stem, file, data, document, blocks, robot, start)
