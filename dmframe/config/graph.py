"""A graph file: its grammar, and the way from text to a diagram."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, WithJsonSchema

from dmframe.block import AbstractBlock, type_name
from dmframe.catalogue import find_block, find_graph
from dmframe.config.document import Document, read_file
from dmframe.config.overrides import overridden, target
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, Faults, MissingError, UnknownNameError, ValueFault, raise_all
from dmframe.simulate import Log, Solver
from dmframe.simulate.step import Method
from dmframe.units import to_unit


def _reader(unit: str, *, positive: bool) -> BeforeValidator:
    def read(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise ValueError(f"expected a number in {unit}, found {value!r}")
        try:
            number = to_unit(value, unit)
        except DmframeError as error:
            raise ValueError(error.text) from None
        if positive and number <= 0:
            raise ValueError(f"expected a positive number in {unit}, found {value!r}")
        return number

    return BeforeValidator(read)


def _schema(unit: str) -> WithJsonSchema:
    return WithJsonSchema({"type": ["number", "string"], "description": f"a number in {unit}, or a text with a unit"})


Seconds = Annotated[float, _reader("s", positive=True), _schema("s")]
Angle = Annotated[float, _reader("rad", positive=False), _schema("rad")]
Length = Annotated[float, _reader("m", positive=False), _schema("m")]
Speed = Annotated[float, _reader("rad/s", positive=True), _schema("rad/s")]


def _clock(value: Any) -> Any:
    if value == "continuous":
        return None
    if value is None or (isinstance(value, str) and not value[:1].isdigit() and value[:1] not in "+-."):
        found = "nothing" if value is None else repr(value)
        raise ValueError(f"expected a sampling period such as 8 ms, or continuous, found {found}")
    return value


def _version(value: Any) -> Any:
    if type(value) is not int or value != 1:
        raise ValueError(f"expected 1, the version of this format, found {value!r}")
    return value


def _tool(value: Any) -> Any:
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, list) and len(value) == 3:
        try:
            return tuple(to_unit(number, "m") for number in value)
        except DmframeError as error:
            raise ValueError(error.text) from None
    raise ValueError(f"expected a frame's name, or 3 numbers in m, found {value!r}")


def _robot_name(value: Any) -> Any:
    return {"model": value} if isinstance(value, str) else value


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


@final
class RobotSection(_Section):
    """Which robot, and which of its joints move."""

    model: str = Field(description="name of a robot, or a path to a URDF file")
    free: tuple[str, ...] | None = Field(
        None, description="joints that move; without it, all those on the way to the tool"
    )
    hold: dict[str, Angle] = Field({}, description="joints held still, with their angles")
    tool: Annotated[str | tuple[float, float, float] | None, BeforeValidator(_tool)] = Field(
        None, description="frame of the tool, or its offset in the last link"
    )
    axes: str | None = Field(None, description="task coordinates: xyz, xy, ...")
    friction_velocity: Speed = Field(0.005, description="v_0 of Coulomb friction, tanh(dq / v_0)")


@final
class SolverSection(_Section):
    """How the continuous part is integrated."""

    method: Method = Field("rk4", description="rk4 (fixed step) or cvodes (SUNDIALS, adaptive)")
    step: Seconds = Field(0.001, description="longest step of rk4")
    output: Seconds = Field(0.01, description="with a continuous clock, how often a result is kept")
    tolerance: Annotated[float, Field(gt=0, lt=1)] = Field(1e-9, description="of cvodes, relative")


@final
class LogSection(_Section):
    """What a run keeps."""

    every: Seconds | None = Field(
        None, description="time between instants that are kept; without it every tick, fewer of a very long run"
    )
    signals: tuple[str, ...] | None = Field(None, description="block.signal of those that are kept; without it, all")


@final
class GraphFile(_Section):
    """The keys of a graph file."""

    dmframe: Annotated[Literal[1], BeforeValidator(_version)] = Field(description="version of this format")
    title: str = Field("", description="one line that a reader understands")
    robot: Annotated[RobotSection | None, BeforeValidator(_robot_name)] = Field(
        None, description="the robot's name, or its name with what moves and where the tool is"
    )
    clock: Annotated[Seconds | None, BeforeValidator(_clock), _schema("s, or continuous")] = Field(
        description="sampling period of the controller, or continuous"
    )
    duration: Seconds = Field(description="simulated time")
    start: dict[str, Any] = Field({}, description="start values by state, {q: [...]}, or {near: [...]}")
    solver: SolverSection = SolverSection()
    log: LogSection = LogSection()
    blocks: dict[str, dict[str, Any]] = Field(description="blocks by name: {type: ..., parameter: value}")
    wires: dict[str, str] = Field({}, description="input: output, where names do not say it")
    uncertain: dict[str, Any] = Field(
        {}, description="true parameters known only up to an interval, {servo.K_D: [600, 1000]}; for verify"
    )


@final
@dataclass(frozen=True)
class Graph:
    """A graph file that has been read and checked, with its blocks made.

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
        """Wire and flatten it; faults carry their place in the file."""
        try:
            return Diagram.build(self.blocks, self.file.wires, self.robot)
        except DmframeError as error:
            raise placed(error, self.document, self.overrides) from None

    def with_duration(self, duration: float) -> Graph:
        """The same graph, run for another time [s]."""
        file = self.file.model_copy(update={"duration": duration})
        return replace(self, file=file, data={**self.data, "duration": duration})


