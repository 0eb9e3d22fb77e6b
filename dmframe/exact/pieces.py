"""Functions of time with min, max, comparisons or floor: their smooth pieces, and jumps between the pieces.

The chain rule does not see jumps. A function with switches is therefore followed from t = 0 on. On each piece every
switch has a fixed position, determined by its argument, a polynomial of degree one in time. The piece ends at the next
zero of such an argument. At each end both one-sided limits are evaluated in ball arithmetic with fixed switches.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, TypeVar, final

import casadi as ca
from flint import arb, fmpq, fmpq_poly

from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.balls import UndecidedError, ball, enclosed, precise
from dmframe.exact.tape import Tape
from dmframe.program import CONST, DIVISIONS, EDGES, INPUT, by_code, sign_of

V = TypeVar("V")

INSTANTS: Final = 200
"""Maximum number of switching instants that are followed; a periodic switch has infinitely many."""

CONTINUOUS: Final = 1e-13
"""Largest step that rounded literals, such as sin(1) in the code, may cause, relative to the function."""

LARGEST_POWER: Final = 16
"""Largest power of a polynomial that is expanded."""

_TIME: Final = fmpq_poly([0, 1])


class NotFollowed(ArithmeticError):
    """The argument of a switch is not a polynomial of degree one in time."""


@final
@dataclass(frozen=True)
class Jump:
    """One element of a function before and after an instant."""

    time: Fraction
    element: int
    before: float
    after: float


@final
@dataclass(frozen=True)
class Course:
    """Result of following a function: its switching instants, its first jump, and the time `until` which it is known.

    `until` is None for a function that was followed for all time. `edged`: the function contains a moving divisor, a
    root or a similar operation, at whose domain boundary a jump is not detected.
    """

    instants: tuple[Fraction, ...]
    jump: Jump | None
    until: Fraction | None
    edged: bool = False


def moving_operations(tape: Tape, moving: Sequence[Sequence[bool]]) -> Iterator[tuple[int, int]]:
    """(position, code) of instructions that depend on a moving input; `moving` has a flag for each element of an input.

    The code of an integer power is that of `pow`.
    """
    given = tape.program.elements(moving)
    moves = list[bool]()
    for k, node in enumerate(tape.nodes):
        if node.code == INPUT:
            moves.append(given[node.a][node.b])
        else:
            moves.append(any(moves[operand] for operand in node.operands))
        if moves[-1]:
            yield k, node.code if tape.exponent(k) is None else ca.OP_POW


@precise()
def follow(tape: Tape, parameters: Sequence[Fraction]) -> Course:
    """Follow a function of (t, parameters) from t = 0 on.

    Raises `NotFollowed` for a switch that cannot be followed, `UndecidedError` if the function may be undefined.
    """
    instants, edged = list[Fraction](), False
    begin, before = Fraction(0), None
    moving = {k for k, _ in moving_operations(tape, [[True], *([False] * size for _, size in tape.inputs[1:])])}
    while True:
        piece = _Piece(tape, parameters, begin, moving)
        edged = edged or piece.edged
        if before is not None:
            for element, (left, right) in enumerate(zip(before.at(begin), piece.at(begin), strict=True)):
                if not abs(left - right) <= CONTINUOUS * (1 + abs(left) + abs(right)):
                    jump = Jump(begin, element, float(left), float(right))
                    return Course(tuple(instants), jump, begin, edged)
        if piece.end is None or len(instants) == INSTANTS:
            return Course(tuple(instants), None, piece.end, edged)
        begin, before = piece.end, piece
        instants.append(begin)


@final
class _Piece:
    """A function from `begin` to its next switching instant, with fixed switches."""

    def __init__(self, tape: Tape, parameters: Sequence[Fraction], begin: Fraction, moving: Container[int]) -> None:
        self._tape, self._parameters, self._begin = tape, parameters, begin
        self.end: Fraction | None = None
        self.edged = False
        self._fixed = dict[int, Fixed]()
        self._inputs = self._given(_TIME, list(map(_polynomial, parameters)))
        self._values = list[fmpq_poly | None]()
        for k in range(len(tape)):
            self._values.append(self._value(k))
            self.edged = self.edged or (self._values[-1] is None and k in moving and self._has_edge(k))

    def at(self, time: Fraction) -> list[arb]:
        """The outputs' stored elements with the switches of this piece; at its end, the limit from the left."""

        def fixed(k: int, values: Sequence[arb]) -> arb | None:
            polynomial = self._values[k]
            if polynomial is not None:
                return arb(polynomial(_rational(time)))
            if k in self._fixed:
                scale, place, offset = self._fixed[k]
                return arb(scale) * values[place] + arb(offset)
            return None

        program = self._tape.program
        given = self._given(ball(time), [ball(value) for value in self._parameters])
        found = program.stored(enclosed(program, given, override=fixed))
        return [value for output in found for value in output]

    def _has_edge(self, k: int) -> bool:
        """True for a moving divisor, and for a function with a bounded domain."""
        node, exponent = self._tape.nodes[k], self._tape.exponent(k)
        if exponent is None and node.code not in DIVISIONS:
            return node.code in EDGES or node.code == ca.OP_ATAN2
        divisor = self._values[node.b if exponent is None else node.a]
        return (exponent is None or exponent < 0) and (divisor is None or divisor.degree() != 0)

    def _value(self, k: int) -> fmpq_poly | None:
        """The value of a node as a polynomial in time on this piece, or None."""
        node = self._tape.nodes[k]
        if node.code == INPUT:
            return self._inputs[node.a][node.b]
        if node.code == CONST:
            return _polynomial(self._tape.numbers[node.constant])
        values = [self._values[operand] for operand in node.operands]
        if node.code in SWITCHES:
            deciding = values[:1] if node.code == ca.OP_IF_ELSE_ZERO else values
            if any(value is None for value in deciding):
                raise NotFollowed(f"{sign_of(node.code)} of a function that is not a polynomial in time")
            scale, chosen, offset = SWITCHES[node.code](self, [value for value in deciding if value is not None])
            self._fixed[k] = scale, node.operands[chosen], offset
            fixed = values[chosen] if scale else fmpq_poly([])
            return None if fixed is None else scale * fixed + offset
        if any(value is None for value in values):
            return None
        known = [value for value in values if value is not None]
        exponent = self._tape.exponent(k)
        if exponent is not None:
            return known[0] ** exponent if 0 <= exponent <= LARGEST_POWER else None
        if node.code in DIVISIONS and known[-1].degree() != 0:
            return None
        return ARITHMETIC[node.code](*known) if node.code in ARITHMETIC else None

    def _given(self, time: V, parameters: Sequence[V]) -> list[list[V]]:
        return self._tape.program.elements([[time], parameters][: len(self._tape.inputs)])

    def sign(self, x: fmpq_poly) -> int:
        """Sign of a polynomial just after the start of the piece; the piece ends where the sign changes."""
        value, slope = self._line(x)
        if slope and value * slope < 0:
            self._ends(self._begin - value / slope)
        return _sign(value) or _sign(slope)

    def whole(self, x: fmpq_poly) -> Fraction:
        """Floor of a polynomial just after the start of the piece; the piece ends where the floor changes."""
        value, slope = self._line(x)
        floor = Fraction(value.__floor__())
        if slope > 0:
            self._ends(self._begin + (floor + 1 - value) / slope)
        elif slope < 0:
            floor = floor - 1 if floor == value else floor
            self._ends(self._begin + (floor - value) / slope)
        return floor

    def _line(self, x: fmpq_poly) -> tuple[Fraction, Fraction]:
        """Value and slope at the start of the piece."""
        if x.degree() > 1:
            raise NotFollowed(f"a switch at the roots of a polynomial of degree {x.degree()} in time")
        return _fraction(x(_rational(self._begin))), _fraction(x[1])

    def _ends(self, time: Fraction) -> None:
        if time > self._begin and (self.end is None or time < self.end):
            self.end = time


