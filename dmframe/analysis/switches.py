r"""Active pieces of switching functions at an equilibrium: comparisons, signs, rounding, remainders, saturation.

Inside a piece a switching function is smooth, and a guard (a positive number) certifies the piece. On an edge it has no
derivative, so a linearisation is not valid nearby. The floating-point linearisation and the interval proof both use
these pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.minimum_cut import LEAST, SMALL
from dmframe.block.certificate import SX
from dmframe.exact.balls import UndecidedError
from dmframe.program import (
    COMPARISONS,
    CONST,
    INPUT,
    JUMPS,
    KINKS,
    OPERATIONS,
    Node,
    Program,
    by_code,
    read,
    run,
    sign_of,
)

Array = NDArray[np.float64]

APPLY: Final[Mapping[int, Any]] = {
    code: (lambda a, b, code=code: ca.SX.binary(code, a, b))
    if row.arity == 2
    else (lambda a, code=code: ca.SX.unary(code, a))
    for code, row in OPERATIONS.items()
}
"""CasADi operation by code, for expressions."""

_JUMP: Final = 1e-9
"""Change of an output, relative to 1 + its size, that counts as a jump."""

_TRUTHS: Final = COMPARISONS | by_code({"not": 0, "and": 0, "or": 0}).keys()
_NAMES: Final = by_code({row.name: row.name for row in OPERATIONS.values()})


def unknown(code: int) -> Exception:
    """Exception for an unknown operation."""
    return UndecidedError(f"CasADi's instruction {code} is not supported")


def values_of(program: Program, symbols: Sequence[SX], keep: Callable[[Node, SX], SX] | None = None) -> list[SX]:
    """Values of all nodes as expressions; `keep` may replace each before others use it."""
    return run(
        program,
        APPLY,
        given=lambda argument, element: symbols[argument].nz[element],
        constant=ca.SX,
        refuse=unknown,
        keep=keep,
    )


def numbers_of(program: Program, symbols: Sequence[SX], at: Sequence[Any]) -> Array:
    """Values of all nodes at a point, in floating point."""
    values = values_of(program, symbols)
    return np.asarray(ca.Function("nodes", list(symbols), [ca.vertcat(*values)])(*at).full()).ravel()


def chosen(program: Program, symbols: Sequence[SX], numbers: Array) -> tuple[SX, SX]:
    """Outputs with every decided switch replaced by its active piece; and the guards of these pieces.

    Parameters
    ----------
    numbers
        Values of all nodes at the point, from `numbers_of`.
    """
    values, guards = list[SX](), list[SX]()
    for node, number in zip(program.nodes, numbers, strict=True):
        code, a, b, constant, _ = node
        if code == INPUT:
            value = symbols[a].nz[b]
        elif code == CONST:
            value = ca.SX(constant)
        else:
            value = _active_piece(node, number, values, numbers, guards)
        values.append(value)
    (found,) = program.stored(values)
    used = [guard for guard in guards if not guard.is_constant()]
    return ca.vertcat(*found), ca.densify(ca.vertcat(ca.SX(0, 1), *used))


def _active_piece(node: Node, number: float, values: Sequence[SX], numbers: Array, guards: list[SX]) -> SX:
    """Value of an operation, of a switch its active piece; its guards are appended."""
    code, a, b = node.code, node.a, node.b
    name = _NAMES.get(code)
    if name is None:
        raise unknown(code)
    x, y, first, last = values[a], values[b], float(numbers[a]), float(numbers[b])
    plain = APPLY[code](x, y) if OPERATIONS[code].arity == 2 else APPLY[code](x)
    if plain.is_constant():
        return plain
    if code in COMPARISONS and distinct(first, last):
        guards.append(x - y if first > last else y - x)
        return ca.SX(float(number))
    if name in ("fmin", "fmax") and distinct(first, last):
        (low, high) = (x, y) if first < last else (y, x)
        guards.append(high - low)
        return low if name == "fmin" else high
    side, other = (1.0 if of > 0 else -1.0 for of in (first, last))
    if name in ("sign", "fabs") and distinct(first, 0.0):
        guards.append(side * x)
        return ca.SX(side) if name == "sign" else side * x
    if name == "copysign" and distinct(last, 0.0):
        guards.append(other * y)
        if not distinct(first, 0.0):
            return other * APPLY[ca.OP_FABS](x)
        guards.append(side * x)
        return other * side * x
    if name in ("floor", "ceil", "fmod", "remainder"):
        return _step(name, x, y, first, last, guards, plain)
    if name in ("and", "or") and (x.is_constant() or y.is_constant()):
        fixed, other = (x, y) if x.is_constant() else (y, x)
        return fixed if (float(fixed) == 0) == (name == "and") else APPLY[ca.OP_NOT](APPLY[ca.OP_NOT](other))
    if name == "if_else_zero" and x.is_constant():
        return y if float(x) else ca.SX(0)
    return plain


def _step(name: str, x: SX, y: SX, first: float, last: float, guards: list[SX], plain: SX) -> SX:
    """Rounding or remainder within its step; unchanged on an edge."""
    rest = name in ("fmod", "remainder")
    if rest and not distinct(last, 0.0):
        return plain
    at, of = (first / last, x / y) if rest else (first, x)
    shift = 0.5 if name == "remainder" else 0.0
    k = float({"floor": np.floor, "ceil": np.ceil, "fmod": np.trunc}.get(name, np.rint)(at))
    # numbers with that k: for ceil those up to it, for the quotient 0 those on both sides
    low = k - 1 if name == "ceil" or (name == "fmod" and k <= 0) else k - shift
    high = k if name == "ceil" or (name == "fmod" and k < 0) else k + 1 - shift
    if not (distinct(at, low) and distinct(at, high)):
        return plain
    guards.extend((of - low, high - of))
    if rest:
        guards.append(y if last > 0 else -y)
        return x - k * y
    return ca.SX(k)


def distinct(a: float, b: float) -> bool:
    """True if two numbers differ by more than the point's error, so that comparisons have the same result nearby."""
    return abs(a - b) > SMALL * max(abs(a), abs(b)) + LEAST


