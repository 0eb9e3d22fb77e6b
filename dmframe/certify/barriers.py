"""How far the position may exceed the limits of its reference: a bound from V at the start, joint by joint."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.barrier import Barrier
from dmframe.block.certificate import SX, Square
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.starts import has_start, start_expression
from dmframe.certify.statements import Statement
from dmframe.certify.symbols import Symbols
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.text import Label, Text, around, sentence
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import UndecidedError
from dmframe.exact.literal import literal
from dmframe.exact.ranges import ranges
from dmframe.exact.rational import as_float
from dmframe.program import read
from dmframe.prove.definite import lower, upper
from dmframe.simulate.start import start_state

_OUT: Final = (Context(prec=6, rounding=ROUND_FLOOR), Context(prec=6, rounding=ROUND_CEILING))
"""Outward rounding of printed limits."""

OUTWARD: Final = 1 + 1e-9
"""Factor by which floating-point results are enlarged; it exceeds all rounding errors."""


ROOM: Final = ("h(t) >= h(0) exp(-a t) - {}", r"h(t) \ge h(0) \exp(-a t) - {}", "h(t) ≥ h(0) exp(−a t) − {}")


@final
@dataclass(frozen=True)
class Tube:
    """Bound on how far a position exceeds the limits of its reference.

    Parameters
    ----------
    of, unit, position
        Name, unit and expression of the position.
    tube
        (n,) bound on the loss of distance to the limits, compared with exact tracking of the reference.
    reach
        (n,) largest excess over the limits at any time.
    margin
        (n,) distance of the limits inside the true ones.
    ends
        (2, n) true limits.
    spent
        V(0) at the graph's numbers, or its maximum over the intervals.
    """

    of: Text
    unit: str
    position: SX
    tube: np.ndarray
    reach: np.ndarray
    margin: np.ndarray
    ends: np.ndarray
    spent: float

    @property
    def inside(self) -> bool:
        """True if the position stays within the true limits."""
        return bool(np.all(self.reach <= self.margin))


def barrier_statements(found: Sequence[Tube]) -> Iterator[Statement]:
    """Limits guaranteed by each barrier of a proved claim, and the largest excess of a joint."""
    for tube in found:
        least = around(Text(_values(tube.tube, tube.unit)), *ROOM)
        room = Text("its room before what the reference keeps is ", least)
        low, high = (", ".join(_limit(out, x) for x in end) for out, end in zip(_OUT, tube.ends, strict=True))
        limits = f"{low} and {high} {tube.unit}".strip()
        if tube.inside:
            statement, then = f"stays between {limits} at all times", "and the margin is no less"
        else:
            beyond = _values(np.maximum(tube.reach - tube.margin, 0), tube.unit)
            statement = f"stays between {limits}, but for at most {beyond} beyond"
            then = f"which takes a margin of {_values(tube.reach, tube.unit)}"
        dissipates = sentence("{dV/dt} dissipates a square of the error with which the reference is followed")
        most = sentence(f"the total dissipation is at most {{V(0)}} <= {tube.spent:.4g}")
        step = Text(room, f", joint by joint, {then}; ", dissipates, ", and ", most)
        yield Statement(tube.of, statement, step, concludes=True)


def _limit(out: Context, value: float) -> str:
    return f"{float(out.create_decimal(f'{value:.12g}')):.6g}"


def _values(values: np.ndarray, unit: str) -> str:
    """Values, rounded up."""
    return f"{', '.join(f'{math.ceil(1e4 * value) / 1e4:.4f}' for value in values)} {unit}".strip()


def tubes(claim: Claim, numbers: Numbers, symbols: Symbols, start: Mapping[str, Any]) -> Iterator[Tube]:
    """The tube of each barrier; none if V may rise, or if the graph's numbers do not determine its initial value.

    V rises by a residual and at the steps of a source; statements there are not valid for all times.
    """
    stated = [(part, barrier) for part in claim.parts for barrier in part.certificate.barriers]
    if not stated or claim.cascaded or any(part.certificate.residual for part in claim.parts):
        return
    resolver = claim.diagram.resolver
    if numbers.starts or any(resolver.steps(block, port) for block, port, _ in resolver.trajectories):
        return
    begin = _start(claim, numbers, start)
    if begin is None:
        return
    spent = float(max(0.0, *_range(claim, numbers, begin, claim.V)[1]))
    for part, barrier in stated:
        share = _coefficient(claim, numbers, symbols, barrier, f"{part.block}: the position of its barrier")
        if share is None or not math.isfinite(spent):
            continue
        constants = [_column(numbers, item, len(share)) for item in _constants(barrier)]
        if any(column is None for column in constants):
            continue
        a, v, w, margin, low, high = (column for column in constants if column is not None)
        if min(map(np.min, (a, v, w))) <= 0:
            continue
        least, most = _range(claim, numbers, begin, barrier.position)
        outside = np.maximum(0.0, np.maximum(most - high, low - least))
        if not np.all(np.isfinite(outside)):
            continue
        tube = OUTWARD * np.sqrt(share * spent / (2 * a))
        reach = OUTWARD * outside + tube
        room = high - low
        if np.all(_soft_min(v, -a * reach, w) + _soft_min(v, a * (room + reach), w) >= 0):  # upper >= lower inside
            ends = np.array([low - margin, high + margin])
            yield Tube(*_named(claim, barrier), tube, reach, margin, ends, spent)


def _named(claim: Claim, barrier: Barrier) -> tuple[Text, str, SX]:
    """Name, unit and expression of the position; the name is that of the state, if it is one."""
    same = (v for v in claim.loop.variables if v.symbol.shape == barrier.position.shape)
    names = ((Text(Label(v.label)), v.unit) for v in same if ca.is_equal(v.symbol, barrier.position, 1))
    return (*next(names, (Text("the position"), "")), barrier.position)


def _constants(barrier: Barrier) -> Sequence[SX]:
    return barrier.rate, barrier.speed, barrier.width, barrier.margin, barrier.lower, barrier.upper


def _soft_min(first: Any, second: Any, width: Any) -> Any:
    return (first + second - np.hypot(first - second, width)) / 2


def _column(numbers: Numbers, expression: SX, size: int) -> np.ndarray | None:
    """A column of constants; None if it varies, is known only up to an interval, or has another shape."""
    ends = _ends(numbers, expression, size)
    return ends[0] if ends is not None and np.array_equal(*ends) else None


def _ends(numbers: Numbers, expression: SX, size: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Lower and upper bounds of a column of parameters; None for any other expression."""
    try:
        values = numbers.of(ca.SX(expression))
    except (ValueFault, ZeroDivisionError):
        return None
    if len(values) not in (1, size):
        return None
    ends = ([as_float(end(value)) for value in values] for end in (lower, upper))
    low, high = (np.broadcast_to(np.asarray(end), (size,)) for end in ends)
    return low, high


