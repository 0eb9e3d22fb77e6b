"""Symbolic model of one block: inputs are local symbols, states and parameters are named for the whole diagram."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.base import AbstractBlock, Equations, Signals, own_copy
from dmframe.block.certificate import SX
from dmframe.block.faults import fault_context
from dmframe.block.linalg import Inverted, inverting, nodes
from dmframe.block.parameter import specs
from dmframe.block.port import Adapted, Side, Signal, State
from dmframe.block.sizes import Sizes
from dmframe.block.steady import Steadiness, same_expression, stated_equations
from dmframe.block.symmetric import symmetric_symbol
from dmframe.common.errors import BlockError, nearest
from dmframe.common.interrupts import Insistent

SYMBOLIC: Final = Insistent()
"""Lock for creating and reading expressions: CasADi's reference counts are not thread-safe."""


@final
@dataclass(frozen=True)
class BlockModel:
    """A block's equations, evaluated once on symbols.

    `starts` are the initial values set by parameters, ``w_0`` for the state w; one that the equations read is also
    among the `parameters`. `inverted` are the matrices that the equations invert.
    """

    name: str
    block: AbstractBlock
    inputs: Mapping[str, SX]
    states: Mapping[str, SX]
    parameters: Mapping[str, SX]
    values: Mapping[str, np.ndarray]
    robot: Any
    equations: Equations
    starts: Mapping[str, SX]
    inverted: tuple[Inverted, ...] = ()

    def signals(self) -> tuple[Signals, Signals, Signals]:
        """u, x, p for the block's methods."""
        return signals_of(self.name, self.inputs, self.states, {**self.parameters, **self.starts}, self.robot)

    @cached_property
    def size(self) -> int:
        """Number of operations in its equations."""
        return sum(map(ca.n_nodes, self.equations.expressions))

    @cached_property
    def moving(self) -> set[int]:
        """Identities of the scalar symbols of its inputs and states, the only ones that vary in a run."""
        return symbols_in([*self.inputs.values(), *self.states.values()])

    @cached_property
    def identities(self) -> Mapping[str, set[int]]:
        """Identities of the scalar symbols of each state."""
        return {name: symbols_in([symbol]) for name, symbol in self.states.items()}

    @property
    def estimates(self) -> tuple[Adapted, ...]:
        """The estimates that the block has with its options."""
        return tuple(item for item in self.block.estimates if item.name in self.states)

    def stated_start(self, sizes: Sizes) -> Mapping[str, SX] | str:
        """Initial values of the block's states in its own symbols, with truths; or the name of an unknown symbol."""
        u, _, p = self.signals()
        known = {
            port.name: symbol(port.name, sizes.of(port.shape)) for port in self.block.truth if sizes.has_sizes_of(port)
        }
        try:
            with fault_context(self.name, "start()"):
                stated = self.block.composed_start(u, p, Signals(self.name, "truths of known size", known))
            return {name: ca.SX(value) for name, value in stated.items()}
        except BlockError as fault:  # raised again by a run that needs the initial values
            return fault.text

    def needs(self, expression: SX) -> tuple[str, ...]:
        """The inputs on which an expression depends; direct feedthrough is determined from its structure."""
        key = nodes(expression)
        if key not in self._needed:  # the stored expression keeps the identities of its nodes valid
            used = symbols_in([expression])
            self._needed[key] = tuple(name for name, symbols in self._leaves.items() if used & symbols), expression
        return self._needed[key][0]

    @cached_property
    def _leaves(self) -> dict[str, set[int]]:
        return {name: symbols_in([symbol]) for name, symbol in self.inputs.items()}

    @cached_property
    def _needed(self) -> dict[Any, tuple[tuple[str, ...], SX]]:
        return {}


def symbols_in(expressions: Iterable[SX]) -> set[int]:
    """Identities of the scalar symbols on which expressions depend."""
    given = list(expressions)
    single = len(given) == 1 and isinstance(given[0], ca.SX)  # the usual case; a copy would double the time
    column = given[0] if single else ca.veccat(ca.SX(0, 1), *given)
    return {symbol.element_hash() for symbol in ca.symvar(column)}


