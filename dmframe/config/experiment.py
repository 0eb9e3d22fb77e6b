"""Experiments: the blocks, wires, robot and run settings of a graph file."""

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
"""A function that sets a value in a document; it can be pickled."""


@final
@dataclass(frozen=True)
class Stating:
    """A document that still has its key ``reality``, and the later changes, so that the key can be changed again."""

    document: Document
    later: tuple[Step, ...] = ()


@final
@dataclass(frozen=True, repr=False)
class Experiment:
    """A graph file that has been read and checked, with its blocks.

    Its methods use the file's clock, solver, start, log and intervals.

    Parameters
    ----------
    name
        The file's name without its suffix.
    data
        The file as plain data, after overrides; `run` writes it next to its results.
    overrides
        The values that were set, as arguments of ``--set``.
    swapped
        For a file's baseline, the blocks that replace others of the file; None for the graph itself.
    unexpanded
        The document before ``reality`` inserted its blocks, if the graph has this key.
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
    unexpanded: Stating | None = None

    @property
    def solver(self) -> Solver:
        """The solver that the file specifies."""
        section = self.file.solver
        return Solver(section.method, section.step, section.output, section.tolerance, section.share)

    @property
    def log(self) -> Log:
        """The signals and instants that the file specifies for recording."""
        return Log(self.file.log.every, self.file.log.signals)

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of `simulate` other than the diagram and the duration."""
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
        """The diagram, wired and flattened, with the run settings checked; faults have their place in the file.

        Checks that need a pose or a proof are made in `simulate` and `verify`.
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
        """Raise the inconsistencies in the units of the blocks' equations, certificates and conditions."""
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
        """Run it; faults have their place in the file. See `dmframe.simulate.simulate`.

        Parameters
        ----------
        diagram
            Its own diagram if it exists already, or one with other numbers.
        log
            What is recorded, if that differs from the file.
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
        """Prove it, or give the reason why not; faults have their place in the file. See `dmframe.certify.verify`."""
        from dmframe.certify import verify

        diagram = diagram or self.diagram()
        try:
            with SYMBOLIC:
                return verify(diagram, seed=seed, uncertain=self.intervals(diagram), start=self.start)
        except DmframeError as error:
            raise placed(error, self.document) from None

    def intervals(self, diagram: Diagram) -> Mapping[str, Sequence[Interval]]:
        """The true parameters that the file gives as intervals; faults have their place in the file.

        A run does not use them: its parameters may lie outside.
        """
        from dmframe.certify.uncertain import intervals

        try:
            return intervals(diagram, self.file.uncertain)
        except DmframeError as error:
            raise placed(error, self.document) from None

    def baseline(self) -> Experiment:
        """The same graph with the blocks of its key `baseline`, and without the wires of removed blocks.

        Raises
        ------
        MissingError
            The file has no such key.
        """
        if not self.file.baseline:
            raise MissingError(f"{self.name}: expected a key baseline, with the blocks to compare with; found none")
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
        """The same graph with other values, ``{"task.gamma": 2, "clock": "2 ms"}``, as with ``--set``.

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
        """The document with values set, those of ``reality`` first, whose earlier blocks are removed as with ``--set``.

        Faults of the values are added to `faults`; a fault of a set of channel models is raised.
        """
        document, unexpanded = self.document, self.unexpanded
        if real:
            document = _after(unexpanded.document if unexpanded else document, real, faults)
            unexpanded = Stating(document, unexpanded.later if unexpanded else ())
            document = _after(_expanded(document, find_block), unexpanded.later, faults)
        return _after(document, others, faults), _then(unexpanded, *others)

    def remade(self, changed: tuple[Document, Stating | None], overrides: Sequence[str]) -> Experiment:
        """The graph of a changed document, see `with_steps`, with these overrides added to its own."""
        document, unexpanded = changed
        made = experiment_of(document, like=self)
        overrides = (*self.overrides, *overrides)
        return replace(made, name=self.name, overrides=overrides, swapped=self.swapped, unexpanded=unexpanded)

    def with_duration(self, duration: float) -> Experiment:
        """The same graph with another duration [s]."""
        document = put(self.document, "duration", duration, f"--until {duration:g}")
        file = self.file.model_copy(update={"duration": duration})
        data = {**self.data, "duration": duration}
        unexpanded = _then(self.unexpanded, partial(_changed, values={"duration": duration}))
        return replace(self, file=file, data=data, document=document, unexpanded=unexpanded)

    def __reduce__(self) -> Any:
        """Pickled as its document: another process creates the blocks again."""
        return _again, (self.document, self.name, self.overrides, self.swapped, self.unexpanded)

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
    A former name is read as the new one, with a notice on stderr; see `dmframe.config.renamed`.
    """
    path = find_graph(str(source))
    document = read_file(path)
    _report_changes(path)
    first, others = _parted(overrides)
    unexpanded = overridden(document, first, KEYS)
    made, later = (
        experiment_of(_overridden(_expanded(unexpanded, find_block), others)),
        (partial(_overridden, overrides=others),),
    )
    return replace(
        made, overrides=tuple(overrides), unexpanded=Stating(unexpanded, later) if KEY in unexpanded.data else None
    )


def _report_changes(path: Path) -> None:
    """Report on stderr which files of a sealed folder have changed since it was written; signals are not read."""
    folder = folder_of(path)
    if folder is not None:
        near = path.parent.resolve()
        for text in faults(folder, lambda name: (folder / name).resolve().parent == near and not name.endswith(".nc")):
            sys.stderr.write(f"{visible(f'{folder}: notice: {text}')}\n")


def with_overrides(document: Document, overrides: Sequence[str], find: Find = find_block) -> Document:
    """The document with ``--set`` values; those of ``reality`` come first, so that later ones can change its blocks."""
    first, others = _parted(overrides)
    return _overridden(_expanded(overridden(document, first, KEYS), find), others)


def _parted(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """The overrides of ``reality``, and all others."""
    first = [text for text in overrides if names_reality(text.partition("=")[0])]
    return first, [text for text in overrides if text not in first]


def _overridden(document: Document, overrides: Sequence[str]) -> Document:
    return overridden(document, overrides, KEYS)


def _changed(document: Document, values: Mapping[str, Any]) -> Document:
    return changed(document, values, KEYS)


def _after(document: Document, steps: Sequence[Step], faults: list[DmframeError]) -> Document:
    """The document after some steps; the faults of each are added to `faults`."""
    for step in steps:
        try:
            document = step(document)
        except DmframeError as error:
            faults += error.faults
    return document


def _then(unexpanded: Stating | None, *steps: Step) -> Stating | None:
    """The document before ``reality``, with further changes."""
    return replace(unexpanded, later=(*unexpanded.later, *steps)) if unexpanded else None


def _expanded(document: Document, find: Find) -> Document:
    """The document with the blocks of its key ``reality``; blocks that are left out are reported on stderr."""
    found = with_reality(document, Path(document.name).parent, find)
    for notice in found.notices:
        sys.stderr.write(f"{visible(notice)}\n")
    return found.document


def experiment_of(document: Document, find: Find = find_block, like: Experiment | None = None) -> Experiment:
    """An experiment from its document, whose former names are read as the new ones; `find` gives the class of a type.

    If its section ``robot`` equals that of the experiment `like`, it uses the same model, which takes longer to read
    than everything else. Raises the errors of `load_experiment`.
    """
    path, unexpanded = Path(document.name), Stating(document) if KEY in document.data else None
    document = _expanded(document, find)
    read = with_new_names(document, path.parent, find)
    raise_all(read.faults)
    for notice in read.notices:
        sys.stderr.write(f"{visible(notice)}\n")
    return replace(_made(read.document, path, find, like), unexpanded=unexpanded)


def _again(
    document: Document,
    name: str,
    overrides: tuple[str, ...],
    swapped: tuple[str, ...] | None = None,
    unexpanded: Stating | None = None,
) -> Experiment:
    """A pickled experiment."""
    return replace(experiment_of(document), name=name, overrides=overrides, swapped=swapped, unexpanded=unexpanded)


def _made(document: Document, path: Path, find: Find = find_block, like: Experiment | None = None) -> Experiment:
    """An experiment from its document; `path` names it, and files are searched in its folder. See `experiment_of`."""
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
    assert file is not None  # an invalid file has raised its faults
    return Experiment(path.stem, file, data, document, blocks, robot, start)
