"""Base class of blocks: a block states its equations, storage function and conditions once.

The simulation, the generated code, the certificate, the block diagram and the documentation are derived from them.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

import casadi as ca
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from dmframe.block.certificate import SX, Certificate, Condition, Square
from dmframe.block.faults import fault_context, parameter_faults, strictly_typed
from dmframe.block.fields import check_fields
from dmframe.block.names import type_name
from dmframe.block.numberless import unreadable, without_numbers
from dmframe.block.parameter import read, spec_of, specs, with_stated
from dmframe.block.port import PERIOD, TIME, Adapted, Input, Output, Port, Side, State
from dmframe.common import notebook
from dmframe.common.errors import BlockError, DmframeError, nearest, raise_all
from dmframe.common.names import Element

if TYPE_CHECKING:
    from dmframe.block.evaluate import Values


TRUE_VALUES: Final = "true values that `truth` declares and this diagram has"
"""Kind of the signals that the analysis alone may read."""


def own_copy(value: Any) -> Any:
    """A copy of the expressions in a value, for code that may assign to their elements."""
    if isinstance(value, ca.SX | ca.MX):
        return type(value)(value)
    if isinstance(value, tuple | list):
        return type(value)(map(own_copy, value))
    if is_dataclass(value) and not isinstance(value, type):
        parts = {item.name: vars(value).get(item.name) for item in fields(value)}  # without what is loaded at first use
        copies = {name: own_copy(part) for name, part in parts.items() if isinstance(part, ca.SX)}
        return replace(value, **copies) if copies else value
    return value


@final
class Signals:
    """Named expressions, read as attributes: ``u.dq``, ``x.w``, ``p.Lambda``.

    Each read returns a copy: a block that assigns to elements, ``q = u.q; q[0] = 0``, does not change the signal.
    """

    def __init__(
        self, owner: str, kind: str, values: Mapping[str, SX], options: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._owner, self._kind, self._values, self._options = owner, kind, dict(values), options

    def __getattr__(self, name: str) -> SX:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return own_copy(self._values[name])
        except KeyError:
            if name in self._options:
                raise BlockError(
                    f"{self._owner}: its equations read {name}, a parameter annotated `{self._options[name]}`; for a "
                    f'number annotate it as {name}: Scalar = Real(unit="..."), for one per joint as {name}: Diagonal = '
                    f'Positive("n", "..."); read an option as self.{name}'
                ) from None
            true = self._kind == TRUE_VALUES
            read, whose = ("certificate reads", "the") if true else ("equations read", "its")
            text = f"{self._owner}: its {read} {name}, which is none of {whose} {self._kind}"
            raise BlockError(f"{text}; {nearest(name, self._values)}") from None

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)


def owner_of(signals: Signals) -> str:
    """Name of the block to which the signals belong."""
    return signals._owner


@final
@dataclass(frozen=True)
class Equations:
    """Values of a block's equations: outputs, rates of continuous states, next values of sampled states.

    On a clock, a continuous state of a controller takes one step per sampling period T: x + T rate + T^2 second.
    `second` is an optional term, for example one that keeps a matrix positive definite where an Euler step does not.
    """

    outputs: Mapping[str, SX] = field(default_factory=dict)
    rates: Mapping[str, SX] = field(default_factory=dict)
    next: Mapping[str, SX] = field(default_factory=dict)
    second: Mapping[str, SX] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def named(self) -> dict[tuple[str, ...], SX]:
        """All of them, by the field and the name of the output or state."""
        return {(kind.name, name): x for kind in fields(self) for name, x in getattr(self, kind.name).items()}

    @property
    def moves(self) -> dict[str, SX]:
        """Rates and next values, by the state's name."""
        return {**self.rates, **self.next}

    @property
    def expressions(self) -> tuple[SX, ...]:
        """All outputs, rates and next values."""
        return (*self.outputs.values(), *self.rates.values(), *self.next.values())


