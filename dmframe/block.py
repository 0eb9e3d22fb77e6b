"""A block: equations, storage and conditions, stated once.

From the one statement come the simulation, the generated code, the certificate, the picture and the documentation.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator
from pydantic_core import ErrorDetails

from dmframe.certificate import SX, Certificate, Condition
from dmframe.errors import BlockError, DmframeError, MissingError, UnknownNameError, ValueFault, nearest, raise_all
from dmframe.parameter import read, spec_of, specs
from dmframe.port import Port, Side, State


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


class AbstractBlock(BaseModel):
    """The base of every block; a block is a final subclass in a file of its own.

    Parameters are pydantic fields declared through `dmframe.parameter`; ports and states are class constants. In
    the methods below `u` holds the inputs, `x` the states, `p` the parameters as symbols (and ``p.robot``, the robot's
    symbolic model, where `uses_robot`), and `truth` the signals that only the analysis may see, each by its name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    side: ClassVar[Side] = Side.CONTROLLER
    inputs: ClassVar[tuple[Port, ...]] = ()
    outputs: ClassVar[tuple[Port, ...]] = ()
    states: ClassVar[tuple[State, ...]] = ()
    truth: ClassVar[tuple[Port, ...]] = ()
    uses_robot: ClassVar[bool] = False

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise_all(parameter_faults(type(self), error, type_name(type(self))))

    @field_validator("*", mode="before")
    @classmethod
    def _read_quantity(cls, value: Any, info: Any) -> Any:
        spec = spec_of(cls.model_fields[info.field_name])
        if spec is None:
            return value
        try:
            return read(value, spec)
        except DmframeError as error:
            raise ValueError(error.text) from None

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """Letters that this block binds by itself, ``{"p": 36}``; `robot` is the chain, or None."""
        del robot
        return {}

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


def type_name(block: type[AbstractBlock]) -> str:
    """The name in graph files: snake_case of the class, ``PidInverse`` -> ``pid_inverse``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", block.__name__).lower()


def parameter_faults(block: type[AbstractBlock], error: ValidationError, where: str) -> list[DmframeError]:
    """The faults of a block's parameters, in our words; their `path` is the parameter's name."""
    return [_fault(block, detail, where) for detail in error.errors(include_url=False)]


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
        case _:
            return ValueFault(f"{at}: {detail['msg'][0].lower()}{detail['msg'][1:]}", path=path)
