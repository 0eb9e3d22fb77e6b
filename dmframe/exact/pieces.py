"""Functions of time with min, max, comparisons, floor: on which pieces they are smooth, and whether they jump between.

A derivative taken by the chain rule knows nothing of a jump. A function that switches is followed from t = 0 on: on
each piece every switch has one position, read from its argument, a polynomial of degree one there; where the next
argument vanishes, the piece ends. At every end both sides are evaluated, to 60 digits, with their switches held.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, DecimalException, localcontext
from fractions import Fraction
from typing import Final, final

import casadi as ca

from dmframe.exact.digits import CALL, CONTEXT, FUNCTIONS, UndefinedHere, decimal_of
from dmframe.exact.tape import Tape

INSTANTS: Final = 200
"""Switching instants that are followed; a function that switches for ever is left there."""

CONTINUOUS: Final = Decimal("1e-13")
"""What rounded literals, such as sin(1) in the code, may leave of a step that is none, relative to the function."""

COMPARISONS: Final = frozenset((ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE))
JUMPS: Final = COMPARISONS | {
    ca.OP_SIGN,
    ca.OP_FLOOR,
    ca.OP_CEIL,
    ca.OP_FMOD,
    ca.OP_REMAINDER,
    ca.OP_COPYSIGN,
    ca.OP_IF_ELSE_ZERO,
    ca.OP_NOT,
    ca.OP_AND,
    ca.OP_OR,
    ca.OP_ATAN2,
}
"""Operations whose value can jump."""

KINKS: Final = frozenset((ca.OP_FABS, ca.OP_FMIN, ca.OP_FMAX))
"""Operations whose slope can jump."""

EDGES: Final = frozenset(
    (
        ca.OP_SQRT,
        ca.OP_POW,
        ca.OP_CONSTPOW,
        ca.OP_LOG,
        ca.OP_LOG1P,
        ca.OP_ASIN,
        ca.OP_ACOS,
        ca.OP_ACOSH,
        ca.OP_ATANH,
        ca.OP_ERFINV,
        ca.OP_HYPOT,
        ca.OP_TAN,
    )
)
"""Functions that end, or have no slope, somewhere."""

NAMES: Final = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")} | {
    ca.OP_IF_ELSE_ZERO: "if_else",
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
}
"""Of operations, as a block's author writes them."""

Polynomial = tuple[Fraction, ...]
"""Coefficients, the constant first."""


class NotFollowed(ArithmeticError):
    """A switch whose argument is no polynomial of degree one in time."""


@final
@dataclass(frozen=True)
class Jump:
    """One element of a function before and after an instant."""

    time: Fraction
    element: int
    before: Decimal
    after: Decimal


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


def operation(code: int, called: int) -> int:
    """CasADi's code of a tape's node."""
    return called if code == CALL else code


def moving_operations(tape: Tape, moving: Sequence[bool]) -> Iterator[tuple[int, int]]:
    """(position, operation) of each node that depends on a moving input; `moving` says it of each input's element."""
    moves = list[bool]()
    for k, (code, a, _b, _, _) in enumerate(tape.nodes):
        if code == ca.OP_INPUT:
            moves.append(moving[a])
        else:
            moves.append(any(moves[argument] for argument in arguments_of(tape, k)))
        if moves[-1]:
            yield k, operation(code, a)


TWO_ARGUMENTS: Final = frozenset((ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV))


def arguments_of(tape: Tape, k: int) -> tuple[int, ...]:
    """The positions that a node reads."""
    code, a, b, arguments, _ = tape.nodes[k]
    if code in (ca.OP_CONST, ca.OP_INPUT):
        return ()
    if code == CALL:
        return arguments
    return (a, b) if code in TWO_ARGUMENTS else (a,)