Fixed = tuple[fmpq, int, fmpq]
"""A switch on a piece: a factor, the index of an argument, and an offset."""

_ZERO, _ONE = fmpq(0), fmpq(1)


def _rational(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def _polynomial(x: Fraction) -> fmpq_poly:
    return fmpq_poly([_rational(x)])


def _fraction(x: fmpq) -> Fraction:
    return Fraction(int(x.p), int(x.q))


def _number(value: bool) -> Fixed:
    return _ZERO, 0, fmpq(value)


def _constant(x: fmpq_poly) -> fmpq:
    if x.degree() > 0:
        raise NotFollowed("a condition or a period that is not constant between switching instants")
    return x[0]


def _truncated(piece: _Piece, x: fmpq_poly, period: fmpq) -> Fraction:
    turns = x / period
    return piece.whole(turns) if piece.sign(turns) >= 0 else -piece.whole(-turns)


def _modulo(count: Callable[[_Piece, fmpq_poly, fmpq], Fraction]) -> Callable[[_Piece, list[fmpq_poly]], Fixed]:
    def fixed(piece: _Piece, values: list[fmpq_poly]) -> Fixed:
        period = _constant(values[1])
        if not period:
            raise UndecidedError("a period of zero")
        return _ONE, 0, -period * _rational(count(piece, values[0], period))

    return fixed


def _compared(true: Callable[[int], bool]) -> Callable[[_Piece, list[fmpq_poly]], Fixed]:
    return lambda piece, values: _number(true(piece.sign(values[0] - values[1])))


def _chosen(lower: bool) -> Callable[[_Piece, list[fmpq_poly]], Fixed]:
    return lambda piece, values: (_ONE, int((piece.sign(values[0] - values[1]) > 0) is lower), _ZERO)


def _copied(piece: _Piece, values: list[fmpq_poly]) -> Fixed:
    return fmpq((piece.sign(values[0]) or 1) * (piece.sign(values[1]) or 1)), 0, _ZERO


SWITCHES: Final[Mapping[int, Callable[[_Piece, list[fmpq_poly]], Fixed]]] = by_code(
    {
        "sign": lambda piece, values: (_ZERO, 0, fmpq(piece.sign(values[0]))),
        "fabs": lambda piece, values: (fmpq(piece.sign(values[0])), 0, _ZERO),
        "fmin": _chosen(lower=True),
        "fmax": _chosen(lower=False),
        "lt": _compared(lambda sign: sign < 0),
        "le": _compared(lambda sign: sign <= 0),
        "eq": _compared(lambda sign: sign == 0),
        "ne": _compared(lambda sign: sign != 0),
        "not": lambda piece, values: _number(not _constant(values[0])),
        "and": lambda piece, values: _number(bool(_constant(values[0]) and _constant(values[1]))),
        "or": lambda piece, values: _number(bool(_constant(values[0]) or _constant(values[1]))),
        "if_else_zero": lambda piece, values: (fmpq(bool(_constant(values[0]))), 1, _ZERO),
        "floor": lambda piece, values: (_ZERO, 0, _rational(piece.whole(values[0]))),
        "ceil": lambda piece, values: (_ZERO, 0, -_rational(piece.whole(-values[0]))),
        "fmod": _modulo(_truncated),
        "remainder": _modulo(lambda piece, x, y: piece.whole(x / y + fmpq(1, 2))),
        "copysign": _copied,
    }
)
"""Affine form of each switch on a piece. atan2, which has a jump too, is not supported."""


def _sign(x: Fraction) -> int:
    return (x > 0) - (x < 0)
