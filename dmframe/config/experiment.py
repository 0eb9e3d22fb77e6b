"""An experiment, as a graph file describes it: blocks, wires and a robot, and how they are run."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from pydantic import BaseModel, ValidationError

from dmframe.block import AbstractBlock, type_name
from dmframe.block.model import SYMBOLIC
from dmframe.catalogue import find_block, find_graph
from dmframe.config.document import Document, read_file
from dmframe.config.grammar import GraphFile, LogSection, RobotSection, SolverSection, robot_name
from dmframe.config.overrides import changed, overridden, put
from dmframe.config.renamed import with_new_names
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, Faults, MissingError, UnknownNameError, ValueFault, raise_all
from dmframe.exact.rational import Interval
from dmframe.simulate import Log, Recording, Solver, simulate
from dmframe.simulate.engine import Choice
from dmframe.simulate.run import Progress, check_run
from dmframe.units import to_unit

if TYPE_CHECKING:
    from dmframe.certify import Verdict


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
    """

    name: str
    file: GraphFile
    data: Mapping[str, Any]
    document: Document
    blocks: Mapping[str, AbstractBlock]
    robot: Any
    start: Mapping[str, Any]
    overrides: tuple[str, ...] = ()

    @property
    def solver(self) -> Solver:
        """The solver that the file asks for."""
        section = self.file.solver
        return Solver(section.method, section.step, section.output, section.tolerance)

    @property
    def log(self) -> Log:
        """What the file asks to be kept."""
        return Log(self.file.log.every, self.file.log.signals)

    def diagram(self) -> Diagram:
        """Wire and flatten it, and check what the file says of runs; faults carry their place in the file.

        What needs a pose, or a proof, is left to `simulate` and `verify`.
        """
        file = self.file
        try:
            with SYMBOLIC:
                diagram = Diagram.build(self.blocks, file.wires, self.robot)
            check_run(diagram, file.duration, clock=file.clock, solver=self.solver, log=self.log, start=self.start)
            return diagram
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
                clock=self.file.clock,
                solver=self.solver,
                start=self.start,
                progress=progress,
                engine=engine,
                log=log or self.log,
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
        changed = {**self.data["blocks"], **self.data["baseline"]}
        blocks = {name: spec for name, spec in changed.items() if spec is not None}
        gone = changed.keys() - blocks.keys()
        wires = {
            end: source
            for end, source in self.file.wires.items()
            if not {end.partition(".")[0], source.partition(".")[0]} & gone
        }
        data = {**self.data, "blocks": blocks, "wires": wires, "baseline": {}}
        path = Path(self.document.name)
        return _made(replace(self.document, data=data), path.with_stem(f"{path.stem}_baseline"))

    def changed(self, values: Mapping[str, Any]) -> Experiment:
        """The same with other values, ``{"task.gamma": 2, "clock": "2 ms"}``, as ``--set`` has them.

        Raises
        ------
        DmframeError
            All faults of the values at once.
        """
        document, overrides = changed(self.document, values, KEYS)
        return replace(experiment_of(document), name=self.name, overrides=(*self.overrides, *overrides))

    def with_duration(self, duration: float) -> Experiment:
        """The same graph, run for another time [s]."""
        document = put(self.document, "duration", duration, f"--until {duration:g}")
        file = self.file.model_copy(update={"duration": duration})
        return replace(self, file=file, data={**self.data, "duration": duration}, document=document)

    def __reduce__(self) -> Any:
        """Pickled as its document: a process elsewhere makes its blocks anew."""
        return _again, (self.document, self.name, self.overrides)

    def __repr__(self) -> str:
        return f"<Experiment {self.name}>"


KEYS: Final = tuple(GraphFile.model_fields)

TIMES: Final = (("duration",), ("solver", "output"), ("solver", "step"), ("log", "every"), ("clock",))
"""They say together how much a run computes: of a fault in one, another may be the cause that an override has set."""


def placed(error: DmframeError, document: Document) -> DmframeError:
    """The fault, or each of several in the order of the file, with ``file:line:column``.

    One whose culprit an override has set is placed there, ``--set task.gamma=-1``; one of a whole block or section says
    which overrides changed it.
    """
    faults = error.faults
    for fault in faults:
        fault.location = fault.location or _location(fault, document)
    return Faults(sorted(faults, key=_place)) if isinstance(error, Faults) else error


