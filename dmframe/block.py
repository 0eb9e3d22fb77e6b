"""A block: equations, storage and conditions, stated once.

From the one statement come the simulation, the generated code, the certificate, the picture and the documentation.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from fractions import Fraction
from typing import Any, ClassVar, Final, final

from pydantic import BaseModel, ConfigDict, PydanticUndefinedAnnotation, ValidationError, field_validator
from pydantic_core import ErrorDetails

from dmframe.certificate import SX, Certificate, Condition
from dmframe.errors import (
    BlockError,
    DmframeError,
    MissingError,
    UnitError,
    UnknownNameError,
    ValueFault,
    nearest,
    raise_all,
)
from dmframe.fields import check_fields
from dmframe.parameter import read, spec_of, specs
from dmframe.port import TIME, Access, Port, Side, State
from dmframe.units import compatible, shorten


@final
class Signals:
    """Named expressions, read as attributes: ``u.dq``, ``x.w``, ``p.Lambda``."""

    def __init__(self, owner: str, kind: str, values: Mapping[str, SX]) -> None:
        self._owner, self._kind, self._values = owner, kind, dict(values)

    def __getattr__(self, name: str) -> SX:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self._values[name]
        except KeyError:
            text = f"{self._owner}: its equations read {name}, which is none of its {self._kind}"
            raise BlockError(f"{text}; {nearest(name, self._values)}") from None

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)


@final
@dataclass(frozen=True)
class Equations:
    """What a block's equations say: its outputs, and the rates of its states."""

    outputs: Mapping[str, SX] = field(default_factory=dict)
    rates: Mapping[str, SX] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)


class AbstractBlock(BaseModel):
    """The base of every block; a block is a final subclass in a file of its own.

    Parameters are pydantic fields declared through `dmframe.parameter`; ports and states are class constants. In
    the methods below `u` holds the inputs, `x` the states, `p` the parameters as symbols (and ``p.robot``, the robot's
    symbolic model, where `uses_robot`; and ``p.w_0``, where the state w starts, if a parameter w says so), and `truth`
    the signals that only the analysis may see, each by its name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    side: ClassVar[Side] = Side.CONTROLLER
    inputs: ClassVar[tuple[Port, ...]] = ()
    outputs: ClassVar[tuple[Port, ...]] = ()
    states: ClassVar[tuple[State, ...]] = ()
    truth: ClassVar[tuple[Port, ...]] = ()
    uses_robot: ClassVar[bool] = False
    renamed: ClassVar[Mapping[str, str]] = {}
    """Names of before, of parameters, states and ports, with the new ones: graph files may still use them."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a class whose constants or parameters are not of their kind, before anything reads them."""
        super().__pydantic_init_subclass__(**kwargs)
        raise_all([BlockError(f"{cls.__name__}: {text}") for text in _malformed(cls)])

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise_all(parameter_faults(type(self), error, type_name(type(self))))

    @field_validator("*", mode="before")
    @classmethod
    def _read_quantity(cls, value: Any, info: Any) -> Any:
        spec = spec_of(cls.model_fields[info.field_name])
        if spec is None or (value is None and cls.model_fields[info.field_name].default is None):
            return value
        try:
            return read(value, spec)
        except DmframeError as error:
            raise ValueError(error.text) from None

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """Letters that this block binds by itself, ``{"p": 36}``; `robot` is the chain, or None."""
        del robot
        return {}

    def prior(self, robot: Any, others: Fraction) -> Sequence[Sequence[Fraction]] | None:
        """How large the errors of the parameters may be that this block models: the gain for which relative errors
        count alike, exactly; None for a block that models none. `others` is the size of a parameter about which it
        knows nothing.
        """
        del robot, others
        return None

    @abstractmethod
    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Outputs and rates, as pure expressions."""

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """Where states start that no parameter of the same name sets, as functions of the plant's start."""
        del u, p, truth
        return {}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """Storage, dissipation and supply; None for a block that can run but not be proved."""
        del u, x, p, truth
        return None

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The inequalities that the block's proof needs."""
        del p, truth
        return ()

    @classmethod
    def contract(cls, where: str) -> list[DmframeError]:
        """What is wrong with the class itself: names, units and references of its ports, states and parameters."""
        return [BlockError(f"{where}: {text}") for text in _breaches(cls)]