def depending(expressions: Sequence[SX], on: Collection[int]) -> list[bool]:
    """Whether each scalar depends on a symbol with one of these identities, in one pass over common subexpressions."""
    column = ca.veccat(ca.SX(0, 1), *expressions)
    symbols = [symbol for symbol in ca.symvar(column) if symbol.element_hash() in on]
    if not symbols:
        return [False] * len(expressions)
    return list(map(bool, ca.which_depends(column, ca.vertcat(*symbols), 1, True)))


def with_starts(values: Mapping[str, np.ndarray], states: Collection[str]) -> dict[str, np.ndarray]:
    """A block's numbers; initial values of states are repeated under the names that equations read."""
    return {**values, **{f"{key}_0": value for key, value in values.items() if key in states}}


def symbol(name: str, size: tuple[int, ...]) -> SX:
    """A symbol of that size: () a scalar, (n,) a column, (n, p) a matrix."""
    return ca.SX.sym(name, *(size or (1,)))


def _plain_symbol(name: str, value: np.ndarray) -> SX:
    return symbol(name, value.shape)


def signals_of(
    name: str,
    inputs: Mapping[str, SX],
    states: Mapping[str, SX],
    parameters: Mapping[str, SX],
    robot: Any,
    options: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Signals, Signals, Signals]:
    """Wrap symbols for a block's methods; `options` are the annotations of fields that are not parameters."""
    if robot is not None and not isinstance(robot, Recalled):
        robot = Recalled(robot)
    given = {**parameters, "robot": robot} if robot is not None else parameters
    p = Signals(name, "parameters", given, options)
    return Signals(name, "inputs", inputs), Signals(name, "states", states), p


def _options(block: AbstractBlock) -> Mapping[str, str]:
    """Annotations of the fields that equations cannot read as parameters."""
    known = specs(type(block))
    fields = {name: field.annotation for name, field in type(block).model_fields.items() if name not in known}
    return {name: getattr(kind, "__name__", str(kind)) for name, kind in fields.items()}


def model_block(
    name: str,
    block: AbstractBlock,
    values: Mapping[str, np.ndarray],
    sizes: Sizes,
    robot: Any,
    unchecked: list[Steadiness] | None = None,
) -> BlockModel:
    """Evaluate a block's equations on new symbols, and check them against the block's declared ports and states.

    With a list `unchecked`, the check at other numbers is entered there, if it was not done before.
    """
    states = {state.name: symbol(f"{name}.{state.name}", sizes.of(state.shape)) for state in block.states}
    gains = {key for key, spec in specs(type(block)).items() if spec.form == "gain"}
    parameters = {
        key: (symmetric_symbol if key in gains and value.ndim == 2 else _plain_symbol)(f"{name}.{key}", value)
        for key, value in values.items()
        if key not in states
    }
    starts = {f"{key}_0": symbol(f"{name}.{key}_0", value.shape) for key, value in values.items() if key in states}
    inputs = {port.name: symbol(port.name, sizes.of(port.shape)) for port in block.inputs}
    mine = robot if block.uses_robot else None
    signals = signals_of(name, inputs, states, {**parameters, **starts}, mine, _options(block))
    with inverting() as inverted:
        equations = stated_by(name, block, signals, sizes)

    def again(other: AbstractBlock) -> Mapping[str, SX]:
        with inverting(inverted):
            return stated_equations(stated_by(name, other, signals, sizes))

    steady = Steadiness(name, block, "equations() state", stated_equations(equations), again)
    if unchecked is None:
        steady.settle()
    elif not steady.confirmed:
        unchecked.append(steady)
    for key in states.keys() & equations.outputs.keys():
        if not same_expression(equations.outputs[key], states[key]):
            raise BlockError(
                f"{name}: its output {key} differs from its state {key}, and both have the same name; rename one"
            )
    used = symbols_in([*equations.expressions, *equations.second.values()])
    robots = () if mine is None else (constant.symbol for constant in mine.constants)
    own = symbols_in([*inputs.values(), *states.values(), *parameters.values(), *starts.values(), *robots])
    if used - own:
        raise _foreign(name, equations, own)
    for key in states.keys() - equations.moves.keys():
        if used & symbols_in([states.pop(key)]):
            raise BlockError(f"{name}: equations read the state {key}, but do not state its rate")
    parameters |= {key: leaf for key, leaf in starts.items() if used & symbols_in([leaf])}
    values = with_starts(values, states)
    return BlockModel(name, block, inputs, states, parameters, values, mine, equations, starts, tuple(inverted))


