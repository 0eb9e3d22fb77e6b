"""How far from the limits that a reference keeps the robot may be: what V can spend at the start, joint by joint."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.barrier import Barrier
from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Square
from dmframe.certify.checked import Numbers, lower, upper
from dmframe.certify.claim import Claim, Field, Part
from dmframe.certify.starts import start_expression, start_is_said
from dmframe.certify.statements import Statement
from dmframe.certify.symbols import Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.errors import DmframeError, ValueFault
from dmframe.exact import zero_test
from dmframe.exact.ends import enclosing
from dmframe.exact.rational import as_float
from dmframe.simulate.start import start_state

OUTWARD: Final = 1 + 1e-9
"""By which floating-point figures are enlarged: more than all rounding on the way to them."""


@final
@dataclass(frozen=True)
class Tube:
    """How far a position may pass the limits that a reference keeps.

    Parameters
    ----------
    of, unit, position
        The position: its name, its unit, and itself.
    reach
        (n,) the most by which it passes them at any time.
    margin
        (n,) by how much they lie inside the true ones.
    ends
        (2, n) the true limits.
    spent
        V(0), at the graph's numbers, or the most that it is over the intervals.
    """

    of: str
    unit: str
    position: SX
    reach: np.ndarray
    margin: np.ndarray
    ends: np.ndarray
    spent: float

    @property
    def inside(self) -> bool:
        """The true limits are kept."""
        return bool(np.all(self.reach <= self.margin))


def barrier_statements(found: Sequence[Tube]) -> Iterator[Statement]:
    """What each barrier of a proved claim keeps, and by how much a joint may pass it."""
    for tube in found:
        reach = f"it passes what its reference keeps by at most {_told(tube.reach, tube.unit)}, joint by joint"
        if tube.inside:
            says, then = "stays within its limits at all times", "and the margin is no less"
        else:
            says = f"passes its limits by at most {_told(np.maximum(tube.reach - tube.margin, 0), tube.unit)}"
            then = "which as a margin would keep the limits"
        spends = f"dV/dt spends of that error a square, and V has no more than V(0) <= {tube.spent:.4g} to spend"
        step = f"{reach}, {then}: its room shrinks no faster than the reference lets it and the error adds; {spends}"
        yield Statement(tube.of, says, step, concludes=True)


def _told(values: np.ndarray, unit: str) -> str:
    """Rounded up."""
    return f"{', '.join(f'{math.ceil(1e4 * value) / 1e4:.4f}' for value in values)} {unit}".strip()


def tubes(claim: Claim, numbers: Numbers, symbols: Symbols, start: Mapping[str, Any]) -> Iterator[Tube]:
    """The tube of each barrier; none where V may rise, or where it starts is not told by the graph's numbers."""
    stated = [(part, barrier) for part in claim.parts for barrier in part.certificate.barriers]
    if not stated or claim.cascaded or any(part.certificate.excess for part in claim.parts):
        return
    begin = _start(claim, numbers, start)
    if begin is None:
        return
    spent = _most(claim, numbers, begin, claim.V)
    for _, barrier in stated:
        share = _share(claim, numbers, symbols, barrier)
        if share is None or not math.isfinite(spent):
            continue
        a, v, w, margin, low, high = (_column(numbers, item, len(share)) for item in _constants(barrier))
        q = np.asarray([_most(claim, numbers, begin, element) for element in ca.vertsplit(barrier.position)])
        outside = np.maximum(0.0, np.maximum(q - high, low - q))
        reach = OUTWARD * (outside + np.sqrt(share * spent / (2 * a)))
        room = high - low
        if np.all(_soft_min(v, -a * reach, w) + _soft_min(v, a * (room + reach), w) >= 0):  # upper >= lower inside
            ends = np.array([low - margin, high + margin])
            yield Tube(*_named(claim, barrier), reach, margin, ends, spent)