_LISTS: Final[Mapping[str, type[Port | State]]] = {"inputs": Port, "outputs": Port, "states": State, "truth": Port}
_KINDS: Final[Mapping[str, type]] = {"str": str, "bool": bool, "Access": Access}
"""What the fields of a port, a state and a parameter hold, by their annotations."""


def _malformed(block: type[AbstractBlock]) -> Iterator[str]:
    """Constants and parameters of a class that are not of their kind, so that no code could read them."""
    for name, kind in _LISTS.items():
        items = getattr(block, name)
        if not isinstance(items, tuple | list):
            hint = "; a comma makes a tuple of one" if isinstance(items, kind) else ""
            yield f"expected {name} to be a tuple of {kind.__name__}s, found {_short(items)}{hint}"
            continue
        for item in items:
            if not isinstance(item, kind):
                yield f"expected each of its {name} to be a {kind.__name__}, found {_short(item)}"
            else:
                yield from _misfit(item, f"of the {kind.__name__.lower()} {_short(item.name)} in {name}")
    names = block.renamed
    if not isinstance(names, Mapping) or not all(isinstance(word, str) for pair in names.items() for word in pair):
        yield f"expected renamed to map old names to new ones, found {_short(names)}"
    if not isinstance(block.side, Side):
        yield f"expected its side to be a Side, found {_short(block.side)}"
    if not isinstance(block.uses_robot, bool):
        yield f"expected uses_robot to be True or False, found {_short(block.uses_robot)}"
    yield from _mistyped(block)


def _mistyped(block: type[AbstractBlock]) -> Iterator[str]:
    """Parameters whose annotation nobody knows, or whose default they could not take."""
    if not block.__pydantic_complete__:
        try:
            block.model_rebuild()
        except PydanticUndefinedAnnotation as error:
            yield f"expected annotations that its module knows, found {error.name}; import it there"
            return
    for name, spec in specs(block).items():
        wrong = list(_misfit(spec, f"of the parameter {name}"))
        yield from wrong
        default = block.model_fields[name].default
        if wrong or default is None or block.model_fields[name].is_required():
            continue
        try:
            read(default, spec)
        except (DmframeError, ValueError) as error:
            yield f"the default of the parameter {name}: {error}"


def _misfit(item: Any, of: str) -> Iterator[str]:
    """Fields of a declaration that are of another type than its annotations say."""
    for each in fields(item):
        value, kind = getattr(item, each.name), _KINDS[str(each.type)]
        if not isinstance(value, kind):
            expected = "a text" if kind is str else f"of type {kind.__name__}"
            yield f"expected the {each.name} {of} to be {expected}, found {_short(value)}"


def _short(value: object) -> str:
    return shorten(repr(value), 40)


def _breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """What is wrong with a block's class, one text a breach."""
    kinds: dict[str, Sequence[Port | State]] = {
        "input": block.inputs,
        "output": block.outputs,
        "state": block.states,
    }
    for kind, items in kinds.items():
        names = [item.name for item in items]
        yield from (f"declares the {kind} {name} twice" for name in sorted({n for n in names if names.count(n) > 1}))
        for item in items:
            try:
                compatible(item.unit, "")
            except UnitError as fault:
                yield f"the unit of the {kind} {item.name}: {fault.text}"
    for kind, ports, known in (
        ("input", block.inputs, [port.name for port in block.inputs]),
        ("output", block.outputs, [port.name for port in (*block.inputs, *block.outputs)]),
    ):
        for port in ports:
            of = port.derivative_of
            if of and of not in known:
                yield f"the {kind} {port.name} is declared the derivative of {of}, unknown; {nearest(of, known)}"
    present = set(names_of(block))
    for old, new in block.renamed.items():
        if new not in present:
            yield f"says that {old} is renamed {new}, which is no parameter, state or port; {nearest(new, present)}"
        if old in present:
            yield f"says that {old} is renamed {new}, and still has {old}"
    yield from _print_breaches(block)
    yield from _source_breaches(block)
    yield from _parameter_breaches(block)


def _print_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """Names that a reader could take for one another."""
    # which imports the package that reads blocks
    from dmframe.formula.names import distinct, look_alikes, unicode_name

    names = list(dict.fromkeys([*names_of(block), *(port.name for port in block.truth)]))
    for one, other in distinct(names):
        yield f"its names {one} and {other} both print as {unicode_name(one)}; rename one"
    for name in names:
        if not name.isidentifier():
            yield f"expected a name such as K_star, found {name!r}"
        elif strange := look_alikes(name):
            yield f"the name {name!a} holds {strange!a}, no Latin and no known Greek letter; some look like those"