def with_estimates(stated: Certificate, x: Signals) -> Certificate:
    """A certificate with the squares of its estimates' errors in its storage."""
    for name, true in stated.estimates.items():
        if name not in x:
            text = f"{owner_of(x)}: certificate() gives a true value for {name}, which is not one of its states"
            raise BlockError(f"{text}; {nearest(name, x)}")
        if isinstance(true.value, ca.SX | ca.MX) and ca.depends_on(true.value, getattr(x, name)):
            raise BlockError(f"{owner_of(x)}: certificate() gives a true value for {name} that depends on {name}")
    squares = (Square(getattr(x, name) - true.value, true.weight) for name, true in stated.estimates.items())
    return replace(stated, storage=(*stated.storage, *squares))


def _split_ports(cls: type[AbstractBlock]) -> None:
    """Convert each former `Port` of a class to `Input` or `Output`."""
    for name, kind in (("inputs", Input), ("outputs", Output), ("truth", Input)):
        items = cls.__dict__.get(name)
        if not isinstance(items, tuple | list) or not any(isinstance(item, Port) for item in items):
            continue
        text = f"{cls.__name__}: write {kind.__name__}(...) instead of Port(...) in {name}"
        warnings.warn(text, DeprecationWarning, stacklevel=4)
        try:
            setattr(cls, name, tuple(item.as_kind(kind) if isinstance(item, Port) else item for item in items))
        except TypeError as error:
            raise BlockError(f"{cls.__name__}: {error}") from None


