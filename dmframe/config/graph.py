"""A graph: the blocks, wires, robot and run settings of a graph file that has been read and checked."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError

from dmframe.block import AbstractBlock, type_name
from dmframe.block.model import SYMBOLIC
from dmframe.catalogue import find_graph
from dmframe.common.errors import DmframeError, MissingError, ValueFault, raise_all
from dmframe.common.files import expanded as expanded_path
from dmframe.common.files import write_text
from dmframe.common.seal import faults, folder_of
from dmframe.common.units import seconds
from dmframe.config.document import Document, read_file
from dmframe.config.grammar import KEYS, GraphFile, fault_of
from dmframe.config.overrides import changed, overridden, put, texts_of
from dmframe.config.places import placed, report
from dmframe.config.reality import KEY, Stating, Step, after, expanded, names_reality, split
from dmframe.config.registry import Registry
from dmframe.config.renamed import with_new_names
from dmframe.config.resolved import resolved_text
from dmframe.config.rivals import Entries, replaced_blocks, with_blocks
from dmframe.config.sections import at_name, blocks_of, check_replaced, robot_of, start_of, tolerance_in
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval
from dmframe.simulate import Log, Recording, Solver, simulate
from dmframe.simulate.engine import Choice
from dmframe.simulate.march import Progress
from dmframe.simulate.run import check_run

if TYPE_CHECKING:
    from dmframe.bounds.given import Torque
    from dmframe.certify import Verdict


@dataclass(frozen=True, repr=False, eq=False)
class BaseGraph:
    """A controller, its robot and their run settings, as every module below `dmframe.graph` reads them.

    `dmframe.Graph` is the only class of its objects: it adds the methods that use those modules. Faults have their
    place in the file.

    Parameters
    ----------
    name
        The file's name without its suffix.
    data
        The file as plain data, after overrides; `run` writes it next to its results.
    blocks
        By name; their parameters are attributes, ``g.blocks["dynamics"].Gamma``.
    robot
        The robot's chain of joints, a `dmframe.robot.SerialChain`; None without a robot.
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
    blocks: Registry[AbstractBlock]
    robot: Any
    start: Mapping[str, Any]
    overrides: tuple[str, ...] = ()
    swapped: tuple[str, ...] | None = None
    unexpanded: Stating | None = None

    @classmethod
    def read(cls, source: str | Path, overrides: Sequence[str] = ()) -> Self:
        """Read a graph file or a packaged graph.

        Parameters
        ----------
        source
            A path, or the name of a packaged graph.
        overrides
            ``block.parameter=value`` or ``key=value``, ``clock=4 ms``; the value as in YAML. Those of ``reality`` are
            applied first, so that others can change its blocks.

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
        first = [text for text in overrides if names_reality(text.partition("=")[0])]
        others = partial(overridden, overrides=[text for text in overrides if text not in first], known=KEYS)
        unexpanded = overridden(document, first, KEYS)
        made = cls.of(others(expanded(unexpanded)))
        stating = Stating(unexpanded, (others,)) if KEY in unexpanded.data else None
        return replace(made, overrides=tuple(overrides), unexpanded=stating)

    @classmethod
    def of(cls, document: Document, like: BaseGraph | None = None) -> Self:
        """A graph from its document, whose former names are read as the new ones.

        If its section ``robot`` equals that of the graph `like`, it uses the same model, which takes longer to read
        than everything else. Raises the errors of `read`.
        """
        path, unexpanded = Path(document.name), Stating(document) if KEY in document.data else None
        return replace(cls._made(with_new_names(expanded(document)), path, like), unexpanded=unexpanded)

    @classmethod
    def _made(cls, document: Document, path: Path, like: BaseGraph | None = None) -> Self:
        """A graph from its document; `path` names it, and files are searched in its folder. See `of`."""
        data, faults, file = document.data, list[DmframeError](), None
        try:
            file = GraphFile.model_validate(data)
        except ValidationError as error:
            faults += [fault_of(detail) for detail in error.errors(include_url=False)]
        blocks = blocks_of("blocks", data.get("blocks"), path.parent, faults)
        for key, section in replaced_blocks(data):
            check_replaced(key, section, data.get("blocks"), path.parent, faults)
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
        facts = {name: {"type": type_name(type(block)), "side": block.side.value} for name, block in blocks.items()}
        named = Registry("block", facts, blocks.__getitem__)
        return cls(path.stem, file, data, document, named, robot, start)

    @property
    def experiment(self) -> Self:
        """The graph itself: a former name, with a notice."""
        warnings.warn("graph.experiment is now the graph itself", DeprecationWarning, stacklevel=2)
        return self

    @property
    def title(self) -> str:
        """The graph's title, one line."""
        return self.file.title

    @property
    def clock(self) -> float | None:
        """Sampling period of the controller [s]; None in continuous time."""
        return self.file.clock

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return self.file.duration

    @property
    def solver(self) -> Solver:
        """The solver that the file specifies."""
        return self.file.solver.solver

    @property
    def log(self) -> Log:
        """The signals and instants that the file specifies for recording."""
        return Log(self.file.log.every, self.file.log.signals)

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of `simulate` other than the diagram and the duration."""
        file, start = self.file, self.start
        return {"clock": file.clock, "solver": self.solver, "log": self.log, "start": start} | {
            "seed": file.seed,
            "jitter": file.jitter,
        }

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Give faults raised in the context their place in the file."""
        try:
            yield
        except DmframeError as error:
            raise placed(error, self.document) from None

    @cached_property
    def diagram(self) -> Diagram:
        """Blocks wired and flattened into one closed loop, with the run settings checked.

        Checks that need a pose or a proof are made in `simulate` and `verdict`. Raises `DmframeError` with every fault
        of the wiring.
        """
        file = self.file
        with self.placing():
            with SYMBOLIC:
                diagram = Diagram.build(self.blocks, file.wires, self.robot)
            check_run(diagram, file.duration, **self.settings)
            if file.tolerance is not None and (goal := diagram.loop.goal) is not None:
                unit = next(out.unit for out in diagram.loop.outputs if out.label == goal.actual)
                tolerance_in(unit, file, self.document)
            return diagram

    def check_units(self) -> None:
        """Raise the inconsistencies in the units of the blocks' equations, certificates and conditions."""
        with self.placing():
            raise_all(self.diagram.unit_faults)

    def simulate(
        self,
        diagram: Diagram | None = None,
        *,
        engine: Choice = "auto",
        progress: Progress | None = None,
        log: Log | None = None,
    ) -> Recording:
        """The recording of a run. See `dmframe.simulate.simulate`.

        Parameters
        ----------
        diagram
            Its own, or one with other numbers.
        log
            What is recorded, if that differs from the file.
        """
        settings = {**self.settings, "solver": self.solver.checked, "log": log or self.log}
        settings |= {"engine": engine, "progress": progress}
        with self.placing():
            return simulate(diagram or self.diagram, self.file.duration, **settings)

    def verdict(
        self,
        diagram: Diagram | None = None,
        *,
        seed: int = 0,
        copies: bool = False,
        over: float | None = None,
        disturbance: Torque = 0.0,
    ) -> Verdict:
        """Prove it, or give the reason why not, and bound its errors: `dmframe.certify.verify`, `dmframe.bounds`."""
        from dmframe.bounds import error_bounds
        from dmframe.certify import verify

        diagram = diagram or self.diagram
        with self.placing(), SYMBOLIC:
            given, start = self.intervals(diagram), self.start
            found = verify(diagram, seed=seed, copies=copies, uncertain=given, start=start)
            errors = error_bounds(found, over=over, disturbance=disturbance, uncertain=given, start=start)
            return replace(found, errors=errors)

    def intervals(self, diagram: Diagram | None = None) -> Mapping[str, Sequence[Interval]]:
        """The true parameters that the file gives as intervals.

        A run does not use them: its parameters may lie outside.
        """
        from dmframe.certify.uncertain import intervals

        with self.placing():
            return intervals(diagram or self.diagram, self.file.uncertain)

    def set(self, values: Mapping[str, Any] | None = None, /, **keys: Any) -> Self:
        """Another graph with some values changed, ``g.set({"dynamics.Gamma": 50, "clock": "2 ms"})``.

        Parameters
        ----------
        values
            By ``block.parameter`` or a key of the graph file; numbers in the port's own units, texts with a unit, lists
            and arrays.
        keys
            Keys of the graph file, ``g.set(clock="2 ms", duration=20)``.

        Raises
        ------
        DmframeError
            All faults of the new values at once. Faults of sizes and wires are raised when the graph is used.
        """
        if not isinstance(values, Mapping | None):
            raise ValueFault(f"set: expected values by name, {{'dynamics.Gamma': 3}}, found {values!r:.40}")
        real, others = split({**(values or {}), **keys})
        overrides, faults = texts_of({**real, **others}), list[DmframeError]()
        steps = [[partial(changed, values=part, known=KEYS)] if part else [] for part in (real, others)]
        document = self.with_steps(steps[0], steps[1], faults)
        raise_all(faults)
        mine = [f"baseline.{text}" if text.partition(".")[0] in (self.swapped or ()) else text for text in overrides]
        return self.remade(document, mine)

    def until(self, duration: float | str) -> Self:
        """The same graph with another duration, ``20`` or ``"20 s"``."""
        length = seconds("until", duration)
        document = put(self.document, "duration", length, f"--until {length:g}")
        file, data = self.file.model_copy(update={"duration": length}), {**self.data, "duration": length}
        later = partial(changed, values={"duration": length}, known=KEYS)
        unexpanded = self.unexpanded and self.unexpanded.then(later)
        return replace(self, file=file, data=data, document=document, unexpanded=unexpanded)

    def baseline(self) -> Self:
        """The graph with the blocks of its key ``baseline``, and without the wires of removed blocks.

        Raises
        ------
        MissingError
            The file has no such key.
        """
        if not self.file.baseline:
            raise MissingError(f"{self.name}: expected a key baseline, with the blocks to compare with; found none")
        section: Any = self.document.node(("baseline",)).value
        made = self._replaced(self.document, section, "baseline")
        swapped = tuple(name for name, (_, node) in section.items() if node.value is not None)
        return replace(made, swapped=swapped)

    def rival(self, name: str) -> Self:
        """The graph with the blocks of a rival of its live page, ``page.rivals.NAME``; it has no file of its own."""
        if not self.file.page.rivals[name].blocks:
            return self.baseline()
        section: Any = self.document.node(("page", "rivals", name, "blocks")).value
        path = Path(self.document.name)
        return self._replaced(replace(self.document, name=str(path.with_name(f"{path.stem}_{name}"))), section, name)

    def _replaced(self, document: Document, section: Entries, ending: str) -> Self:
        """The graph with the blocks of a section, and `ending` added to its name."""
        changed = with_new_names(with_blocks(document, section, without=("baseline", "page")))
        path = Path(self.document.name)
        made = self._made(changed, path.with_stem(f"{path.stem}_{ending}"))
        return replace(made, overrides=self.overrides)

    def with_steps(
        self, real: Sequence[Step], others: Sequence[Step], faults: list[DmframeError]
    ) -> tuple[Document, Stating | None]:
        """The document with values set, those of ``reality`` first, whose earlier blocks are removed as with ``--set``.

        Faults of the values are added to `faults`; a fault of a set of channel models is raised.
        """
        document, unexpanded = self.document, self.unexpanded
        if real:
            document = after(unexpanded.document if unexpanded else document, real, faults)
            unexpanded = Stating(document, unexpanded.later if unexpanded else ())
            document = after(expanded(document), unexpanded.later, faults)
        return after(document, others, faults), unexpanded and unexpanded.then(*others)

    def remade(self, changed: tuple[Document, Stating | None], overrides: Sequence[str]) -> Self:
        """The graph of a changed document, see `with_steps`, with these overrides added to its own."""
        document, unexpanded = changed
        made = self.of(document, like=self)
        overrides = (*self.overrides, *overrides)
        return replace(made, name=self.name, overrides=overrides, swapped=self.swapped, unexpanded=unexpanded)

    @cached_property
    def text(self) -> str:
        """The complete graph as YAML, with all defaults: loading it gives the same run."""
        return resolved_text(self)

    def save(self, path: str | Path) -> Path:
        """Write `text` to a new file. Raises `OutputError` if the file exists already or cannot be written."""
        _ = self.diagram  # faults of sizes and wires, too
        path = expanded_path(path)
        write_text(path, self.text, new=True)
        return path

    def __eq__(self, other: object) -> bool:
        """Graphs are equal if their texts are; the same text gives the same run."""
        return isinstance(other, BaseGraph) and (self.name, self.text) == (other.name, other.text)

    def __hash__(self) -> int:
        return hash((self.name, self.text))

    def __reduce__(self) -> Any:
        """Pickled as its document: another process creates the blocks and the diagram again."""
        others = {"name": self.name, "overrides": self.overrides, "swapped": self.swapped}
        return _again, (type(self), self.document, others | {"unexpanded": self.unexpanded})


def _again(kind: type[BaseGraph], document: Document, others: Mapping[str, Any]) -> BaseGraph:
    """A pickled graph."""
    return replace(kind.of(document), **others)


def _report_changes(path: Path) -> None:
    """Report on stderr which files of a sealed folder have changed since it was written; signals are not read."""
    folder = folder_of(path)
    if folder is not None:
        near = path.parent.resolve()
        wrong = faults(folder, lambda name: (folder / name).resolve().parent == near and not name.endswith(".nc"))
        report(f"{folder}: notice: {text}" for text in wrong)
