"""Evaluation of a block's methods on separate symbols, for printing and for comparison with the code that runs."""

from __future__ import annotations

import functools
import inspect
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.base import TRUE_VALUES
from dmframe.block.certificate import Certificate, Consumed
from dmframe.block.model import BlockModel
from dmframe.block.naming import Expression, Naming, NamingError, as_mx, expression_of, reading
from dmframe.block.port import PERIOD
from dmframe.block.symmetric import full_gains, lower_triangle
from dmframe.common.errors import BlockError
from dmframe.formula.points import Draw, in_balls, switching
from dmframe.formula.robot import CONSTANTS, ReadRobot, RobotFunctions


@final
@dataclass
class Signs:
    """The symbols of one reading, MX or SX.

    Parameters
    ----------
    columns
        Inputs, states, parameters and truths by kind and name.
    names
        Each printed name with its symbol, without numbers.
    naming
        Sub-expressions that the block names.
    """

    kind: Any
    columns: Mapping[str, dict[str, Expression]]
    names: dict[str, Expression]
    robot: Any
    naming: Naming

    def signals(self, owner: str, truths: Sequence[str]) -> tuple[Signals, Signals, Signals, Signals]:
        """u, x, p and truth for the block's methods."""
        parameters = self.columns["parameters"] | ({} if self.robot is None else {"robot": self.robot})
        truth = {name: self.columns["truths"][name] for name in truths}
        return (
            Signals(owner, "inputs", self.columns["inputs"]),
            Signals(owner, "states", self.columns["states"]),
            Signals(owner, "parameters", parameters),
            Signals(owner, TRUE_VALUES, truth),
        )

    def as_kind(self, value: Expression) -> Expression:
        """An expression or a number as MX, or as SX."""
        return as_mx(value) if self.kind is ca.MX else ca.SX(expression_of(value))

    def meant(self, expressions: Sequence[Expression]) -> list[Expression]:
        """Expressions in ports, states, parameters and true values, with named sub-expressions substituted."""
        out = list(expressions)
        for symbol, meaning in reversed(self.naming.definitions.values()):
            out = list(ca.substitute(out, [symbol], [ca.densify(self.as_kind(meaning))]))
        return out