def _named(claim: Claim, barrier: Barrier) -> tuple[str, str, SX]:
    """The state that the position is, with its unit."""
    same = (v for v in claim.loop.variables if v.symbol.shape == barrier.position.shape)
    names = ((v.label, v.unit) for v in same if ca.is_equal(v.symbol, barrier.position, 1))
    return (*next(names, ("the position", "")), barrier.position)


def _constants(barrier: Barrier) -> Sequence[SX]:
    return barrier.rate, barrier.speed, barrier.width, barrier.margin, barrier.lower, barrier.upper


def _soft_min(first: Any, second: Any, width: Any) -> Any:
    return (first + second - np.hypot(first - second, width)) / 2


def _column(numbers: Numbers, expression: SX, size: int) -> np.ndarray:
    values = [as_float(lower(value)) for value in numbers.of(ca.SX(expression))]
    return np.broadcast_to(np.asarray(values), (size,))


def _share(claim: Claim, numbers: Numbers, symbols: Symbols, barrier: Barrier) -> np.ndarray | None:
    """C of s_i^2 <= c_i times what is spent, of the block that spends the error of following the reference."""
    error = Field(claim.diagram).derivative(barrier.position) - barrier.reference
    for part in claim.parts:
        if part.certificate.pays and _same(part, error, symbols):
            size = error.numel()
            shares = [_column(numbers, share, size) for share in part.certificate.pays]
            weights = [_column(numbers, term.weight, size) for term in part.paying if isinstance(term, Square)]
            if len(weights) == len(shares) and all(np.all(weight > 0) for weight in weights):
                return np.asarray(sum(c**2 / weight for c, weight in zip(shares, weights, strict=True)))
    return None


def _same(part: Part, error: SX, symbols: Symbols) -> bool:
    if part.composed.shape != error.shape:
        return False
    return bool(zero_test(symbols.function("error", [part.composed - error]), values=symbols.fixed).zero)


Begin = Sequence[tuple[SX, SX]]
"""Each state's symbol with where it starts, those first whose starts hold others."""


def _start(claim: Claim, numbers: Numbers, given: Mapping[str, Any]) -> Begin | None:
    """Where all states start: as their blocks say, and as a run finds the plant's pose."""
    try:
        begin = start_state(claim.diagram, given)
    except DmframeError:
        return None
    said, found, row = list[tuple[SX, SX]](), list[tuple[SX, SX]](), 0
    for variable in claim.loop.variables:
        size = variable.symbol.numel()
        number = ca.SX(ca.DM(begin[row : row + size]))
        row += size
        if start_is_said(variable.label, numbers, given):
            expression = start_expression(variable.label, numbers, given)
            if expression is None:
                return None
            said.append((ca.vec(variable.symbol), expression))
        else:
            found.append((ca.vec(variable.symbol), number))
    return [*said, *found]


def _most(claim: Claim, numbers: Numbers, begin: Begin, expression: SX) -> float:
    """The most that an expression is at the start, over the intervals; infinite where that is not found."""
    loop = claim.loop
    for _ in range(3):  # a controller's state may start where another one does
        for symbol, value in begin:
            (expression,) = ca.substitute([expression], [symbol], [value])
        expression = loop.joined([expression])[0]
    expression = ca.substitute(loop.on_path(expression), loop.time, 0)
    inside, known = dict[int, tuple[float, float]](), list[tuple[SX, SX]]()
    for parameter in loop.parameters:
        column = stack([parameter.symbol])
        if parameter.label in numbers.uncertain:
            ends = [(as_float(lower(value)), as_float(upper(value))) for value in numbers.values[parameter.label]]
            inside |= {s.element_hash(): pair for s, pair in zip(ca.vertsplit(column), ends, strict=True)}
        else:
            known.append((column, ca.SX(ca.DM(parameter.value.ravel(order="F")))))
    if known:
        columns, values = ca.vertcat(*(c for c, _ in known)), ca.vertcat(*(v for _, v in known))
        expression = ca.substitute(expression, columns, values)
    try:
        end = enclosing(expression, inside).upper if symbols_in([expression]) else expression
        return float(ca.DM(ca.evalf(end)))
    except (ValueFault, RuntimeError):
        return math.inf