def names_of(block: type[AbstractBlock]) -> list[str]:
    """Names of a block's parameters, states and ports."""
    ports, states = (*block.inputs, *block.outputs), block.states
    return [*block.model_fields, *(port.name for port in ports), *(state.name for state in states)]


def _source_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """A proof leaves a trajectory and all its derivatives free: that is right of a function of time alone."""
    if block.side is not Side.SOURCE:
        return
    why = "a source is a function of time alone"
    yield from (f"has the state {state.name}; {why}, so state it as a controller or a plant" for state in block.states)
    yield from (
        f"has the input {port.name}; {why}, and its one input is t, as dmframe.port.TIME"
        for port in block.inputs
        if port != TIME
    )
    yield from (f"reads the truth {port.name}; {why}, and there is nothing to prove of it" for port in block.truth)
    for method in ("certificate", "start"):
        if getattr(block, method) is not getattr(AbstractBlock, method):
            yield f"has a {method} of its own; {why}: it has no states, so leave {method}() out"


def _parameter_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    numbers = specs(block)
    boxes = [name for name, spec in numbers.items() if spec.form == "box"]
    for name in block.model_fields:
        if hasattr(AbstractBlock, name):
            yield f"the parameter {name} hides what every block has under that name; rename it"
    for name, spec in numbers.items():
        try:
            compatible(spec.unit, "")
        except UnitError as fault:
            yield f"the unit of the parameter {name}: {fault.text}"
    balls = [name for name, spec in numbers.items() if spec.form == "ball"]
    for state in block.states:
        if state.box and state.box not in boxes:
            yield f"the box of {state.name} is {state.box}, which is no Interval parameter; {nearest(state.box, boxes)}"
        if state.ball and state.ball not in balls:
            near = nearest(state.ball, balls)
            yield f"the ball of {state.name} is {state.ball}, which is no Around parameter; {near}"
        if state.ball and state.gain not in numbers:
            yield f"the gain of {state.name}, with a ball, is no parameter; {nearest(state.gain, numbers)}"
        if state.name in numbers and numbers[state.name].shape.split() != state.shape.split():
            yield f"the parameter {state.name} and the state that starts there have different shapes"


def type_name(block: type[AbstractBlock]) -> str:
    """The name in graph files: snake_case of the class, ``PidInverse`` and ``PIDInverse`` -> ``pid_inverse``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", block.__name__).lower()


def parameter_faults(block: type[AbstractBlock], error: ValidationError, where: str) -> list[DmframeError]:
    """The faults of a block's parameters, in our words; their `path` is the parameter's name."""
    details = error.errors(include_url=False)
    missing = {str(detail["loc"][0]) for detail in details if detail["type"] == "missing"}
    unknown = {str(detail["loc"][0]) for detail in details if detail["type"] == "extra_forbidden"}
    # a misspelt parameter is told once, as that, and not a second time as a missing one
    misspelt = {
        near[0] for name in unknown if (near := get_close_matches(name, block.model_fields, 1)) and near[0] in missing
    }
    return [
        _fault(block, detail, where)
        for detail in details
        if not (detail["type"] == "missing" and detail["loc"][0] in misspelt)
    ]


def _fault(block: type[AbstractBlock], detail: ErrorDetails, where: str) -> DmframeError:
    name = str(detail["loc"][0]) if detail["loc"] else ""
    at = f"{where}.{name}" if name else where
    kind, path = type_name(block), detail["loc"]
    match detail["type"]:
        case "extra_forbidden":
            return UnknownNameError(at, f"parameter of {kind}", name, block.model_fields, path=path)
        case "missing":
            spec = specs(block).get(name)
            unit = f" [{spec.unit}]" if spec and spec.unit else ""
            return MissingError(f"{where}: {kind} needs the parameter {name}{unit}", path=path)
        case "value_error":
            return ValueFault(f"{at}: {str(detail['msg']).removeprefix('Value error, ')}", path=path)
        case "literal_error":
            expected = detail.get("ctx", {}).get("expected", "")
            return ValueFault(f"{at}: expected {expected}, found {detail['input']!r}", path=path)
        case "tuple_type":
            return ValueFault(f"{at}: expected a list, found {detail['input']!r}", path=path)
        case _:
            return ValueFault(f"{at}: {detail['msg'][0].lower()}{detail['msg'][1:]}", path=path)