@final
@dataclass
class Reading:
    """One block, read as matrices and, for the comparison, as scalars.

    Parameters
    ----------
    name
        The block's name in messages.
    zero
        Inputs that are not driven.
    constants
        True values that are numbers, such as the flag of a direct adaptation.
    """

    name: str
    model: BlockModel
    truths: Mapping[str, tuple[int, int]]
    functions: RobotFunctions | None
    zero: frozenset[str] = frozenset()
    constants: dict[str, Any] = field(default_factory=dict)

    def signs(self, kind: Any) -> Signs:
        """New symbols, `kind` being ca.MX or ca.SX."""
        model, names = self.model, dict[str, Expression]()

        def sign(name: str, shape: tuple[int, int] | ca.Sparsity) -> Expression:
            if name not in names:
                names[name] = kind.sym(name, shape if isinstance(shape, ca.Sparsity) else ca.Sparsity.dense(*shape))
            return kind(names[name])  # a copy, so that assignments to elements do not change the symbol

        inputs = {
            key: kind(*symbol.shape) if key in self.zero else sign(key, symbol.shape)
            for key, symbol in model.inputs.items()
        }
        states = {key: sign(key, symbol.shape) for key, symbol in model.states.items()}
        given = {key: s for key, s in model.parameters.items() if key not in model.starts}
        # a large gain with zeros, such as that of a prior, is inverted in a fraction of the time
        parameters = {key: sign(self.called(key), symbol.sparsity()) for key, symbol in given.items()}
        for key, symbol in model.starts.items():
            parameters[key] = sign(key.removesuffix("_0") + START, symbol.shape)
        truths = {
            key: kind(self.constants[key]) if key in self.constants else sign(key, shape)
            for key, shape in self.truths.items()
        }
        robot = None
        if model.robot is not None and self.functions is not None:
            robot = ReadRobot(self.functions, symbolic=kind is ca.MX)
        columns = {"inputs": inputs, "states": states, "parameters": parameters, "truths": truths}
        taken = {"S": "the storage"} | {name: _KINDS[what] for what, items in columns.items() for name in items}
        if robot is not None and kind is ca.MX:
            names |= {symbol.name(): symbol for symbol in robot.numbers.values()}
            taken |= {symbol.name(): "a number of the robot" for symbol in robot.numbers.values()}
        naming = Naming(lambda name, shape: kind.sym(name, *shape), taken)
        return Signs(kind, columns, names, robot, naming)

    def equations(self, signs: Signs) -> Equations:
        """The block's equations on these symbols."""
        u, x, p, _ = signs.signals(self.name, ())
        with reading(signs.naming), name_faults_at(self.name, self.model.block):
            stated = self.model.block.composed_equations(u, x, p)
        parts = (stated.outputs, stated.rates, stated.next)
        return Equations(*({name: signs.as_kind(value) for name, value in part.items()} for part in parts))

    def certificate(self, signs: Signs, truths: Sequence[str]) -> Certificate | None:
        """The block's certificate on these symbols, with the available true values."""
        with reading(signs.naming), name_faults_at(self.name, self.model.block):
            stated = self.model.block.composed_certificate(*signs.signals(self.name, truths))
        return _as_kind(stated, signs.as_kind) if isinstance(stated, Certificate) else None

    def values(self, signs: Signs, seed: int) -> dict[str, Any]:
        """Random numbers for the names of a reading (see `Draw`), with the robot's own numbers.

        Parameters and the sampling period are positive.
        """
        draw, positive = Draw(seed), {*self.model.parameters, *self.model.starts}
        positive |= {port.name for port in self.model.block.inputs if port == PERIOD}
        found = dict[str, Any]()
        for name, symbol in signs.names.items():
            bare = name.replace(START, "_0").removesuffix(GIVEN)
            found[name] = draw.numbers(symbol.shape, positive=bare in positive)
        for name in full_gains(self.model.block, self.model.parameters):
            there = ca.DM(self.model.parameters[name].sparsity(), 1).full()
            most = there.shape[0] * max(draw.size, float(np.max(found[name])) / 2)
            found[name] = there * (found[name] + found[name].T) / 2 + most * np.eye(there.shape[0])
        if signs.robot is not None and self.functions is not None:
            found |= _numbers_of(self.functions)
        return found

    def of_signs(self, signs: Signs, expressions: Sequence[Expression]) -> Evaluated:
        """Expressions of a reading, for numeric evaluation."""
        symbols = dict(signs.names)
        if signs.robot is not None:
            symbols[_CONSTANTS] = signs.robot.constants
        return Evaluated(symbols, signs.meant([signs.as_kind(item) for item in expressions]))

    def of_running(self) -> Evaluated:
        """The outputs, rates and next values that run, for numeric evaluation."""
        symbols = self.running_names()
        if self.functions is not None and self.model.robot is not None:
            symbols[_CONSTANTS] = self.functions.constants
        equations = self.model.equations
        gains = full_gains(self.model.block, self.model.parameters)
        return Evaluated(symbols, equations.expressions, self.zero, gains)

    def exactly(self, first: Evaluated, second: Evaluated) -> tuple[Evaluated, Evaluated] | None:
        """Both in the same SX symbols; None for a block with a robot, whose dynamics require true rotations."""
        if self.functions is not None and self.model.robot is not None:
            return None
        gains = full_gains(self.model.block, self.model.parameters)
        shared = dict[str, Any]()
        for evaluated in (first, second):
            for name, symbol in evaluated.symbols.items():
                if name not in shared:
                    own = name in gains
                    shared[name] = self.model.parameters[name] if own else ca.SX.sym(name, *symbol.shape)
        try:
            both = first.of(shared), second.of(shared)
        except RuntimeError:  # a function without scalar expressions
            return None
        one, other = (Evaluated(shared, side, self.zero, [name for name in gains if name in shared]) for side in both)
        return one, other

    def called(self, parameter: str) -> str:
        """Printed name of a parameter; a modified one if an output of the same name has another shape."""
        output = self.model.equations.outputs.get(parameter)
        other = output is not None and output.shape != self.model.parameters[parameter].shape
        return parameter + GIVEN if other else parameter

    def running_names(self) -> dict[str, Any]:
        """The symbols of the equations that run, by printed name."""
        model = self.model
        starts = {key.removesuffix("_0") + START: symbol for key, symbol in model.starts.items()}
        parameters = {self.called(key): s for key, s in model.parameters.items() if key not in model.starts}
        return {**model.inputs, **model.states, **parameters, **starts}


