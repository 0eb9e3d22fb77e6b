"""A block: equations, storage and conditions, stated once.

From the one statement come the simulation, the generated code, the certificate, the picture and the documentation.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from fractions import Fraction
from typing import Any, ClassVar, final

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
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
from dmframe.port import TIME, Port, Side, State
from dmframe.units import compatible


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


def _breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """What is wrong with a block's class, one text a breach."""
    kinds: dict[str, tuple[Sequence[Port | State], type]] = {
        "input": (block.inputs, Port),
        "output": (block.outputs, Port),
        "state": (block.states, State),
    }
    for kind, (items, expected) in kinds.items():
        strangers = [item for item in items if not isinstance(item, expected)]
        if strangers:
            yield f"expected each {kind} to be a {expected.__name__}, found {strangers[0]!r}"
            return
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
    yield from _source_breaches(block)
    yield from _parameter_breaches(block)


def names_of(block: type[AbstractBlock]) -> list[str]:
    """Names of a block's parameters, states and ports."""
    ports, states = (*block.inputs, *block.outputs), block.states
    return [*block.model_fields, *(port.name for port in ports), *(state.name for state in states)]


def _source_breaches(block: type[AbstractBlock]) -> Iterator[str]:
    """A proof leaves a trajectory and all its derivatives free: that is right of a function of time alone."""
    if not isinstance(block.side, Side):
        yield f"expected its side to be a Side, found {block.side!r}"
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