def _location(fault: DmframeError, document: Document) -> str:
    """Where the culprit stands: an unknown name itself, be it a key, a value or an item of a list.

    Empty for what is said of no graph, such as an engine.
    """
    path = fault.path
    if path and path[0] not in (*KEYS, *document.data):
        return ""
    if path in TIMES:
        path = next((other for other in (path, *TIMES) if document.is_said(other)), path)
    if isinstance(fault, UnknownNameError):
        held: Any = document.data
        for part in path:
            held = held.get(part) if isinstance(held, dict) else None
        if isinstance(held, dict) and fault.name in held:
            path = (*path, fault.name)
        elif isinstance(held, list) and fault.name in held:
            path = (*path, held.index(fault.name))
    key = isinstance(fault, UnknownNameError) and path[-1:] == (fault.name,)
    place = document.locate(path, key=key)
    if document.is_said(path, key) or (isinstance(fault, MissingError) and len(path) == 1):
        return place
    changed = document.said_below(path)
    return f"{place} with {', '.join(changed)}" if changed else place


def _place(fault: DmframeError) -> tuple[int, ...]:
    """Line and column of a fault's location; overrides come first."""
    return tuple(int(number) for number in re.findall(r":(\d+)(?=:\d+$|$)", fault.location.partition(" with --")[0]))


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
    document = overridden(read_file(find_graph(str(source))), overrides, KEYS)
    return replace(experiment_of(document), overrides=tuple(overrides))


def experiment_of(document: Document) -> Experiment:
    """An experiment from its document, whose old names are read as the new ones. Raises what `load_experiment` does."""
    path = Path(document.name)
    read = with_new_names(document, path.parent)
    raise_all(read.faults)
    for notice in read.notices:
        sys.stderr.write(f"{notice}\n")
    return _made(read.document, path)


def _again(document: Document, name: str, overrides: tuple[str, ...]) -> Experiment:
    """One that was pickled."""
    return replace(experiment_of(document), name=name, overrides=overrides)


def _made(document: Document, path: Path) -> Experiment:
    """An experiment from its document; `path` names it, and files are looked for beside it."""
    data = document.data
    faults = list[DmframeError]()
    try:
        file = GraphFile.model_validate(data)
    except ValidationError as error:
        faults += [_fault(detail, data) for detail in error.errors(include_url=False)]
        file = None
    blocks = _blocks("blocks", data.get("blocks"), path.parent, faults)
    _check_baseline(data.get("baseline"), blocks, path.parent, faults)
    robot = _robot(_section(RobotSection, robot_name(data.get("robot"))), path.parent, faults)
    if isinstance(data.get("robot"), str):
        faults = [_at_name(fault) for fault in faults]
    start = _start(data["start"], faults) if isinstance(data.get("start"), dict) else {}
    try:
        raise_all(faults)
    except DmframeError as error:
        raise placed(error, document) from None
    assert file is not None  # a file that is not valid left a fault
    return Experiment(path.stem, file, data, document, blocks, robot, start)


NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def _check_baseline(section: Any, blocks: Mapping[str, Any], base: Path, faults: list[DmframeError]) -> None:
    """Its blocks can be made, and what it leaves out is there."""
    entries = section if isinstance(section, dict) else {}
    if entries:
        _blocks("baseline", {name: spec for name, spec in entries.items() if spec is not None} or None, base, faults)
    faults += [
        UnknownNameError(f"baseline.{name}", "block", name, blocks, path=("baseline", name))
        for name, spec in entries.items()
        if spec is None and name not in blocks
    ]


def _blocks(key: str, section: Any, base: Path, faults: list[DmframeError]) -> dict[str, AbstractBlock]:
    """The blocks of a section, ``blocks`` or ``baseline``."""
    made = dict[str, AbstractBlock]()
    for name, spec in section.items() if isinstance(section, dict) else ():
        where, path = f"{key}.{name}", (key, name)
        if not NAME.fullmatch(name) or name == "robot":
            faults.append(ValueFault(f"{where}: expected a name of letters, digits and _, other than robot", path=path))
        elif isinstance(spec, dict) and "type" not in spec:
            faults.append(MissingError(f"{where}: expected a key type, for example {{type: circle, ...}}", path=path))
        elif isinstance(spec, dict) and not isinstance(spec["type"], str):
            found = _shown(spec["type"])
            faults.append(
                ValueFault(f"{where}.type: expected the name of a block type, found {found}", path=(*path, "type"))
            )
        elif isinstance(spec, dict):
            try:
                made[name] = _block(path, spec, base)
            except DmframeError as error:
                for fault in error.faults:
                    faults.append(fault)
    if isinstance(section, dict) and not section:
        faults.append(MissingError(f"{key}: expected at least one block, found none", path=(key,)))
    return made