def follow(tape: Tape, parameters: Sequence[Fraction]) -> Course:
    """The course of a function of (t, parameters) from t = 0 on.

    Raises `NotFollowed` for a switch that cannot be followed, `UndefinedHere` where the function has no value.
    """
    instants, edged = list[Fraction](), False
    begin, before = Fraction(0), None
    moving = {k for k, _ in moving_operations(tape, [True, *(False for _ in parameters)])}
    while True:
        piece = _Piece(tape, parameters, begin, moving)
        edged = edged or piece.edged
        if before is not None:
            for element, (left, right) in enumerate(zip(before.at(begin), piece.at(begin), strict=True)):
                if abs(left - right) > CONTINUOUS * (1 + abs(left) + abs(right)):
                    return Course(tuple(instants), Jump(begin, element, left, right), begin, edged)
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
        self._held = dict[int, tuple[Fraction, int, Fraction]]()
        self._values = list[Polynomial | None]()
        for k in range(len(tape)):
            self._values.append(self._value(k))
            self.edged = self.edged or (self._values[-1] is None and k in moving and self._has_edge(k))

    def at(self, time: Fraction) -> list[Decimal]:
        """The outputs' stored elements with all switches as on this piece: at its end, the limit from the left."""
        values = list[Decimal]()
        with localcontext(CONTEXT):
            flat = [decimal_of(time), *map(decimal_of, self._parameters)]
            try:
                for k, (code, a, b, _, constant) in enumerate(self._tape.nodes):
                    if k in self._held:
                        scale, node, offset = self._held[k]
                        values.append(decimal_of(scale) * values[node] + decimal_of(offset))
                    elif code == ca.OP_INPUT:
                        values.append(flat[a])
                    elif code == ca.OP_CONST:
                        values.append(decimal_of(constant))
                    elif code == ca.OP_POW:
                        values.append(values[a] ** b)
                    else:
                        arguments = [values[argument] for argument in arguments_of(self._tape, k)]
                        values.append(FUNCTIONS[operation(code, a)](*arguments))
            except (DecimalException, KeyError, ValueError) as error:
                raise UndefinedHere(str(error)) from None
        return [values[source] for output in self._tape.outputs for source in output.sources]

    def _has_edge(self, k: int) -> bool:
        """Is this a divisor that moves on the piece, or a function that ends somewhere?"""
        code, a, b, _, _ = self._tape.nodes[k]
        if code in (ca.OP_DIV, ca.OP_INV) or (code == ca.OP_POW and b < 0):
            divisor = self._values[arguments_of(self._tape, k)[-1]]
            return divisor is None or len(_trimmed(divisor)) != 1
        return operation(code, a) in EDGES | {ca.OP_ATAN2} and code == CALL

    def _value(self, k: int) -> Polynomial | None:
        """The polynomial in time that a node is on this piece, if it is one."""
        code, a, b, _, constant = self._tape.nodes[k]
        if code == ca.OP_INPUT:
            return (Fraction(0), Fraction(1)) if a == 0 else (self._parameters[a - 1],)
        if code == ca.OP_CONST:
            return (constant,)
        places = arguments_of(self._tape, k)
        values = [self._values[place] for place in places]
        called = operation(code, a)
        if called in SWITCHES:
            deciding = values[:1] if called == ca.OP_IF_ELSE_ZERO else values
            if any(value is None for value in deciding):
                raise NotFollowed(f"{NAMES[called]} of a function that is no polynomial in time")
            scale, place, offset = SWITCHES[called](self, [value for value in deciding if value is not None])
            self._held[k] = scale, places[place], offset
            chosen = values[place] if scale else ()
            return None if chosen is None else _plus(_times(chosen, (scale,)), (offset,))
        if code == CALL or any(value is None for value in values):
            return None
        return _field(code, b, [value for value in values if value is not None])

    def sign(self, x: Polynomial) -> int:
        """The sign of a polynomial right after the piece begins; the piece ends where it changes."""
        value, slope = self._line(x)
        if slope and value * slope < 0:
            self._ends(self._begin - value / slope)
        return _sign(value) or _sign(slope)

    def whole(self, x: Polynomial) -> Fraction:
        """The floor of a polynomial right after the piece begins; the piece ends where it changes."""
        value, slope = self._line(x)
        floor = Fraction(value.__floor__())
        if slope > 0:
            self._ends(self._begin + (floor + 1 - value) / slope)
        elif slope < 0:
            floor = floor - 1 if floor == value else floor
            self._ends(self._begin + (floor - value) / slope)
        return floor

    def _line(self, x: Polynomial) -> tuple[Fraction, Fraction]:
        """Value and slope where the piece begins."""
        trimmed = _trimmed(x)
        if len(trimmed) > 2:
            raise NotFollowed(f"a switch at the roots of a polynomial of degree {len(trimmed) - 1} in time")
        constant, slope = (*trimmed, Fraction(0), Fraction(0))[:2]
        return constant + slope * self._begin, slope

    def _ends(self, time: Fraction) -> None:
        if time > self._begin and (self.end is None or time < self.end):
            self.end = time


Held = tuple[Fraction, int, Fraction]
"""What a switch is on a piece: so many times one of its arguments, plus a number."""

_ZERO, _ONE = Fraction(0), Fraction(1)


def _number(value: bool) -> Held:
    return _ZERO, 0, Fraction(int(value))


def _constant(x: Polynomial) -> Fraction:
    trimmed = _trimmed(x)
    if len(trimmed) > 1:
        raise NotFollowed("a condition or a period that is no constant between switching instants")
    return trimmed[0] if trimmed else _ZERO