def placed(error: DmframeError, document: Document, overrides: Sequence[str] = ()) -> DmframeError:
    """The fault, or each of several in the order of the file, with ``file:line:column``.

    One whose culprit an override has set is placed there: ``--set task.gamma=-1``.
    """
    faults = error.faults if isinstance(error, Faults) else (error,)
    for fault in faults:
        if not fault.location:
            fault.location = _override_of(fault.path, document, overrides) or _location(fault, document)
    return Faults(sorted(faults, key=_place)) if isinstance(error, Faults) else error


def _location(fault: DmframeError, document: Document) -> str:
    """Where the culprit stands: an unknown name itself, be it a key, a value or an item of a list."""
    path = fault.path
    if isinstance(fault, UnknownNameError):
        held: Any = document.data
        for part in path:
            held = held.get(part) if isinstance(held, dict) else None
        if isinstance(held, dict) and fault.name in held:
            path = (*path, fault.name)
        elif isinstance(held, list) and fault.name in held:
            path = (*path, held.index(fault.name))
    return document.locate(path, key=isinstance(fault, UnknownNameError) and path[-1:] == (fault.name,))


def _override_of(path: tuple[str | int, ...], document: Document, overrides: Sequence[str]) -> str:
    for text in reversed(overrides):
        keys = tuple(target(text, document.data))
        if keys and path[: len(keys)] == keys:
            return f"--set {text}"
    return ""


def _place(fault: DmframeError) -> tuple[int, ...]:
    """Line and column of a fault's location; overrides come first."""
    return tuple(int(number) for number in re.findall(r":(\d+)(?=:\d+$|$)", fault.location))


def load_graph(source: str | Path, overrides: Sequence[str] = ()) -> Graph:
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
    """
    path = find_graph(str(source))
    return make_graph(read_file(path), path, overrides)


def make_graph(document: Document, path: Path, overrides: Sequence[str] = ()) -> Graph:
    """A graph from its document; `path` names it, and files are looked for beside it."""
    data = overridden(document.data, overrides, list(GraphFile.model_fields))
    faults = list[DmframeError]()
    try:
        file = GraphFile.model_validate(data)
    except ValidationError as error:
        faults += [_fault(detail, data) for detail in error.errors(include_url=False)]
        file = None
    blocks = _blocks(data.get("blocks"), path.parent, faults)
    robot = _robot(_section(RobotSection, _robot_name(data.get("robot"))), path.parent, faults)
    if isinstance(data.get("robot"), str):
        faults = [_at_name(fault) for fault in faults]
    start = _start(data["start"], faults) if isinstance(data.get("start"), dict) else {}
    try:
        raise_all(faults)
    except DmframeError as error:
        raise placed(error, document, overrides) from None
    assert file is not None  # a file that is not valid left a fault
    return Graph(path.stem, file, data, document, blocks, robot, start, tuple(overrides))


NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def _blocks(section: Any, base: Path, faults: list[DmframeError]) -> dict[str, AbstractBlock]:
    made = dict[str, AbstractBlock]()
    for name, spec in section.items() if isinstance(section, dict) else ():
        where, path = f"blocks.{name}", ("blocks", name)
        if not NAME.fullmatch(name) or name == "robot":
            faults.append(ValueFault(f"{where}: expected a name of letters, digits and _, other than robot", path=path))
        elif isinstance(spec, dict) and "type" not in spec:
            faults.append(MissingError(f"{where}: expected a key type, for example {{type: circle, ...}}", path=path))
        elif isinstance(spec, dict):
            try:
                made[name] = _block(name, spec, base)
            except DmframeError as error:
                for fault in error.faults if isinstance(error, Faults) else (error,):
                    faults.append(fault)
    if isinstance(section, dict) and not section:
        faults.append(MissingError("blocks: expected at least one block, found none", path=("blocks",)))
    return made


def _block(name: str, spec: Mapping[str, Any], base: Path) -> AbstractBlock:
    path: tuple[str | int, ...] = ("blocks", name)
    try:
        kind = find_block(str(spec["type"]), base, f"blocks.{name}.type")
    except DmframeError as error:
        error.path = (*path, "type")
        raise
    values = {key: value for key, value in spec.items() if key != "type"}
    try:
        return kind(**values)
    except DmframeError as error:
        for fault in error.faults if isinstance(error, Faults) else (error,):
            fault.path = (*path, *fault.path)
            fault.text = f"blocks.{name}" + fault.text.removeprefix(type_name(kind))
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
        for fault in error.faults if isinstance(error, Faults) else (error,):
            fault.path = fault.path or ("robot", "model")
            faults.append(fault)
        return None


def _start(section: Mapping[str, Any], faults: list[DmframeError]) -> dict[str, Any]:
    """Start values as numbers; angles may carry a unit."""
    values = dict[str, Any]()
    for key, value in section.items():
        items = value if isinstance(value, list) else [value]
        try:
            numbers = [_start_number(item) for item in items]
        except DmframeError as error:
            faults.append(ValueFault(f"start.{key}: {error.text}", path=("start", key)))
            continue
        values[key] = numbers if isinstance(value, list) else numbers[0]
    return values


def _start_number(item: Any) -> float:
    if isinstance(item, str):
        return to_unit(item, "rad")
    if isinstance(item, bool) or not isinstance(item, int | float):
        raise ValueFault(f"expected numbers, found {_shown(item)}")
    return float(item)


def _shown(value: Any) -> str:
    """What a message quotes of a value, as the file writes it."""
    if value is None or isinstance(value, bool):
        return "nothing" if value is None else str(value).lower()
    return repr(value) if len(repr(value)) < 40 else "a list" if isinstance(value, list) else "keys with values"


def _fault(detail: Any, data: Any) -> DmframeError:
    path = tuple(part for part in detail["loc"] if not (isinstance(part, str) and "[" in part))
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
