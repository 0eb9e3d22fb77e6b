"""Equations of motion expanded: polynomials in named symbols and in sines and cosines of sums of joint angles.

A sum of such terms is unique, so that equal expressions have equal texts: within a group of parallel joints, products
of sines and cosines become sines and cosines of sums of angles.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, NamedTuple, final

from dmframe.common.errors import ValueFault
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.program import DIVISIONS, by_code, read, run

_HALF: Final = Fraction(1, 2)


class Wave(NamedTuple):
    """sin or cos of k[0] q_1 + k[1] q_2 + ...; the first k that is not zero is positive."""

    group: int
    sine: bool
    k: tuple[int, ...]


class Key(NamedTuple):
    """At most one wave of each group, ascending, and symbols, ascending and repeated for powers."""

    waves: tuple[Wave, ...]
    symbols: tuple[str, ...]


_ONE: Final = Key((), ())


@final
@dataclass(frozen=True)
class Polynomial:
    """A sum of coefficients times keys; no coefficient is zero."""

    terms: Mapping[Key, Fraction]

    @classmethod
    def of(cls, terms: Iterable[tuple[Key, Fraction]]) -> Polynomial:
        """Sum of terms; coefficients of equal keys are added."""
        total: defaultdict[Key, Fraction] = defaultdict(Fraction)
        for key, value in terms:
            total[key] += value
        return cls({key: value for key, value in total.items() if value})

    @classmethod
    def number(cls, value: Fraction | int) -> Polynomial:
        """A constant."""
        return cls({_ONE: Fraction(value)} if value else {})

    @classmethod
    def symbol(cls, name: str) -> Polynomial:
        """A symbol."""
        return cls({Key((), (name,)): Fraction(1)})

    def __add__(self, other: Polynomial) -> Polynomial:
        return Polynomial.of([*self.terms.items(), *other.terms.items()])

    def __neg__(self) -> Polynomial:
        return Polynomial({key: -value for key, value in self.terms.items()})

    def __sub__(self, other: Polynomial) -> Polynomial:
        return self + (-other)

    def __mul__(self, other: Polynomial) -> Polynomial:
        return Polynomial.of(
            (Key(waves, tuple(sorted(left.symbols + right.symbols))), x * y * factor)
            for left, x in self.terms.items()
            for right, y in other.terms.items()
            for waves, factor in _products(left.waves, right.waves)
        )


def wave(group: int, sine: bool, k: Sequence[int]) -> Polynomial:
    """Sine or cosine of a sum of angles."""
    return Polynomial.of(_canonical(group, sine, tuple(k), Fraction(1)))


def _canonical(group: int, sine: bool, k: tuple[int, ...], value: Fraction) -> list[tuple[Key, Fraction]]:
    return [(Key(waves, ()), factor) for waves, factor in _signed(group, sine, k, value)]


def _signed(group: int, sine: bool, k: tuple[int, ...], value: Fraction) -> list[tuple[tuple[Wave, ...], Fraction]]:
    leading = next((number for number in k if number), 0)
    if leading == 0:
        return [] if sine else [((), value)]
    if leading < 0:
        k, value = tuple(-number for number in k), -value if sine else value
    return [((Wave(group, sine, k),), value)]


def _products(left: tuple[Wave, ...], right: tuple[Wave, ...]) -> list[tuple[tuple[Wave, ...], Fraction]]:
    """Product of two products of waves, as a sum of products."""
    found: list[tuple[tuple[Wave, ...], Fraction]] = [((), Fraction(1))]
    waves = {wave.group: [wave] for wave in left}
    for other in right:
        waves.setdefault(other.group, []).append(other)
    for group in sorted(waves):
        options = _product(*waves[group]) if len(waves[group]) == 2 else [((waves[group][0],), Fraction(1))]
        found = [(have + more, x * y) for have, x in found for more, y in options]
    return found


def _product(a: Wave, b: Wave) -> list[tuple[tuple[Wave, ...], Fraction]]:
    """Cos a cos b = (cos(a + b) + cos(a - b)) / 2, and so on."""
    if b.sine and not a.sine:
        a, b = b, a
    plus = tuple(x + y for x, y in zip(a.k, b.k, strict=True))
    minus = tuple(x - y for x, y in zip(a.k, b.k, strict=True))
    both = a.sine and b.sine
    return [
        *_signed(a.group, a.sine and not b.sine, plus, -_HALF if both else _HALF),
        *_signed(a.group, a.sine and not b.sine, minus, _HALF),
    ]


Angle = tuple[int, tuple[int, ...]]
"""A joint angle: its group, and its place in it as a unit vector."""


def expand(function: Any, inputs: Sequence[Sequence[Polynomial | Angle]]) -> list[list[Polynomial]]:
    """Outputs of an SX function, dense and column-major, at polynomials and joint angles.

    Raises `ValueFault` if it is not a polynomial of symbols, and of sines and cosines of single angles.
    """
    program = read(function)
    values = run(
        program,
        RULES,
        given=lambda argument, element: inputs[argument][element],
        constant=lambda number: Polynomial.number(Fraction(number)),
        refuse=lambda code: ValueFault(
            f"{program.name}: expected sums and products of symbols, sines and cosines, found CasADi's instruction "
            f"{code}"
        ),
    )
    return program.dense(values, Polynomial({}))


def _of_polynomials(rule: Callable[..., Polynomial]) -> Callable[..., Any]:
    return lambda *values: rule(*values) if all(isinstance(value, Polynomial) for value in values) else NotImplemented


def _of_an_angle(sine: bool) -> Callable[..., Any]:
    return lambda value: wave(value[0], sine, value[1]) if isinstance(value, tuple) else NotImplemented


RULES: Final = {code: _of_polynomials(rule) for code, rule in ARITHMETIC.items() if code not in DIVISIONS} | by_code(
    {"sin": _of_an_angle(sine=True), "cos": _of_an_angle(sine=False)}
)