def _truncated(piece: _Piece, x: Polynomial, period: Fraction) -> Fraction:
    turns = _times(x, (1 / period,))
    return piece.whole(turns) if piece.sign(turns) >= 0 else -piece.whole(_times(turns, (-_ONE,)))


def _modulo(count: Callable[[_Piece, Polynomial, Fraction], Fraction]) -> Callable[[_Piece, list[Polynomial]], Held]:
    def held(piece: _Piece, values: list[Polynomial]) -> Held:
        period = _constant(values[1])
        if not period:
            raise UndefinedHere("a period of zero")
        return _ONE, 0, -period * count(piece, values[0], period)

    return held


def _compared(true: Callable[[int], bool]) -> Callable[[_Piece, list[Polynomial]], Held]:
    return lambda piece, values: _number(true(piece.sign(_minus(*values))))


def _chosen(lower: bool) -> Callable[[_Piece, list[Polynomial]], Held]:
    return lambda piece, values: (_ONE, int((piece.sign(_minus(*values)) > 0) is lower), _ZERO)


def _copied(piece: _Piece, values: list[Polynomial]) -> Held:
    return Fraction((piece.sign(values[0]) or 1) * (piece.sign(values[1]) or 1)), 0, _ZERO


SWITCHES: Final[Mapping[int, Callable[[_Piece, list[Polynomial]], Held]]] = {
    ca.OP_SIGN: lambda piece, values: (_ZERO, 0, Fraction(piece.sign(values[0]))),
    ca.OP_FABS: lambda piece, values: (Fraction(piece.sign(values[0])), 0, _ZERO),
    ca.OP_FMIN: _chosen(lower=True),
    ca.OP_FMAX: _chosen(lower=False),
    ca.OP_LT: _compared(lambda sign: sign < 0),
    ca.OP_LE: _compared(lambda sign: sign <= 0),
    ca.OP_EQ: _compared(lambda sign: sign == 0),
    ca.OP_NE: _compared(lambda sign: sign != 0),
    ca.OP_NOT: lambda piece, values: _number(not _constant(values[0])),
    ca.OP_AND: lambda piece, values: _number(bool(_constant(values[0]) and _constant(values[1]))),
    ca.OP_OR: lambda piece, values: _number(bool(_constant(values[0]) or _constant(values[1]))),
    ca.OP_IF_ELSE_ZERO: lambda piece, values: (Fraction(int(bool(_constant(values[0])))), 1, _ZERO),
    ca.OP_FLOOR: lambda piece, values: (_ZERO, 0, piece.whole(values[0])),
    ca.OP_CEIL: lambda piece, values: (_ZERO, 0, -piece.whole(_times(values[0], (-_ONE,)))),
    ca.OP_FMOD: _modulo(_truncated),
    ca.OP_REMAINDER: _modulo(lambda piece, x, y: piece.whole(_plus(_times(x, (1 / y,)), (Fraction(1, 2),)))),
    ca.OP_COPYSIGN: _copied,
}
"""How each switch is held on a piece. atan2, which jumps too, is not followed."""


def _field(code: int, exponent: int, values: list[Polynomial]) -> Polynomial | None:
    first, last = values[0], values[-1]
    match code:
        case ca.OP_ADD:
            return _plus(first, last)
        case ca.OP_SUB:
            return _minus(first, last)
        case ca.OP_MUL:
            return _times(first, last)
        case ca.OP_SQ:
            return _times(first, first)
        case ca.OP_NEG:
            return _times(first, (-_ONE,))
        case ca.OP_TWICE:
            return _times(first, (Fraction(2),))
        case ca.OP_DIV | ca.OP_INV:
            divisor = _trimmed(last)
            if len(divisor) != 1:
                return None
            return _times(first if code == ca.OP_DIV else (_ONE,), (1 / divisor[0],))
        case ca.OP_POW if 0 <= exponent <= 16:
            power: Polynomial = (_ONE,)
            for _ in range(exponent):
                power = _times(power, first)
            return power
    return None


def _plus(x: Polynomial, y: Polynomial) -> Polynomial:
    size = max(len(x), len(y))
    return tuple((x[k] if k < len(x) else _ZERO) + (y[k] if k < len(y) else _ZERO) for k in range(size))


def _minus(x: Polynomial, y: Polynomial) -> Polynomial:
    return _plus(x, _times(y, (-_ONE,)))


def _times(x: Polynomial, y: Polynomial) -> Polynomial:
    product = [_ZERO] * max(0, len(x) + len(y) - 1)
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            product[i + j] += a * b
    return tuple(product)


def _trimmed(x: Polynomial) -> Polynomial:
    size = len(x)
    while size and not x[size - 1]:
        size -= 1
    return x[:size]


def _sign(x: Fraction) -> int:
    return (x > 0) - (x < 0)
