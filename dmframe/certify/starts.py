"""Initial values of the states of a claim, as far as the graph's numbers determine them."""

from __future__ import annotations

from collections.abc import Container, Mapping
from fractions import Fraction
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.faults import fault_context
from dmframe.block.model import symbols_in
from dmframe.certify.begun import Begun
from dmframe.certify.checked import Numbers
from dmframe.common.errors import BlockError, ValueFault
from dmframe.diagram.view import view
from dmframe.prove.definite import Number
from dmframe.robot.rational import decimal

ZERO: Final = Fraction(0)


def start_of(label: str, numbers: Numbers, given: Mapping[str, Any]) -> list[Number | None]:
    """Initial value of a state, column by column; None for an element that depends on more than parameters.

    Parameters
    ----------
    label
        ``block.state``.
    given
        The graph's key `start`, which has precedence over the block.
    """
    if label in numbers.starts:
        return list(numbers.starts[label])
    number = _number(label, numbers, given)
    if number is not None:
        return [decimal(float(value)) for value in number]
    size = _size(label, numbers)
    try:
        starts = _start_of(label, numbers)
    except BlockError:  # an invalid initial value, which a run reports
        return [None] * size
    return [ZERO] * size if starts is None else [_value(starts[row], numbers) for row in range(size)]


def has_start(label: str, numbers: Numbers, given: Mapping[str, Any]) -> bool:
    """True if a graph, a parameter or a block states the initial value, and for a default of zero.

    Only for states of the plant a run may compute one, if a measured signal follows a trajectory.
    """
    loop = numbers.claim.loop
    if not (loop.followed and any(variable.label == label for variable in loop.plant)):
        return True
    try:
        return _number(label, numbers, given) is not None or _start_of(label, numbers) is not None
    except BlockError:
        return True


def start_expression(label: str, numbers: Numbers, given: Mapping[str, Any]) -> SX | None:
    """The same as an expression, whose elements may contain more than parameters; None for an invalid initial value."""
    if _given(label, numbers, given) is None:
        for parameter in numbers.claim.loop.parameters:
            if parameter.label == label:
                return ca.vec(parameter.symbol)
    number = _number(label, numbers, given)
    if number is not None:
        return ca.SX(ca.DM(number))
    try:
        starts = _start_of(label, numbers)
    except BlockError:
        return None
    return ca.SX.zeros(_size(label, numbers)) if starts is None else starts


def _size(label: str, numbers: Numbers) -> int:
    block, _, state = label.partition(".")
    size: int = numbers.claim.diagram.models[block].states[state].numel()
    return size


def _number(label: str, numbers: Numbers, given: Mapping[str, Any]) -> np.ndarray | None:
    """Initial value from a graph or a parameter; one number for all elements, or each, a matrix column by column."""
    block, _, state = label.partition(".")
    for values in (_given(label, numbers, given), numbers.claim.diagram.models[block].values.get(state)):
        if values is not None:
            array = np.asarray(values, dtype=float)
            flat = array.ravel(order="F") if array.ndim > 1 else array
            return np.broadcast_to(flat, (_size(label, numbers),))
    return None


def _start_of(label: str, numbers: Numbers) -> SX | None:
    """Initial value from the block, in the independent variables of the loop; raises `BlockError`."""
    claim, (block, _, state) = numbers.claim, label.partition(".")
    seen = view(claim.diagram, block, claim.truths)
    with fault_context(block, "start()"):
        starts = claim.diagram.models[block].block.composed_start(seen.u, seen.p, seen.truth).get(state)
    return None if starts is None else claim.loop.joined([ca.vec(ca.densify(ca.SX(starts)))])[0]


def margin_from_start(
    margin: SX, numbers: Numbers, given: Mapping[str, Any], labels: Container[str] | None = None, *, zero: bool = False
) -> Begun:
    """A margin in states, evaluated at the initial state.

    Parameters
    ----------
    labels
        States whose initial values are substituted; by default all in the margin.
    zero
        True if a state without a stated initial value starts at zero.
    """
    loop, symbols, starts, left = numbers.claim.loop, dict[str, SX](), dict[str, SX | None](), [margin]
    while left:  # the initial value of a state may contain that of another
        used, left = symbols_in(left), []
        for variable in loop.variables:
            label = variable.label
            if label not in starts and used & variable.identities and (labels is None or label in labels):
                given_start = zero or has_start(label, numbers, given)
                value = start_expression(label, numbers, given) if given_start else None
                symbols[label] = numbers.claim.starts[label]
                starts[label] = None if value is None else ca.densify(loop.joined([value])[0])
                left += [] if value is None else [value]
    old = [ca.vec(variable.symbol) for variable in loop.variables if variable.label in symbols]
    new = [symbols[variable.label] for variable in loop.variables if variable.label in symbols]
    margin, *values = ca.substitute([margin, *(value for value in starts.values() if value is not None)], old, new)
    known = iter(values)
    starts = {label: None if value is None else next(known) for label, value in starts.items()}
    return Begun(margin, symbols, starts, frozenset(numbers.known))


def _given(label: str, numbers: Numbers, given: Mapping[str, Any]) -> Any:
    """Value of the state in a graph's key `start`, by its label, or by a name of which it is the first, as in a run."""
    loop = numbers.claim.loop
    if label in given:
        return given[label]
    first = {variable.name: variable.label for variable in reversed([*loop.plant, *loop.controller])}
    name = label.partition(".")[2]
    return given.get(name) if first[name] == label else None


def _value(expression: SX, numbers: Numbers) -> Number | None:
    if not symbols_in([expression]) <= numbers.known:
        return None
    try:
        return numbers.of(expression)[0]
    except (ValueFault, ZeroDivisionError):
        return None
