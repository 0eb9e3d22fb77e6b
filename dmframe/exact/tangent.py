r"""Directional derivatives of a program's outputs, in the ring in which the program is evaluated.

With :math:`v_k` the value of instruction k and :math:`t_k` its derivative along a direction of the inputs,

.. math:: t_k = \frac{\partial v_k}{\partial v_a} t_a + \frac{\partial v_k}{\partial v_b} t_b.

The ring evaluates functions in partial derivatives, such as cos in that of sin, so that their values agree with those
of the same functions in the program. Discontinuous operations have a zero derivative; jumps must be excluded
beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from fractions import Fraction
from typing import Any, Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.literal import literal
from dmframe.exact.ring import Ring
from dmframe.exact.tape import Tape
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, POWERS


def _power(ring: Any, v: Any, a: Any, b: Any) -> tuple[Any, Any]:
    return b * ring.call("pow", a, b - 1), ring.call("log", a) * v


def _root(ring: Any, square: Any) -> Any:
    """The inverse of a square root."""
    return ring.inverse(ring.call("sqrt", square))


def _larger(name: str) -> Callable[[Any, Any, Any, Any], tuple[Any, Any]]:
    """Partial derivatives of fmin or fmax; for equal arguments each is one half."""

    def partials(ring: Any, v: Any, a: Any, b: Any) -> tuple[Any, Any]:
        below, above = ring.call("le", a, b), ring.call("le", b, a)
        weight = ring.inverse(below + above)
        return (below * weight, above * weight) if name == "fmin" else (above * weight, below * weight)

    return partials


_TWO_BY_ROOT_PI: Final = literal(1.1283791670955126)
_HALF_ROOT_PI: Final = literal(0.8862269254527579)
"""Double-precision constants, as CasADi writes them."""

_FUNCTIONS: Final[Mapping[str, Callable[[Any, Any, Any, Any], tuple[Any, Any]]]] = {
    "div": lambda ring, v, a, b: (ring.inverse(b), -v * ring.inverse(b)),
    "inv": lambda ring, v, a, b: (-v * v, 0),
    "pow": _power,
    "sqrt": lambda ring, v, a, b: (ring.inverse(2 * v), 0),
    "exp": lambda ring, v, a, b: (v, 0),
    "expm1": lambda ring, v, a, b: (ring.call("exp", a), 0),
    "log": lambda ring, v, a, b: (ring.inverse(a), 0),
    "log1p": lambda ring, v, a, b: (ring.inverse(1 + a), 0),
    "sin": lambda ring, v, a, b: (ring.call("cos", a), 0),
    "cos": lambda ring, v, a, b: (-ring.call("sin", a), 0),
    "tan": lambda ring, v, a, b: (ring.power(ring.call("cos", a), -2), 0),
    "asin": lambda ring, v, a, b: (_root(ring, 1 - a * a), 0),
    "acos": lambda ring, v, a, b: (-_root(ring, 1 - a * a), 0),
    "atan": lambda ring, v, a, b: (ring.inverse(1 + a * a), 0),
    "atan2": lambda ring, v, a, b: (b * ring.inverse(a * a + b * b), -a * ring.inverse(a * a + b * b)),
    "sinh": lambda ring, v, a, b: (ring.call("cosh", a), 0),
    "cosh": lambda ring, v, a, b: (ring.call("sinh", a), 0),
    "tanh": lambda ring, v, a, b: (1 - v * v, 0),
    "asinh": lambda ring, v, a, b: (_root(ring, 1 + a * a), 0),
    "acosh": lambda ring, v, a, b: (_root(ring, a - 1) * _root(ring, a + 1), 0),
    "atanh": lambda ring, v, a, b: (ring.inverse(1 - a * a), 0),
    "erf": lambda ring, v, a, b: (ring.number(_TWO_BY_ROOT_PI) * ring.call("exp", -a * a), 0),
    "erfinv": lambda ring, v, a, b: (ring.number(_HALF_ROOT_PI) * ring.call("exp", v * v), 0),
    "copysign": lambda ring, v, a, b: (ring.call("copysign", 1, b) * ring.call("sign", a), 0),
    "hypot": lambda ring, v, a, b: (a * ring.inverse(v), b * ring.inverse(v)),
    "fabs": lambda ring, v, a, b: (ring.call("sign", a), 0),
    "fmin": _larger("fmin"),
    "fmax": _larger("fmax"),
    "fmod": lambda ring, v, a, b: (1, (v - a) * ring.inverse(b)),
    "remainder": lambda ring, v, a, b: (1, (v - a) * ring.inverse(b)),
}
"""Partial derivatives with respect to the operands a and b of an operation with the value v."""

_FLAT: Final = frozenset(
    name for name in BY_NAME if name in ("sign", "floor", "ceil", "lt", "le", "eq", "ne", "not", "and", "or")
)
"""Operations that are constant wherever they are differentiable."""

_PARTIALS: Final = {BY_NAME[name].code: partials for name, partials in _FUNCTIONS.items()}
_FLAT_CODES: Final = frozenset(BY_NAME[name].code for name in _FLAT)
_ADD, _SUB, _MUL, _NEG, _SQ, _TWICE = (BY_NAME[name].code for name in ("add", "sub", "mul", "neg", "sq", "twice"))
_IF: Final = BY_NAME["if_else_zero"].code


def between(tape: Tape, moving: Collection[int], outputs: Collection[int]) -> tuple[int, ...]:
    """Positions of the instructions that depend on these inputs and on which these outputs depend, in order."""
    nodes, inputs, moved = tape.nodes, frozenset(moving), set[int]()
    for place, (code, a, b, _, _) in enumerate(nodes):
        if a in inputs if code == INPUT else code in OPERATIONS and (a in moved or b in moved):
            moved.add(place)
    required = {place for j in outputs for place in tape.program.sources[j]} & moved
    for place in range(len(nodes) - 1, -1, -1):
        if place in required and nodes[place].code != INPUT:
            required.update(moved.intersection(nodes[place].operands))
    return tuple(sorted(required))


@final
class Tangents:
    """Derivatives of some outputs of a tape along directions of some inputs.

    Parameters
    ----------
    outputs
        Positions of the outputs.
    moving
        Positions of the inputs that may have a direction.

    Raises
    ------
    ValueFault
        An output depends on a moving input through an operation without a derivative rule.
    """

    def __init__(self, tape: Tape, outputs: Collection[int], moving: Collection[int]) -> None:
        self._tape, self._outputs = tape, tuple(outputs)
        self.places = between(tape, moving, outputs)
        for place in self.places:
            code = tape.nodes[place].code
            if code not in _PARTIALS and code not in _FLAT_CODES and code not in _ALWAYS:
                name = OPERATIONS[code].name
                raise ValueFault(f"exact test of {tape.name}: expected operations with a derivative, found {name}")

    def along(self, ring: Ring, values: Sequence[Any], direction: Mapping[int, Sequence[Any]]) -> list[list[Any]]:
        """Derivatives of the outputs, dense and column-major; 0 without a dependence on the moving inputs.

        `values` are those of all instructions; `direction` contains the moving inputs, by position, dense.
        """
        tape, reduced = self._tape, ring.reduced
        nodes, seeds = tape.nodes, {i: self._elements(i, given) for i, given in direction.items()}
        tangent: dict[int, Any] = {}
        for place in self.places:
            code, a, b, _, _ = nodes[place]
            if code == INPUT:
                if a in seeds:
                    tangent[place] = seeds[a][b]
                continue
            if code in _FLAT_CODES:
                continue
            lower: Any = tangent.get(a)
            right: Any = tangent.get(b) if OPERATIONS[code].arity == 2 else None
            if lower is None and right is None:
                continue
            if code == _ADD:
                tangent[place] = right if lower is None else lower if right is None else lower + right
            elif code == _SUB:
                tangent[place] = -right if lower is None else lower if right is None else lower - right
            elif code == _NEG:
                tangent[place] = -lower
            elif code == _TWICE:
                tangent[place] = 2 * lower
            elif code == _SQ:
                tangent[place] = reduced(2 * values[a] * lower)
            elif code == _MUL:
                first = 0 if lower is None else lower * values[b]
                tangent[place] = reduced(first if right is None else first + values[a] * right)
            elif code == _IF:
                if right is not None:
                    tangent[place] = ring.call("if_else_zero", values[a], right)
            else:
                over_a, over_b = self._partials(ring, place, values)
                first = 0 if lower is None else over_a * lower
                tangent[place] = reduced(first if right is None else first + over_b * right)
        return [self._dense(j, tangent) for j in self._outputs]

    def _partials(self, ring: Any, place: int, values: Sequence[Any]) -> tuple[Any, Any]:
        code, a, b, _, _ = self._tape.nodes[place]
        if code in POWERS and (node := self._tape.nodes[b]).code == CONST:
            return self._of_power(ring, values[a], self._tape.numbers[node.constant]), 0
        return _PARTIALS[code](ring, values[place], values[a], values[b])

    def _of_power(self, ring: Any, base: Any, exponent: Fraction) -> Any:
        """Derivative of a power with a constant exponent; its lower power is written as CasADi writes it."""
        lower, factor = exponent - 1, ring.number(exponent)
        if lower.denominator == 1:
            return factor * ring.power(base, lower.numerator)
        if lower == Fraction(1, 2):
            return factor * ring.call("sqrt", base)
        return factor * ring.call("constpow", base, ring.number(lower))

    def _elements(self, position: int, given: Sequence[Any]) -> list[Any]:
        return [given[place] for place in self._tape.program.inputs[position].places]

    def _dense(self, output: int, tangent: Mapping[int, Any]) -> list[Any]:
        pattern, sources = self._tape.program.outputs[output], self._tape.program.sources[output]
        matrix = [0] * pattern.size
        for place, source in zip(pattern.places, sources, strict=True):
            matrix[place] = tangent.get(source, 0)
        return matrix


_ALWAYS: Final = frozenset((INPUT, _ADD, _SUB, _MUL, _NEG, _SQ, _TWICE, _IF)) | POWERS