def _coefficient(claim: Claim, numbers: Numbers, symbols: Symbols, barrier: Barrier, of: str) -> np.ndarray | None:
    """C of s_i^2 <= c_i d, for the block whose dissipation d contains a square of the tracking error."""
    error = claim.flow.D(barrier.position, of) - barrier.reference
    for part in claim.parts:
        if part.certificate.dominates and _same(part, error, symbols):
            size = error.numel()
            shares = [_ends(numbers, share, size) for share in part.certificate.dominates]
            squares = [term for term in part.dominating if isinstance(term, Square) and ca.SX(term.weight).is_column()]
            weights = [_ends(numbers, term.weight, size) for term in squares]
            known = [(c, w) for c, w in zip(shares, weights, strict=False) if c is not None and w is not None]
            if len(known) == len(shares) and all(np.all(weight > 0) for _, (weight, _) in known):
                sizes = [(np.maximum(abs(low), abs(high)), weight) for (low, high), (weight, _) in known]
                return np.asarray(sum(c**2 / weight for c, weight in sizes))
    return None


def _same(part: Part, error: SX, symbols: Symbols) -> bool:
    if part.composed.shape != error.shape:
        return False
    return symbols.vanishes("error", part.composed - error)


@final
@dataclass(frozen=True)
class Begin:
    """Initial values of all states.

    Parameters
    ----------
    pairs
        Symbol and initial value of each state; values that depend on other states come first.
    symbols, values
        Symbols that replace numbers in these values, since CasADi would evaluate numbers with rounding.
    """

    pairs: Sequence[tuple[SX, SX]]
    symbols: SX
    values: Sequence[float]


def _start(claim: Claim, numbers: Numbers, given: Mapping[str, Any]) -> Begin | None:
    """Initial values of all states, as stated by their blocks, and as a run computes the plant's pose."""
    try:
        begin = start_state(claim.diagram, given)
    except DmframeError:
        return None
    own, found, row = list[tuple[SX, SX]](), list[tuple[SX, SX]](), 0
    symbols, values = list[SX](), list[float]()

    def unfolded(element: SX) -> SX:
        if not element.is_constant():
            return element
        symbols.append(ca.SX.sym("number"))
        values.append(float(element))
        return symbols[-1]

    for variable in claim.loop.variables:
        size = variable.symbol.numel()
        number = ca.SX(ca.DM(begin[row : row + size]))
        row += size
        has_own_start = has_start(variable.label, numbers, given)
        expression = start_expression(variable.label, numbers, given) if has_own_start else number
        if expression is None:
            return None
        elements = ca.vertcat(*map(unfolded, ca.vertsplit(ca.densify(expression))))
        (own if has_own_start else found).append((ca.vec(variable.symbol), elements))
    return Begin([*own, *found], stack(symbols), values)


def _range(claim: Claim, numbers: Numbers, begin: Begin, expression: SX) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of a column at the start, over the intervals; infinite if they are not found."""
    loop = claim.loop
    for _ in range(3):  # the initial value of a controller's state may be that of another state
        for symbol, value in begin.pairs:
            (expression,) = ca.substitute([expression], [symbol], [value])
        expression = loop.joined([expression])[0]
    columns = [loop.time, begin.symbols, *(stack([parameter.symbol]) for parameter in loop.parameters)]
    function = ca.Function("start", columns, [ca.densify(loop.on_path(expression))], {"allow_free": True})
    size = expression.numel()
    if not function.has_free():
        given = [Fraction(0)], list(map(literal, begin.values)), *(numbers.values[p.label] for p in loop.parameters)
        with suppress(ValueFault, UndecidedError):
            found = ranges(read(function), given)
            return np.array([as_float(x.lower) for x in found]), np.array([as_float(x.upper) for x in found])
    return np.full(size, -math.inf), np.full(size, math.inf)
