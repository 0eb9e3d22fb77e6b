"""The grammar of a graph file: its keys, and the units of their numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, Literal, TypeAlias, final

from annotated_types import MinLen
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, WithJsonSchema

from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.common.units import joint_place, to_unit
from dmframe.simulate.instants import seed_fault
from dmframe.simulate.solver import FIXED, Method, Solver


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
Jitter = Annotated[float, _reader("s", positive=False), _schema("s")]
Angle = Annotated[float, _reader("rad", positive=False), _schema("rad")]


def _place(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number in rad, or in m for a joint that slides, found {value!r}")
    try:
        return joint_place(value)
    except DmframeError as error:
        raise ValueError(error.text) from None


Place = Annotated[float, PlainValidator(_place), _schema("rad, or m for a joint that slides")]


def _distance(value: Any) -> float:
    if (number := _place(value)) <= 0:
        raise ValueError(f"expected a positive number in rad, or in m for joints that slide, found {value!r}")
    return number


Distance = Annotated[float, PlainValidator(_distance), _schema("rad, or m for joints that slide")]
Length = Annotated[float, _reader("m", positive=True), _schema("m")]
Speed = Annotated[float, _reader("rad/s", positive=True), _schema("rad/s")]


def _clock(value: Any) -> Any:
    if value == "continuous":
        return None
    if value is None or (isinstance(value, str) and not value[:1].isdigit() and value[:1] not in "+-."):
        found = "nothing" if value is None else repr(value)
        raise ValueError(f"expected a sampling period such as 8 ms, or continuous, found {found}")
    return value


def seed_of(value: Any) -> Any:
    """A seed. Raises `ValueError`."""
    if text := seed_fault(value):
        raise ValueError(text)
    return value


def version(value: Any) -> Any:
    """The version of a file's format. Raises `ValueError`."""
    if type(value) is not int or value != 1:
        raise ValueError(f"expected 1, the version of this format, found {value!r}")
    return value


def _or_none(value: Any) -> Any:
    """No keys for null, so that an override can remove a section."""
    return {} if value is None else value


def _tool(value: Any) -> Any:
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, list) and len(value) == 3:
        try:
            return tuple(to_unit(number, "m") for number in value)
        except DmframeError as error:
            raise ValueError(error.text) from None
    raise ValueError(f"expected a frame's name, or 3 numbers in m, found {value!r}")


def _tolerance(value: Any) -> Any:
    """A positive number, or a text with a positive quantity in any unit; the unit of the error is known later."""
    if value is None:
        return None
    for unit in ("m", "rad", ""):
        try:
            if to_unit(value, unit) > 0:
                return value if isinstance(value, str) else float(value)
        except DmframeError:
            continue
    raise ValueError(f"expected a positive error such as 2 mm or 5 mrad, found {value!r}")


def robot_name(value: Any) -> Any:
    """Expand a robot given by its name only to that model with its defaults."""
    return {"model": value} if isinstance(value, str) else value


Identifier = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$")]


class Section(BaseModel):
    """A section of a file; other keys are rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid")


@final
class RobotSection(Section):
    """The robot, and the joints that move."""

    model: str = Field(description="name of a robot, or a path to a URDF file")
    free: tuple[str, ...] | None = Field(
        None, description="joints that move; by default all joints between base and tool"
    )
    hold: dict[str, Place] = Field({}, description="joints that are held, with their angles, or positions [m]")
    tool: Annotated[str | tuple[float, float, float] | None, BeforeValidator(_tool)] = Field(
        None, description="frame of the tool, or its offset in the last link"
    )
    axes: str | None = Field(None, description="task coordinates: xyz, xy, ...")
    friction_velocity: Speed = Field(0.005, description="v_0 of Coulomb friction, tanh(dq / v_0)")


@final
class SolverSection(Section):
    """Integration of the continuous states."""

    method: Method = Field(
        "rk4", description="rk4 (fixed step), ros34pw2 (fixed step, for stiff plants) or cvodes (SUNDIALS, adaptive)"
    )
    step: Seconds | None = Field(
        None,
        description="longest step of rk4, ros34pw2; default 1 ms, 0.5 ms for ros34pw2, less where rk4 requires it",
    )
    accuracy: Distance | None = Field(
        None,
        description="largest error of a joint position by integration, from which method and step follow [rad, or m]; "
        "by default the automatic steps, or shorter ones for 1e-5",
    )
    output: Seconds = Field(0.01, description="with a continuous clock, the period of recording")
    tolerance: Annotated[float, Field(strict=True, gt=0, lt=1)] = Field(1e-9, description="of cvodes, relative")
    share: Annotated[float, Field(strict=True, gt=0, le=1)] = Field(
        0.8, description="fraction of the longest stable step that rk4 uses if no step is given"
    )

    @property
    def solver(self) -> Solver:
        """The solver; with an accuracy it is free to choose among the methods, or the steps of a given method."""
        free: tuple[Method, ...] = ()
        if self.accuracy is not None:
            free = (self.method,) if {"method", "step"} & self.model_fields_set else FIXED
        return Solver(self.method, self.step, self.output, self.tolerance, self.share, self.accuracy, free)


@final
class LogSection(Section):
    """What a run records."""

    every: Seconds | None = Field(
        None, description="time between recorded instants; by default every tick, fewer for a very long run"
    )
    signals: tuple[str, ...] | None = Field(None, description="recorded signals as block.signal; by default all")


@final
class RivalSection(Section):
    """A controller that a live page simulates next to the graph's own, on the same robot and path."""

    title: str = Field(description="its name on the page")
    blocks: dict[str, dict[str, Any] | None] | None = Field(
        None, description="blocks as in `baseline`; by default those of `baseline`"
    )
    ghost: bool = Field(False, description="draw its tool and its error; otherwise only its error is printed")
    note: str = Field("", description="a sentence next to its error")


