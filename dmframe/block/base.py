"""A block: equations, storage and conditions, stated once.

From the one statement come the simulation, the generated code, the certificate, the picture and the documentation.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, final

import casadi as ca
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from dmframe import notebook
from dmframe.block.faults import parameter_faults, told_apart
from dmframe.block.names import type_name
from dmframe.block.numberless import unreadable, without_numbers
from dmframe.certificate import SX, Certificate, Condition, Square
from dmframe.errors import BlockError, DmframeError, nearest, raise_all
from dmframe.fields import check_fields
from dmframe.parameter import read, spec_of, specs, with_stated
from dmframe.port import PERIOD, TIME, Adapted, Element, Input, Output, Port, Side, State

if TYPE_CHECKING:
    from dmframe.block.evaluate import Values


@final
class Signals:
    """Named expressions, read as attributes: ``u.dq``, ``x.w``, ``p.Lambda``."""

    def __init__(
        self, owner: str, kind: str, values: Mapping[str, SX], options: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._owner, self._kind, self._values, self._options = owner, kind, dict(values), options

    def __getattr__(self, name: str) -> SX:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self._values[name]
        except KeyError:
            if name in self._options:
                raise BlockError(
                    f"{self._owner}: its equations read {name}, a parameter annotated `{self._options[name]}`; for a "
                    f'number annotate it as {name}: Scalar = Real(unit="..."), for one per joint as {name}: Diagonal = '
                    f'Positive("n", "..."); read an option as self.{name}'
                ) from None
            text = f"{self._owner}: its equations read {name}, which is none of its {self._kind}"
            raise BlockError(f"{text}; {nearest(name, self._values)}") from None

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)


def owner_of(signals: Signals) -> str:
    """The name of the block whose signals they are."""
    return signals._owner


@final
@dataclass(frozen=True)
class Equations:
    """What a block's equations say: its outputs, the rates of its states, and the next values of its sampled ones.

    On a clock a controller's state in continuous time takes a step of the sampling period T: x + T rate, and T^2 times
    what `second` says of it, if it does, such as keeps a matrix positive definite that a plain step would not.
    """

    outputs: Mapping[str, SX] = field(default_factory=dict)
    rates: Mapping[str, SX] = field(default_factory=dict)
    next: Mapping[str, SX] = field(default_factory=dict)
    second: Mapping[str, SX] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def moves(self) -> dict[str, SX]:
        """Rates and next values, by the state's name."""
        return {**self.rates, **self.next}

    @property
    def expressions(self) -> tuple[SX, ...]:
        """All of them: outputs, rates, next values."""
        return (*self.outputs.values(), *self.rates.values(), *self.next.values())


def with_estimates(stated: Certificate, x: Signals) -> Certificate:
    """A certificate with the squares of its estimates' errors in its storage."""
    for name, true in stated.estimates.items():
        if name not in x:
            text = f"{owner_of(x)}: certificate() says what {name} estimates, which is none of its states"
            raise BlockError(f"{text}; {nearest(name, x)}")
        if isinstance(true.value, ca.SX | ca.MX) and ca.depends_on(true.value, getattr(x, name)):
            raise BlockError(f"{owner_of(x)}: certificate() says that {name} estimates what moves with {name} itself")
    squares = (Square(getattr(x, name) - true.value, true.weight) for name, true in stated.estimates.items())
    return replace(stated, storage=(*stated.storage, *squares))


