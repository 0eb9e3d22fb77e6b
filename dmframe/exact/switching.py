"""Enclosures of functions with switches: an undecided comparison over an interval has both values.

The rules extend those of `dmframe.exact.enclosure`. On an interval with a possible jump the derivative gives no bound,
so `over_pieces` reports these intervals and evaluates the function there for each combination of switch positions. A
function that is continuous at its switches then has a narrow range over a narrow interval.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from flint import arb
from numpy.typing import NDArray

from dmframe.exact.balls import above, below, precise
from dmframe.exact.enclosure import RULES, Enclosing, Enclosure, down, up
from dmframe.program import COMPARISONS, JUMPS, Node, by_code

_LARGEST_POWER: Final = 64
_MOST_SWITCHES: Final = 4


def _truth(yes: Any, no: Any) -> Enclosure:
    """One if true, zero if false, the interval of both if undecided."""
    return Enclosure(np.where(yes, 1.0, 0.0), np.where(no, 0.0, 1.0))


def _less(a: Enclosure, b: Enclosure) -> Enclosure:
    return _truth(a.upper < b.lower, a.lower >= b.upper)


def _at_most(a: Enclosure, b: Enclosure) -> Enclosure:
    return _truth(a.upper <= b.lower, a.lower > b.upper)


def _equal(a: Enclosure, b: Enclosure) -> Enclosure:
    same = (a.lower == a.upper) & (b.lower == b.upper) & (a.lower == b.lower)
    return _truth(same, (a.upper < b.lower) | (b.upper < a.lower))


def _nonzero(a: Enclosure) -> Enclosure:
    """Whether a number is nonzero."""
    return _truth((a.lower > 0) | (a.upper < 0), (a.lower == 0) & (a.upper == 0))


def _not(a: Enclosure) -> Enclosure:
    found = _nonzero(a)
    return Enclosure(1 - found.upper, 1 - found.lower)


def _both(a: Enclosure, b: Enclosure) -> Enclosure:
    return _least(_nonzero(a), _nonzero(b))


def _either(a: Enclosure, b: Enclosure) -> Enclosure:
    return _greatest(_nonzero(a), _nonzero(b))


def _where(condition: Enclosure, x: Enclosure) -> Enclosure:
    """X, zero, or the interval between them."""
    found = _nonzero(condition)
    yes, no = found.lower == 1, found.upper == 0
    lower = np.where(yes, x.lower, np.where(no, 0.0, np.minimum(x.lower, 0.0)))
    return Enclosure(lower, np.where(yes, x.upper, np.where(no, 0.0, np.maximum(x.upper, 0.0))))


def _least(a: Enclosure, b: Enclosure) -> Enclosure:
    return Enclosure(np.minimum(a.lower, b.lower), np.minimum(a.upper, b.upper))


def _greatest(a: Enclosure, b: Enclosure) -> Enclosure:
    return Enclosure(np.maximum(a.lower, b.lower), np.maximum(a.upper, b.upper))


def _absolute(a: Enclosure) -> Enclosure:
    through = (a.lower <= 0) & (a.upper >= 0)
    return Enclosure(np.where(through, 0.0, np.minimum(np.abs(a.lower), np.abs(a.upper))), a.magnitude)


def _sign(a: Enclosure) -> Enclosure:
    lower = np.where(a.lower > 0, 1.0, np.where(a.lower == 0, 0.0, -1.0))
    return Enclosure(lower, np.where(a.upper < 0, -1.0, np.where(a.upper == 0, 0.0, 1.0)))


def _floor(a: Enclosure) -> Enclosure:
    return Enclosure(np.floor(a.lower), np.floor(a.upper))


def _ceil(a: Enclosure) -> Enclosure:
    return Enclosure(np.ceil(a.lower), np.ceil(a.upper))


def _modulo(a: Enclosure, b: Enclosure, whole: Callable[[Any], Any], most: Enclosure) -> Enclosure:
    """A - b k for the quotient k rounded to an integer, if k is the same over the interval; otherwise `most`."""
    quotient = a / b
    k = whole(quotient.lower)
    sure = np.isfinite(k) & (k == whole(quotient.upper))
    found = a - b * Enclosure.of(np.where(sure, k, 0.0))
    return Enclosure(np.where(sure, found.lower, most.lower), np.where(sure, found.upper, most.upper))


def _fmod(a: Enclosure, b: Enclosure) -> Enclosure:
    size = b.magnitude
    most = Enclosure(np.where(a.lower >= 0, 0.0, -size), np.where(a.upper <= 0, 0.0, size))
    return _modulo(a, b, np.trunc, most)


def _remainder(a: Enclosure, b: Enclosure) -> Enclosure:
    half = up(b.magnitude / 2)
    return _modulo(a, b, np.rint, Enclosure(-half, half))


def _root(a: Enclosure) -> Enclosure:
    """Square root, correctly rounded by IEEE 754; NaN if the operand may be negative."""
    with np.errstate(invalid="ignore"):
        return Enclosure(np.maximum(down(np.sqrt(a.lower)), 0.0), up(np.sqrt(a.upper)))


def _power(a: Enclosure, b: Enclosure) -> Any:
    """Integer powers and the square root; no other powers."""
    if b.lower.ndim or b.lower != b.upper:
        return NotImplemented
    k = float(b.lower)
    if k == 0.5:
        return _root(a)
    if k != int(k) or abs(k) > _LARGEST_POWER:
        return NotImplemented
    if k < 0:
        return 1 / _power(a, -b)
    found = a.square() if k >= 2 else Enclosure.of(1.0)
    for _ in range(int(k) // 2 - 1):
        found = found * a.square()
    return found * a if int(k) % 2 else found


def _rising(rule: Callable[[arb], arb]) -> Callable[[Enclosure], Enclosure]:
    """Enclosure of an increasing function from the ends of the interval, each in ball arithmetic."""

    @precise()
    def ends(x: float) -> tuple[float, float]:
        found = rule(arb(x))
        return below(found), above(found)

    both: Any = np.vectorize(ends, otypes=[float, float])
    return lambda a: Enclosure(both(a.lower)[0], both(a.upper)[1])


SWITCHING: Final = RULES | by_code(
    {
        "lt": _less,
        "le": _at_most,
        "eq": _equal,
        "ne": lambda a, b: _not(_equal(a, b)),
        "not": _not,
        "and": _both,
        "or": _either,
        "if_else_zero": _where,
        "fmin": _least,
        "fmax": _greatest,
        "fabs": _absolute,
        "sign": _sign,
        "floor": _floor,
        "ceil": _ceil,
        "fmod": _fmod,
        "remainder": _remainder,
        "sqrt": _root,
        "pow": _power,
        "constpow": _power,
        "exp": _rising(arb.exp),
        "tanh": _rising(arb.tanh),
    }
)
"""Rules of enclosures, including those of operations with switches."""

_CHOICES: Final = by_code({"if_else_zero": None})
"""It jumps where its condition does, and the condition is a node of its own."""
_REMAINDERS: Final = by_code({"fmod": np.trunc, "remainder": np.rint})
_STEPS: Final = by_code({"floor": None, "ceil": None})
_SIGNS: Final = by_code({"sign": None})


def over_pieces(
    f: Enclosing, inputs: Sequence[Sequence[Any]], shape: tuple[int, ...]
) -> tuple[list[Enclosure], NDArray[np.bool_]]:
    """Elements of a function's first output, and a flag for each interval on which the function may jump."""
    values = f.values(inputs)
    jumps, positions = np.zeros(shape, dtype=bool), dict[int, list[Enclosure]]()
    for place, (node, value) in enumerate(zip(f.program.nodes, values, strict=True)):
        if node.code in _REMAINDERS:
            value = _quotient(node, values)  # a remainder jumps where its quotient does
        if node.code in JUMPS and node.code not in _CHOICES and not np.all(value.lower == value.upper):
            jumps |= ~(value.lower == value.upper)
            if node.code in COMPARISONS or node.code in _SIGNS:
                positions[place] = [Enclosure.of(k) for k in (0.0, 1.0, -1.0)[: 2 + (node.code in _SIGNS)]]
            elif node.code in (*_STEPS, *_REMAINDERS) and np.all(value.upper - value.lower <= 1):
                positions[place] = [Enclosure.of(value.lower), Enclosure.of(value.upper)]
    (found,) = f.program.stored(values)
    if not positions or len(positions) > _MOST_SWITCHES:
        return found, jumps
    outcomes = [
        _with_switches(f, inputs, dict(zip(positions, chosen, strict=True))) for chosen in product(*positions.values())
    ]
    return [_hull(elements) for elements in zip(*outcomes, strict=True)], jumps


def _quotient(node: Node, values: Sequence[Enclosure]) -> Enclosure:
    """The integer quotient of a remainder operation."""
    quotient, whole = values[node.a] / values[node.b], _REMAINDERS[node.code]
    return Enclosure(whole(quotient.lower), whole(quotient.upper))


def _with_switches(f: Enclosing, inputs: Sequence[Sequence[Any]], chosen: Mapping[int, Enclosure]) -> list[Enclosure]:
    """The first output with the given switch positions."""
    seen = list[Enclosure]()

    def keep(node: Node, value: Enclosure) -> Enclosure:
        position = chosen.get(len(seen))
        if position is not None:
            value = seen[node.a] - seen[node.b] * position if node.code in _REMAINDERS else position
        seen.append(value)
        return value

    return f.program.stored(f.values(inputs, keep))[0]


def _hull(parts: Sequence[Enclosure]) -> Enclosure:
    total = parts[0]
    for part in parts[1:]:
        total = Enclosure(np.minimum(total.lower, part.lower), np.maximum(total.upper, part.upper))
    return total


__all__ = ["SWITCHING", "over_pieces"]