class AbstractBlock(BaseModel):
    """The base class of every block. A block is a final subclass in its own file.

    Parameters are pydantic fields declared through `dmframe.block.parameter`; ports and states are class constants. In
    the methods below `u` contains the inputs, `x` the states, `p` the parameters as symbols, and `truth` the signals
    that only the analysis may read, each by its name. With `uses_robot`, ``p.robot`` is the symbolic model of the
    robot. If a parameter sets the initial value of a state w, ``p.w_0`` is that value.

    The framework calls the methods on a copy of the block that has its options (bool, str, int) but none of its
    numbers: read a number as ``p.rate``, never as ``self.rate``. ``"rate" in p`` is true if it is given.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    side: ClassVar[Side] = Side.CONTROLLER
    inputs: ClassVar[tuple[Input, ...]] = ()
    outputs: ClassVar[tuple[Output, ...]] = ()
    states: ClassVar[tuple[State, ...]] = ()
    truth: ClassVar[tuple[Input, ...]] = ()
    estimates: ClassVar[tuple[Adapted, ...]] = ()
    uses_robot: ClassVar[bool] = False
    renamed: ClassVar[Mapping[str, str]] = {}
    """Former names of parameters, states and ports, with the new ones: graph files may still use them."""
    unproved: ClassVar[str] = ""
    """Why the block has no certificate; the reason of a verdict ends with this text."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Reject a class whose constants or parameters have the wrong type, before they are used."""
        from dmframe.block.contract import malformed  # avoids a circular import

        super().__pydantic_init_subclass__(**kwargs)
        _split_ports(cls)
        raise_all([BlockError(f"{cls.__name__}: {text}") for text in malformed(cls)])

    def __init__(self, /, **values: Any) -> None:
        name = type_name(type(self))
        with fault_context(name, "its validators"):
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise_all(parameter_faults(type(self), error, name))

    if not TYPE_CHECKING:  # for a type checker, a block has only its declared attributes

        def __getattr__(self, name: str) -> Any:
            """Raise for a missing attribute; reading a number of a copy without numbers is an error in the block."""
            if (fault := unreadable(self, name)) is not None:
                raise fault
            return super().__getattr__(name)

    @field_validator("*", mode="wrap")
    @classmethod
    def _read_quantity(cls, value: Any, checked: Any, info: Any) -> Any:
        spec = spec_of(cls.model_fields[info.field_name])
        if spec is None:
            return checked(strictly_typed(value, cls.model_fields[info.field_name].annotation))
        if value is None and cls.model_fields[info.field_name].default is None:
            return checked(value)
        try:
            numbers = read(value, spec)
        except DmframeError as error:
            raise ValueError(error.text) from None
        return with_stated(checked(numbers), numbers)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """Dimensions that this block defines, ``{"p": 36}``; `robot` is the chain, or None."""
        return {letter: len(elements) for letter, elements in self.elements(robot).items()}

    def remark(self) -> str:
        """What `dmframe analyse` prints about the parameters, such as a gain that follows from margins; or nothing."""
        return ""

    def needs(self, port: str) -> bool:
        """True if an optional input has to be driven with the options of this block."""
        del port
        return False

    def requires(self, port: Input, owner: str) -> bool:
        """True if an input has to be driven; `owner` is the block's name. Blocks do not override it."""
        with fault_context(owner, "needs()"):
            return not port.optional or bool(without_numbers(self, owner).needs(port.name))

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """Names and units, for results, of the elements of each dimension that this block defines."""
        del robot
        return {}

    def prior(self, robot: Any, others: Fraction) -> Sequence[Sequence[Fraction]] | None:
        """Expected size of the errors of the parameters that this block models: the exact gain that weighs relative
        errors equally; None for a block that models no parameters. `others` is the size for parameters without a prior.
        """
        del robot, others
        return None

    @abstractmethod
    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Outputs, rates and next values, as pure expressions."""

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """Initial values of states without a parameter of the same name, as functions of the plant's initial state."""
        del u, p, truth
        return {}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """Storage, dissipation and supply rate; for a discrete-time block storage, decrease and residual over a sample;
        None for a block that can run but has no proof.
        """
        del u, x, p, truth
        return None

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The conditions of the block's proof."""
        del p, truth
        return ()

    def composed_equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The complete equations: those of `equations` and the terms of an `AdaptingBlock`. Blocks do not override it.

        Like the three methods below, it is evaluated without the block's numbers (`dmframe.block.numberless`).
        """
        return without_numbers(self, owner_of(u)).equations(u, x, p)

    def composed_start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The complete initial values."""
        return without_numbers(self, owner_of(u)).start(u, p, truth)

    def composed_conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The complete conditions."""
        return without_numbers(self, owner_of(p)).conditions(p, truth)

    def composed_certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """The certificate that is proved: that of `certificate` with the squares of its estimates in its storage."""
        stated = without_numbers(self, owner_of(u)).certificate(u, x, p, truth)
        return with_estimates(stated, x) if isinstance(stated, Certificate) and stated.estimates else stated

    def evaluate(
        self, inputs: Mapping[str, Any] | None = None, states: Mapping[str, Any] | None = None, *, robot: Any = None
    ) -> Values:
        """Evaluate the equations at numbers.

        The equations are stated at the first call for a robot and sizes: a global function that is replaced later acts
        on new blocks only.

        Parameters
        ----------
        inputs, states
            By name, in the port's units: a number, (n,) or (n, p). An omitted input is zero, if it is optional or
            drawn; an omitted state has the value of the parameter of its name, or zero.
        robot
            For a block that uses one: a `dmframe.robot.SerialChain`, or a robot's name.

        Returns
        -------
        Values
            Arrays by name: `outputs`, `rates` of the states, and `next` of the sampled ones, before any box or ball.

        Raises
        ------
        DmframeError
            Unknown names, inconsistent sizes, or an undetermined size.
        """
        from dmframe.block.evaluate import evaluate  # avoids a circular import

        return evaluate(self, inputs or {}, states or {}, robot)

    def _repr_html_(self) -> str:
        """HTML for a notebook: the block's parameters with their units."""
        units = {name: spec.unit for name, spec in specs(type(self)).items()}
        rows = [(name, str(value), units.get(name, "")) for name, value in self if value is not None]
        return notebook.heading(type_name(type(self)), (self.__doc__ or "").split("\n")[0]) + notebook.table(
            rows, ("parameter", "value", "unit")
        )

    @classmethod
    def fitting(cls, signals: Collection[str]) -> Mapping[str, Any] | None:
        """Default parameters with which a graph's key ``reality`` inserts the block.

        None if it cannot be inserted into a graph whose blocks output these signals.
        """
        needed = (port for port in cls.inputs if not (port.optional or port.drawn or port in (TIME, PERIOD)))
        return {} if all(port.name in signals for port in needed) else None

    @classmethod
    def contract(cls, where: str) -> list[DmframeError]:
        """Faults of the class itself: names, units and references of its ports, states and parameters."""
        from dmframe.block.contract import breaches  # avoids a circular import

        return [BlockError(f"{where}: {text}") for text in breaches(cls)]
