"""Functions of time with min, max, comparisons, floor: on which pieces they are smooth, and whether they jump between.

A derivative taken by the chain rule knows nothing of a jump. A function that switches is followed from t = 0 on: on
each piece every switch has one position, read from its argument, a polynomial of degree one there; where the next
argument vanishes, the piece ends. At every end both sides are evaluated in ball arithmetic, with their switches held.
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
"""Switching instants that are followed; a function that switches for ever is left there."""

CONTINUOUS: Final = 1e-13
"""What rounded literals, such as sin(1) in the code, may leave of a step that is none, relative to the function."""

LARGEST_POWER: Final = 16
"""Of a polynomial, that is written out."""

_TIME: Final = fmpq_poly([0, 1])


class NotFollowed(ArithmeticError):
    """A switch whose argument is no polynomial of degree one in time."""


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
    """What following a function gave: its switching instants, its first jump, and `until` when it was followed.

    `until` is None for a function that was followed for ever. `edged`: it holds a moving divisor, a root or the like,
    at whose edge it can jump unseen.
    """

    instants: tuple[Fraction, ...]
    jump: Jump | None
    until: Fraction | None
    edged: bool = False


def moving_operations(tape: Tape, moving: Sequence[Sequence[bool]]) -> Iterator[tuple[int, int]]:
    """(place, code) of what depends on a moving input; `moving` says it of each element of each input.

    The code of a whole power is that of `pow`.
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
    """The course of a function of (t, parameters) from t = 0 on.

    Raises `NotFollowed` for a switch that cannot be followed, `UndecidedError` where the function may have no value.
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
    """A function from `begin` to where it next switches, with every switch held in its position."""

    def __init__(self, tape: Tape, parameters: Sequence[Fraction], begin: Fraction, moving: Container[int]) -> None:
        self._tape, self._parameters, self._begin = tape, parameters, begin
        self.end: Fraction | None = None
        self.edged = False
        self._held = dict[int, Held]()
        self._inputs = self._given(_TIME, list(map(_polynomial, parameters)))
        self._values = list[fmpq_poly | None]()
        for k in range(len(tape)):
            self._values.append(self._value(k))
            self.edged = self.edged or (self._values[-1] is None and k in moving and self._has_edge(k))

    def at(self, time: Fraction) -> list[arb]:
        """The outputs' stored elements with all switches as on this piece: at its end, the limit from the left."""

        def held(k: int, values: Sequence[arb]) -> arb | None:
            polynomial = self._values[k]
            if polynomial is not None:
                return arb(polynomial(_rational(time)))
            if k in self._held:
                scale, place, offset = self._held[k]
                return arb(scale) * values[place] + arb(offset)
            return None

        program = self._tape.program
        given = self._given(ball(time), [ball(value) for value in self._parameters])
        found = program.stored(enclosed(program, given, held=held))
        return [value for output in found for value in output]

    def _has_edge(self, k: int) -> bool:
        """True for a divisor that moves on the piece, and for a function that ends somewhere."""
        node, exponent = self._tape.nodes[k], self._tape.exponent(k)
        if exponent is None and node.code not in DIVISIONS:
            return node.code in EDGES or node.code == ca.OP_ATAN2
        divisor = self._values[node.b if exponent is None else node.a]
        return (exponent is None or exponent < 0) and (divisor is None or divisor.degree() != 0)

    def _value(self, k: int) -> fmpq_poly | None:
        """The polynomial in time that a node is on this piece, if it is one."""
        node = self._tape.nodes[k]
        if node.code == INPUT:
            return self._inputs[node.a][node.b]
        if node.code == CONST:
            return _polynomial(self._tape.numbers[node.constant])
        values = [self._values[operand] for operand in node.operands]
        if node.code in SWITCHES:
            deciding = values[:1] if node.code == ca.OP_IF_ELSE_ZERO else values
            if any(value is None for value in deciding):
                raise NotFollowed(f"{sign_of(node.code)} of a function that is no polynomial in time")
            scale, chosen, offset = SWITCHES[node.code](self, [value for value in deciding if value is not None])
            self._held[k] = scale, node.operands[chosen], offset
            held = values[chosen] if scale else fmpq_poly([])
            return None if held is None else scale * held + offset
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
        """The sign of a polynomial right after the piece begins; the piece ends where it changes."""
        value, slope = self._line(x)
        if slope and value * slope < 0:
            self._ends(self._begin - value / slope)
        return _sign(value) or _sign(slope)

    def whole(self, x: fmpq_poly) -> Fraction:
        """The floor of a polynomial right after the piece begins; the piece ends where it changes."""
        value, slope = self._line(x)
        floor = Fraction(value.__floor__())
        if slope > 0:
            self._ends(self._begin + (floor + 1 - value) / slope)
        elif slope < 0:
            floor = floor - 1 if floor == value else floor
            self._ends(self._begin + (floor - value) / slope)
        return floor

    def _line(self, x: fmpq_poly) -> tuple[Fraction, Fraction]:
        """Value and slope where the piece begins."""
        if x.degree() > 1:
            raise NotFollowed(f"a switch at the roots of a polynomial of degree {x.degree()} in time")
        return _fraction(x(_rational(self._begin))), _fraction(x[1])

    def _ends(self, time: Fraction) -> None:
        if time > self._begin and (self.end is None or time < self.end):
            self.end = time


Held = tuple[fmpq, int, fmpq]
"""What a switch is on a piece: so many times one of its arguments, plus a number."""

_ZERO, _ONE = fmpq(0), fmpq(1)


def _rational(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def _polynomial(x: Fraction) -> fmpq_poly:
    return fmpq_poly([_rational(x)])


def _fraction(x: fmpq) -> Fraction:
    return Fraction(int(x.p), int(x.q))


def _number(value: bool) -> Held:
    return _ZERO, 0, fmpq(value)


def _constant(x: fmpq_poly) -> fmpq:
    if x.degree() > 0:
        raise NotFollowed("a condition or a period that is no constant between switching instants")
    return x[0]


def _truncated(piece: _Piece, x: fmpq_poly, period: fmpq) -> Fraction:
    turns = x / period
    return piece.whole(turns) if piece.sign(turns) >= 0 else -piece.whole(-turns)


def _modulo(count: Callable[[_Piece, fmpq_poly, fmpq], Fraction]) -> Callable[[_Piece, list[fmpq_poly]], Held]:
    def held(piece: _Piece, values: list[fmpq_poly]) -> Held:
        period = _constant(values[1])
        if not period:
            raise UndecidedError("a period of zero")
        return _ONE, 0, -period * _rational(count(piece, values[0], period))

    return held


def _compared(true: Callable[[int], bool]) -> Callable[[_Piece, list[fmpq_poly]], Held]:
    return lambda piece, values: _number(true(piece.sign(values[0] - values[1])))


def _chosen(lower: bool) -> Callable[[_Piece, list[fmpq_poly]], Held]:
    return lambda piece, values: (_ONE, int((piece.sign(values[0] - values[1]) > 0) is lower), _ZERO)


def _copied(piece: _Piece, values: list[fmpq_poly]) -> Held:
    return fmpq((piece.sign(values[0]) or 1) * (piece.sign(values[1]) or 1)), 0, _ZERO


SWITCHES: Final[Mapping[int, Callable[[_Piece, list[fmpq_poly]], Held]]] = by_code(
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
"""How each switch is held on a piece. atan2, which jumps too, is not followed."""


def _sign(x: Fraction) -> int:
    return (x > 0) - (x < 0)