@final
class ButtonSection(Section):
    """A button of a live page, which sets values; a second press resets them."""

    title: str = Field(description="text of the button")
    set: Annotated[dict[str, Any], MinLen(1)] = Field(
        description="values by block.parameter, or clock; the text now is the time that the page shows"
    )
    says: str = Field("", description="text that the page shows while the button is pressed")


@final
class PageSection(Section):
    """What a live page shows in addition to the loop and its sliders."""

    enlarge: Annotated[float, Field(strict=True, ge=1, le=1000)] = Field(
        1, description="factor by which the page draws the deviation of the tool from its path"
    )
    rivals: dict[Identifier, RivalSection] = Field({}, description="controllers simulated next to this one")
    buttons: dict[Identifier, ButtonSection] = Field({}, description="guided changes of values")

    def __bool__(self) -> bool:
        """Whether it states anything."""
        return bool(self.rivals or self.buttons) or self.enlarge != 1


@final
class GraphFile(Section):
    """The keys of a graph file."""

    dmframe: Annotated[Literal[1], BeforeValidator(version)] = Field(description="version of this format")
    title: str = Field("", description="description in one line")
    robot: Annotated[RobotSection | None, BeforeValidator(robot_name)] = Field(
        None, description="the robot's name, or its name with the moving joints and the tool"
    )
    clock: Annotated[Seconds | None, BeforeValidator(_clock), _schema("s, or continuous")] = Field(
        description="sampling period of the controller, or continuous"
    )
    jitter: Jitter = Field(0.0, description="largest random advance or delay of a sampling instant")
    seed: Annotated[int, BeforeValidator(seed_of)] = Field(0, ge=0, description="seed of all random numbers")
    duration: Seconds = Field(description="simulated time")
    tolerance: Annotated[float | str | None, BeforeValidator(_tolerance)] = Field(
        None, description="largest error (root mean square over the last quarter) with which a rehearsal passes"
    )
    start: Annotated[
        dict[str, Any], BeforeValidator(_or_none), WithJsonSchema({"type": ["object", "null"], "default": {}})
    ] = Field({}, description="start values by state, {q: [...]}, or {near: [...]}; null removes them")
    solver: SolverSection = SolverSection()
    log: LogSection = LogSection()
    blocks: dict[str, dict[str, Any]] = Field(description="blocks by name: {type: ..., parameter: value}")
    wires: dict[str, str] = Field({}, description="input: output, where the names differ")
    baseline: dict[str, dict[str, Any] | None] = Field(
        {},
        description="blocks of the controller to compare with; each replaces the one of its name, null removes it",
    )
    reality: str | dict[str, Any] | None = Field(
        None,
        description="channel models between controller and robot: a packaged set such as ur, or {like: ur, block type: "
        "{parameter: value}}; none for the ideal channel",
    )
    page: PageSection = Field(PageSection(), description="rivals and buttons of the live page")
    uncertain: dict[str, Any] = Field(
        {},
        description="intervals of true parameters not known exactly, {servo.K_D: [600, 1000]}; for verify and study",
    )


KEYS: Final = tuple(GraphFile.model_fields)
"""Keys of a graph file."""


def shown(value: Any) -> str:
    """A value as a message quotes it, in the syntax of the file."""
    if value is None or isinstance(value, bool):
        return "nothing" if value is None else str(value).lower()
    return repr(value) if len(repr(value)) < 40 else "a list" if isinstance(value, list) else "keys with values"


Path: TypeAlias = tuple[str | int, ...]


_EXPECTED: Final = {
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "keys with values"),
    "string_type": "a text",
    "tuple_type": "a list",
    "too_short": "at least {min_length}",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
}
"""What a value should have been, by the type of pydantic's error, with the fields of its context."""


def fault_of(detail: Any, keys: Callable[[Path], Sequence[str]] | None = None) -> DmframeError:
    """The fault for one of pydantic's errors of a `GraphFile`, or of another file whose sections have `keys`."""
    *parts, last = detail["loc"]
    # pydantic inserts its own names, function-before[...]; a user's unknown key is the last
    kept = [part for part in parts if not (isinstance(part, str) and "[" in part)]
    own = detail["type"] == "extra_forbidden" or not (isinstance(last, str) and "[" in last)
    path = (*kept, last) if own else tuple(kept)
    where, found = ".".join(str(part) for part in path), detail["input"]
    match detail["type"]:
        case "extra_forbidden":
            choices = (keys or _keys)(path[:-1])
            return UnknownNameError(where, "key", str(path[-1]), choices, path=path)
        case "missing":
            return MissingError(f"{where}: this key is missing", path=path)
        case "literal_error":
            return ValueFault(f"{where}: expected {detail['ctx']['expected']}, found {found!r}", path=path)
        case "value_error":
            return ValueFault(f"{where}: {detail['msg'].removeprefix('Value error, ')}", path=path)
        case _:
            expected = detail["msg"]
            if detail["type"] in _EXPECTED:
                expected = _EXPECTED[detail["type"]].format_map(detail.get("ctx", {}))
            return ValueFault(f"{where}: expected {expected}, found {shown(found)}", path=path)


def _keys(path: Path) -> list[str]:
    sections: dict[Path, type[BaseModel]] = {
        (): GraphFile,
        ("robot",): RobotSection,
        ("solver",): SolverSection,
        ("log",): LogSection,
        ("page",): PageSection,
    }
    entries: dict[str, type[BaseModel]] = {"rivals": RivalSection, "buttons": ButtonSection}
    if path[:1] == ("page",) and len(path) == 3 and path[1] in entries:
        return list(entries[str(path[1])].model_fields)
    return list(sections[path].model_fields) if path in sections else []