def _foreign(name: str, equations: Equations, own: set[int]) -> BlockError:
    """The fault of equations with a symbol of another block, or of none."""
    stated = stated_equations(equations)
    what, symbol = next((w, s) for w, x in stated.items() for s in ca.symvar(x) if s.element_hash() not in own)
    return BlockError(
        f"{name}: equations() state the {what} with {symbol}, which is none of its inputs, states and parameters; "
        "expected an expression of its arguments alone"
    )


@final
class Recalled:
    """A robot model as a block's methods read it.

    It caches its results, which take most of the time of a build, and returns copies, since a method may assign to
    their elements.
    """

    def __init__(self, robot: Any) -> None:
        self._robot, self._results = robot, dict[Any, tuple[Any, Any]]()

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._robot, name)
        if not callable(found):
            return own_copy(found)

        def result(*given: Any, **named: Any) -> Any:
            key = (name, *map(_identity, given), *((word, _identity(value)) for word, value in named.items()))
            if key not in self._results:  # the stored arguments keep their identities unique
                self._results[key] = (found(*given, **named), (given, named))
            kept = self._results[key][0]
            return Recalled(kept) if isinstance(kept, type(self._robot)) else own_copy(kept)

        return result


def _identity(value: Any) -> Any:
    return nodes(value) if isinstance(value, ca.SX) else id(value)


def stated_by(name: str, block: AbstractBlock, signals: tuple[Signals, Signals, Signals], sizes: Sizes) -> Equations:
    """A block's equations, checked against its declared ports and states."""
    with fault_context(name, "equations()"):
        stated = block.composed_equations(*signals)
    if not isinstance(stated, Equations):
        raise BlockError(f"{name}: expected equations() to return Equations, found {type(stated).__name__}")
    sampled = [state for state in block.states if state.sampled]
    moving = [state for state in block.states if not state.sampled]
    for kind, others, found in (("rate", sampled, stated.rates), ("next value", moving, stated.next)):
        for key in (state.name for state in others if state.name in found):
            raise BlockError(f"{name}: equations state the {kind} of {key}, {_OTHERWISE[kind]}")
    stepped = [state for state in moving if state.name in stated.second]
    for key in stated.second.keys() - {state.name for state in moving if block.side is Side.CONTROLLER}:
        raise BlockError(
            f"{name}: equations state the second term of {key}, which has no step on a clock; expected a continuous "
            "state of a controller"
        )
    return Equations(
        _checked(name, "output", block.outputs, stated.outputs, sizes),
        _checked(name, "rate", moving, stated.rates, sizes),
        _checked(name, "next value", sampled, stated.next, sizes),
        _checked(name, "second term", stepped, stated.second, sizes),
    )


_OTHERWISE: Final = {
    "rate": "which is a sampled state; state its next value, or declare it without sampled",
    "next value": "which is a continuous state; state its rate, or declare it with sampled=True",
}
"""Message if the equations state a rate of a sampled state, or a next value of a continuous one."""


def _checked(
    name: str, kind: str, declared: Sequence[Signal | State], stated: Mapping[str, SX], sizes: Sizes
) -> dict[str, SX]:
    known = {item.name: item for item in declared}
    for key in stated:
        if key not in known:
            raise BlockError(
                f"{name}: equations state the {kind} of {key}, which is not declared; {nearest(key, known)}"
            )
    checked = {}
    for key, item in known.items():
        if key not in stated:
            if item.optional:
                continue
            raise BlockError(f"{name}: equations leave out the {kind} of {key}")
        try:
            expression = ca.SX(stated[key])
        except (
            NotImplementedError,
            RuntimeError,
            TypeError,
        ):  # raised by CasADi for an object that is not an expression
            found = type(stated[key]).__name__
            raise BlockError(f"{name}: expected the {kind} of {key} to be an expression, found {found}") from None
        unbound = [word for word in item.shape.split() if not word.isdigit() and word not in sizes.bound]
        if unbound:
            raise BlockError(f"{name}: the size {unbound[0]} of the {kind} of {key} is undetermined")
        size = sizes.of(item.shape)
        expected = (*size, 1, 1)[:2]
        if expression.shape != expected:
            raise BlockError(
                f"{name}: expected the {kind} of {key} to have the shape {sizes.explain(item.shape)}, "
                f"found {expression.shape[0]} x {expression.shape[1]}"
            )
        checked[key] = expression
    return checked