@final
class Evaluated:
    """Expressions as a function of named numbers; names in `zero` are zero, matrices in `gains` are symmetric."""

    def __init__(
        self,
        symbols: Mapping[str, Any],
        expressions: Sequence[Expression],
        zero: Collection[str] = (),
        gains: Collection[str] = (),
    ) -> None:
        self.symbols, self.zero, self.gains, self.expressions = symbols, zero, gains, expressions
        self._lower = {name: lower_triangle(symbols[name]) for name in gains}
        options = {"allow_duplicate_io_names": True}
        inputs = [self._lower[name][0] if name in self._lower else symbol for name, symbol in symbols.items()]
        free = ca.Function("free", inputs, list(expressions), options | {"allow_free": True})
        if free.has_free():
            names = ", ".join(str(symbol) for symbol in free.get_free())
            raise BlockError(
                f"a certificate contains {names}, which is neither a signal nor a parameter of this diagram"
            )
        self._function = free

    def at(self, values: Mapping[str, Any]) -> list[np.ndarray]:
        """Their numbers; NaN where CasADi cannot evaluate them, such as the inverse of a singular matrix."""
        given = self._given(values)
        try:
            return [value.full() for value in self._function.call(given)]
        except RuntimeError:
            return [self._one(k, given) for k in range(self._function.n_out())]

    def _one(self, place: int, given: Sequence[Any]) -> np.ndarray:
        """The numbers of one expression."""
        one = self._function.slice("one", list(range(self._function.n_in())), [place])
        try:
            return np.asarray(one.call(given)[0].full())
        except RuntimeError:
            return np.full(one.size_out(0), np.nan)

    def in_balls(self, values: Mapping[str, Any], place: int) -> np.ndarray | None:
        """The numbers of one expression by `dmframe.formula.points.in_balls`."""
        return in_balls(self._function, self._given(values), place)

    def _given(self, values: Mapping[str, Any]) -> list[Any]:
        given = [ca.DM(*s.shape) if name in self.zero else values[name] for name, s in self.symbols.items()]
        for place, name in enumerate(self.symbols):
            if name in self._lower:
                _, rows, columns = self._lower[name]
                given[place] = np.asarray(values[name])[rows, columns]
        return given

    def of(self, symbols: Mapping[str, Any]) -> list[Any]:
        """The same expressions in other symbols, SX."""
        given = [ca.SX(*s.shape) if name in self.zero else symbols[name] for name, s in self.symbols.items()]
        for place, name in enumerate(self.symbols):
            if name in self._lower:
                given[place] = lower_triangle(symbols[name])[0]
        return list(self._function.call(given))

    def only(self, done: Sequence[bool]) -> Evaluated:
        """The expressions that are not done yet."""
        left = [item for item, shown in zip(self.expressions, done, strict=True) if not shown]
        return self if len(left) == len(self.expressions) else Evaluated(self.symbols, left, self.zero, self.gains)

    def turns(self) -> Evaluated | None:
        """Switching functions of the expressions; None if there are none, or for MX, where they cannot be found."""
        if not all(isinstance(item, ca.SX | ca.DM) for item in (*self.symbols.values(), *self.expressions)):
            return None
        found = switching(self.expressions)
        return Evaluated(self.symbols, [ca.vertcat(*found)], self.zero, self.gains) if found else None


@functools.lru_cache(maxsize=8)
def _numbers_of(functions: RobotFunctions) -> dict[str, np.ndarray]:
    """The numbers of a robot, by printed name, and all of them."""
    return {CONSTANTS[name]: functions.value(name).full() for name in CONSTANTS} | {_CONSTANTS: functions.values.full()}


START: Final = "(0)"
"""Suffix of a name that is the initial value of a state."""
GIVEN: Final = "_given"
"""Suffix of a parameter with the name of a different output: the points of a path, and the path."""
_CONSTANTS: Final = "constants of the robot"
_KINDS: Final = {"inputs": "an input", "states": "a state", "parameters": "a parameter", "truths": "a true value"}


def _as_kind(stated: Certificate, convert: Callable[[Expression], Expression]) -> Certificate:
    """A certificate with all its expressions converted to one type."""

    def terms(role: str) -> tuple[Any, ...]:
        return tuple(term.with_pieces([convert(piece) for piece in term.pieces]) for term in getattr(stated, role))

    return replace(
        stated,
        storage=terms("storage"),
        dissipation=terms("dissipation"),
        residual=terms("residual"),
        supply=convert(stated.supply),
        consumes=stated.consumes and Consumed(convert(stated.consumes.vector), convert(stated.consumes.c)),
        dominates=tuple(map(convert, stated.dominates)),
        linear=terms("linear"),
        barriers=terms("barriers"),
        truth={name: convert(value) for name, value in stated.truth.items()},
        estimates={
            name: true.with_pieces([convert(piece) for piece in true.pieces]) for name, true in stated.estimates.items()
        },
    )


@contextmanager
def name_faults_at(name: str, block: AbstractBlock) -> Iterator[None]:
    """Report an invalid name with the file and line of the block that uses it."""
    try:
        yield
    except NamingError as error:
        file = inspect.unwrap(type(block).equations).__code__.co_filename
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        where = f"{Path(file).name}:{frames[-1].lineno}: " if frames else ""
        raise BlockError(f"{name}: {where}{error.text}") from None


def place_of(block: type[AbstractBlock], method: str) -> str:
    """File and line of a method of a block."""
    function = inspect.unwrap(getattr(block, method))
    return f"{Path(function.__code__.co_filename).name}:{function.__code__.co_firstlineno}"