def _block(path: tuple[str, str], spec: Mapping[str, Any], base: Path) -> AbstractBlock:
    where = ".".join(path)
    try:
        kind = find_block(spec["type"], base, f"{where}.type")
    except DmframeError as error:
        error.path = (*path, "type")
        raise
    values = {key: value for key, value in spec.items() if key != "type"}
    try:
        return kind(**values)
    except DmframeError as error:
        for fault in error.faults:
            fault.path = (*path, *fault.path)
            fault.text = where + fault.text.removeprefix(type_name(kind))
        raise


def _section(kind: type[RobotSection], value: Any) -> RobotSection | None:
    """A section of its own, so that its faults are told along with those of others; None where it is not valid."""
    try:
        return None if value is None else kind.model_validate(value)
    except ValidationError:
        return None


def _at_name(fault: DmframeError) -> DmframeError:
    """Where a graph writes a robot as its name alone, that is the place of all that is wrong with the model."""
    if fault.path == ("robot", "model"):
        fault.path = ("robot",)
    return fault


def _robot(section: RobotSection | None, base: Path, faults: list[DmframeError]) -> Any:
    if section is None:
        return None
    from dmframe.robot.library import load

    try:
        return load(
            section.model,
            base=base,
            free=section.free,
            hold=section.hold,
            tool=section.tool,
            axes=section.axes,
            friction_velocity=section.friction_velocity,
        )
    except DmframeError as error:
        for fault in error.faults:
            fault.path = fault.path or ("robot", "model")
            faults.append(fault)
        return None


def _start(section: Mapping[str, Any], faults: list[DmframeError]) -> dict[str, Any]:
    """Start values as numbers; angles may carry a unit."""
    values = dict[str, Any]()
    for key, value in section.items():
        try:
            values[key] = _start_numbers(value)
        except DmframeError as error:
            faults.append(ValueFault(f"start.{key}: {error.text}", path=("start", key)))
    return values


def _start_numbers(item: Any, depth: int = 0) -> Any:
    """A number, a list, or the rows of a matrix."""
    if isinstance(item, list) and depth < 2:
        return [_start_numbers(below, depth + 1) for below in item]
    if isinstance(item, str):
        return to_unit(item, "rad")
    if isinstance(item, bool) or not isinstance(item, int | float):
        raise ValueFault(f"expected numbers, found {_shown(item)}")
    try:
        return float(item)
    except OverflowError:
        raise ValueFault("expected a finite number, found one of hundreds of digits") from None


def _shown(value: Any) -> str:
    """What a message quotes of a value, as the file writes it."""
    if value is None or isinstance(value, bool):
        return "nothing" if value is None else str(value).lower()
    return repr(value) if len(repr(value)) < 40 else "a list" if isinstance(value, list) else "keys with values"


def _fault(detail: Any, data: Any) -> DmframeError:
    *parts, last = detail["loc"]
    # pydantic puts its own words between, function-before[...]; a user's unknown key is the last
    kept = [part for part in parts if not (isinstance(part, str) and "[" in part)]
    own = detail["type"] == "extra_forbidden" or not (isinstance(last, str) and "[" in last)
    path = (*kept, last) if own else tuple(kept)
    where, found = ".".join(str(part) for part in path), detail["input"]
    match detail["type"]:
        case "extra_forbidden":
            choices = _keys(path[:-1])
            return UnknownNameError(where, "key", str(path[-1]), choices, path=path)
        case "missing":
            return MissingError(f"{where}: this key is missing", path=path)
        case "literal_error":
            return ValueFault(f"{where}: expected {detail['ctx']['expected']}, found {found!r}", path=path)
        case "value_error":
            return ValueFault(f"{where}: {detail['msg'].removeprefix('Value error, ')}", path=path)
        case _:
            kind = {"dict_type": "keys with values", "string_type": "a text", "tuple_type": "a list"}
            kind |= {"model_type": "keys with values", "model_attributes_type": "keys with values"}
            expected = kind.get(detail["type"], detail["msg"])
            return ValueFault(f"{where}: expected {expected}, found {_shown(found)}", path=path)


def _keys(path: tuple[str | int, ...]) -> list[str]:
    sections: dict[tuple[str | int, ...], type[BaseModel]] = {
        (): GraphFile,
        ("robot",): RobotSection,
        ("solver",): SolverSection,
        ("log",): LogSection,
    }
    return list(sections[path].model_fields) if path in sections else []