def turning(expression: SX, symbols: Sequence[SX], at: Sequence[Any]) -> tuple[list[str], list[str]]:
    """Switches of an expression that are on an edge at a point and depend on its first argument.

    First those at which the expression jumps, then those at which only its slope may jump.
    """
    pieces, numbers = read(ca.Function("switches", list(symbols), [ca.cse(ca.densify(ca.vec(expression)))])), None
    if pieces.codes & (JUMPS | KINKS):
        numbers = numbers_of(pieces, symbols, at)
        left = chosen(pieces, symbols, numbers)[0]
        pieces = read(ca.Function("switches", list(symbols), [ca.cse(left)]))
    if numbers is None or not pieces.codes & (JUMPS | KINKS):
        return [], []
    numbers, moved, both, kinks = numbers_of(pieces, symbols, at), list[bool](), dict[int, list[float]](), set[str]()
    for place, node in enumerate(pieces.nodes):
        moved.append((node.code == INPUT and node.a == 0) or any(moved[k] for k in node.operands))
        if moved[-1] and node.code in KINKS:
            kinks.add(sign_of(node.code))
        elif moved[-1] and node.code in JUMPS and (alternatives := _alternatives(place, pieces, numbers)):
            both[place] = alternatives
    jumps = _jumping(pieces, symbols, at, numbers, both)
    kinks |= {sign_of(pieces.nodes[place].code) for place in both}
    return sorted(jumps), sorted(kinks - jumps)


def _alternatives(place: int, program: Program, numbers: Array) -> list[float]:
    """Other values of a switch on its edge near the point; empty if another switch determines it."""
    node, value = program.nodes[place], float(numbers[place])
    name, first, last = _NAMES[node.code], float(numbers[node.a]), float(numbers[node.b])
    decided = all(program.nodes[k].code in _TRUTHS for k in node.operands)
    if node.code in COMPARISONS:
        return [1.0 - value]
    if name == "sign":
        return [-1.0, 1.0]
    if name in ("floor", "ceil"):
        return [value - 1, value + 1]
    if name in ("fmod", "remainder"):
        return [value - last, value + last]
    if name == "copysign":
        return [-value]
    if name == "atan2":
        return [-value] if last < 0 and not distinct(first, 0.0) else []
    if name == "if_else_zero":
        condition = program.nodes[node.a].code in _TRUTHS or distinct(first, 0.0)
        return [] if condition else [0.0, last]
    return [] if decided else [1.0 - value]


def _jumping(
    program: Program, symbols: Sequence[SX], at: Sequence[Any], numbers: Array, both: Mapping[int, Sequence[float]]
) -> set[str]:
    """Names of switches whose other possible values change the outputs."""
    if not both:
        return set()
    order, places = {place: k for k, place in enumerate(both)}, iter(range(len(program.nodes)))
    free = ca.SX.sym("free", len(both))

    def keep(_: Node, value: SX) -> SX:
        k = order.get(next(places))
        return value if k is None else free[k]

    (found,) = program.stored(values_of(program, symbols, keep))
    outputs = ca.Function("outputs", [*symbols, free], [ca.vertcat(*found)])
    own = numbers[list(both)]
    here, jumps = outputs(*at, own).full(), set[str]()
    for place, alternatives in both.items():
        for alternative in alternatives:
            other = own.copy()
            other[order[place]] = alternative
            if np.any(np.abs(outputs(*at, other).full() - here) > _JUMP * (1 + np.abs(here))):
                jumps.add(sign_of(program.nodes[place].code))
    return jumps


__all__ = ["APPLY", "chosen", "distinct", "numbers_of", "turning", "unknown", "values_of"]