def _split_ports(cls: type[AbstractBlock]) -> None:
    """Make `Input` or `Output` of each former `Port` of a class."""
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
    """The base of every block; a block is a final subclass in a file of its own.

    Parameters are pydantic fields declared through `dmframe.parameter`; ports and states are class constants. In
    the methods below `u` holds the inputs, `x` the states, `p` the parameters as symbols (and ``p.robot``, the robot's
    symbolic model, where `uses_robot`; and ``p.w_0``, where the state w starts, if a parameter w says so), and `truth`
    the signals that only the analysis may see, each by its name.

    The framework calls them on a copy of the block that has its options (bool, str, int) and none of its numbers: a
    number is read as ``p.rate``, never as ``self.rate``; ``"rate" in p`` says whether it is given.
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
    """Names of before, of parameters, states and ports, with the new ones: graph files may still use them."""
    unproved: ClassVar[str] = ""
    """Why the block has no certificate; a verdict's reason ends with it."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a class whose constants or parameters are not of their kind, before anything reads them."""
        from dmframe.block.contract import malformed  # which needs this class

        super().__pydantic_init_subclass__(**kwargs)
        _split_ports(cls)
        raise_all([BlockError(f"{cls.__name__}: {text}") for text in malformed(cls)])

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise_all(parameter_faults(type(self), error, type_name(type(self))))

    if not TYPE_CHECKING:  # to a type checker a block has what it declares

        def __getattr__(self, name: str) -> Any:
            """What is not there: of a copy without numbers, a number, which is a fault of its author."""
            if (fault := unreadable(self, name)) is not None:
                raise fault
            return super().__getattr__(name)

    @field_validator("*", mode="wrap")
    @classmethod
    def _read_quantity(cls, value: Any, checked: Any, info: Any) -> Any:
        spec = spec_of(cls.model_fields[info.field_name])
        if spec is None:
            return checked(told_apart(value, cls.model_fields[info.field_name].annotation))
        if value is None and cls.model_fields[info.field_name].default is None:
            return checked(value)
        try:
            numbers = read(value, spec)
        except DmframeError as error:
            raise ValueError(error.text) from None
        return with_stated(checked(numbers), numbers)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """Letters that this block binds by itself, ``{"p": 36}``; `robot` is the chain, or None."""
        return {letter: len(elements) for letter, elements in self.elements(robot).items()}

    def needs(self, port: str) -> bool:
        """Whether an optional input has to be driven, as this block is set."""
        del port
        return False

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """What a letter counts that this block binds, element by element: names and units for results."""
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
        """Outputs, rates and next values, as pure expressions."""

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """Where states start that no parameter of the same name sets, as functions of the plant's start."""
        del u, p, truth
        return {}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """Storage, dissipation and supply; of a block in sampled time, what it stores, loses and gains from sample to
        sample; None for a block that can run but not be proved.
        """
        del u, x, p, truth
        return None

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The inequalities that the block's proof needs."""
        del p, truth
        return ()

    def composed_equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The equations that run: those stated, and what an `AdaptingBlock` adds to them. No block overrides it.

        It is stated without the block's numbers (`dmframe.block.numberless`), as are the three below.
        """
        return without_numbers(self, owner_of(u)).equations(u, x, p)

    def composed_start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The same of the starts."""
        return without_numbers(self, owner_of(u)).start(u, p, truth)

    def composed_conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The same of the conditions."""
        return without_numbers(self, owner_of(p)).conditions(p, truth)

    def composed_certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """The certificate that is proved: the one stated, with the squares of its estimates in its storage."""
        stated = without_numbers(self, owner_of(u)).certificate(u, x, p, truth)
        return with_estimates(stated, x) if isinstance(stated, Certificate) and stated.estimates else stated

    def evaluate(
        self, inputs: Mapping[str, Any] | None = None, states: Mapping[str, Any] | None = None, *, robot: Any = None
    ) -> Values:
        """The equations at numbers.

        Parameters
        ----------
        inputs, states
            By name, in the port's units: a number, (n,) or (n, p). An input that is left out is zero, if it is optional
            or drawn; a state is where a parameter of its name says, or zero.
        robot
            Of a block that uses one: a `dmframe.robot.SerialChain`, or a robot's name.

        Returns
        -------
        Values
            Arrays by name: `outputs`, `rates` of the states, and `next` of the sampled ones, before any box or ball.

        Raises
        ------
        DmframeError
            Names that there are not, sizes that do not agree, and a size that nothing says.
        """
        from dmframe.block.evaluate import evaluate  # which needs this class

        return evaluate(self, inputs or {}, states or {}, robot)

    def _repr_html_(self) -> str:
        """For a notebook: the block's parameters with their units."""
        units = {name: spec.unit for name, spec in specs(type(self)).items()}
        rows = [(name, str(value), units.get(name, "")) for name, value in self if value is not None]
        return notebook.heading(type_name(type(self)), (self.__doc__ or "").split("\n")[0]) + notebook.table(
            rows, ("parameter", "value", "unit")
        )

    @classmethod
    def fitting(cls, signals: Collection[str]) -> Mapping[str, Any] | None:
        """The parameters with which a graph's key ``reality`` puts the block in, where the graph leaves them open.

        None where it has no place in a graph whose blocks hand out these signals.
        """
        needed = (port for port in cls.inputs if not (port.optional or port.drawn or port in (TIME, PERIOD)))
        return {} if all(port.name in signals for port in needed) else None

    @classmethod
    def contract(cls, where: str) -> list[DmframeError]:
        """What is wrong with the class itself: names, units and references of its ports, states and parameters."""
        from dmframe.block.contract import breaches  # as above

        return [BlockError(f"{where}: {text}") for text in breaches(cls)]
