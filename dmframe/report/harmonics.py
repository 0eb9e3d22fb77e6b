r"""Trigonometric polynomials with rational coefficients, in the one form in which textbooks write them.

A product of sines and cosines of single joints becomes a sum of sines and cosines of sums of joints. That form is
unique, so nothing is left to simplify: :math:`c_1 c_2 - s_1 s_2` is :math:`c_{12}`, and :math:`s_1^2 + c_1^2` is 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from typing import Any, Final, final

import casadi as ca

Monomial = tuple[tuple[int, int], ...]
"""(number of a symbol, power), in the order of the numbers."""
Wave = tuple[int, ...]
"""k, of exp(i k'q)."""
Complex = tuple[Fraction, Fraction]

_HALF: Final = Fraction(1, 2)


@final
class Harmonics:
    """A sum of terms c m exp(i k'q): complex c, monomial m in other symbols, integer k."""

    def __init__(self, terms: Mapping[tuple[Wave, Monomial], Complex]) -> None:
        self.terms = {key: value for key, value in terms.items() if value != (0, 0)}

    def __add__(self, other: Harmonics) -> Harmonics:
        terms = dict(self.terms)
        for key, (re, im) in other.terms.items():
            a, b = terms.get(key, (Fraction(0), Fraction(0)))
            terms[key] = (a + re, b + im)
        return Harmonics(terms)

    def __mul__(self, other: Harmonics) -> Harmonics:
        terms = dict[tuple[Wave, Monomial], Complex]()
        for (k, m), (a, b) in self.terms.items():
            for (l, o), (c, d) in other.terms.items():  # noqa: E741 - the second wave
                key = tuple(x + y for x, y in zip(k, l, strict=True)), _times(m, o)
                re, im = terms.get(key, (Fraction(0), Fraction(0)))
                terms[key] = (re + a * c - b * d, im + a * d + b * c)
        return Harmonics(terms)

    def scaled(self, factor: Fraction) -> Harmonics:
        """Times a rational number."""
        return Harmonics({key: (re * factor, im * factor) for key, (re, im) in self.terms.items()})


def _times(a: Monomial, b: Monomial) -> Monomial:
    powers = dict(a)
    for name, power in b:
        powers[name] = powers.get(name, 0) + power
    return tuple(sorted(powers.items()))


def harmonics(expression: Any, joints: Sequence[Any], symbols: Sequence[Any]) -> Harmonics:
    """Read a scalar SX expression in + - * of symbols and of sin and cos of single joints.

    `symbols` may hold an SX or a number for each place: what the monomials count. Raises LookupError for any other
    operation or symbol.
    """
    reader = _Reader(joints, symbols)
    return reader.read(expression)


class _Reader:
    """Reads each node of an expression once."""

    def __init__(self, joints: Sequence[Any], symbols: Sequence[Any]) -> None:
        self.n = len(joints)
        self.still = (0,) * self.n
        self.joints = {joint.element_hash(): place for place, joint in enumerate(joints)}
        self.symbols = {symbol.element_hash(): place for place, symbol in enumerate(symbols)}
        self.known = dict[int, Harmonics]()

    def read(self, x: Any) -> Harmonics:
        key = x.element_hash()
        if key not in self.known:
            self.known[key] = self._read(x)
        return self.known[key]

    def constant(self, value: Fraction) -> Harmonics:
        return Harmonics({(self.still, ()): (value, Fraction(0))})

    def _read(self, x: Any) -> Harmonics:
        if x.is_constant():
            return self.constant(Fraction(float(x)))
        if x.is_symbolic():
            return Harmonics({(self.still, ((self.symbols[x.element_hash()], 1),)): (Fraction(1), Fraction(0))})
        kind = x.op()
        if kind in (ca.OP_SIN, ca.OP_COS):
            return self._wave(self.joints[x.dep(0).element_hash()], kind)
        parts = [self.read(x.dep(i)) for i in range(x.n_dep())]
        match kind:
            case ca.OP_ADD:
                return parts[0] + parts[1]
            case ca.OP_SUB:
                return parts[0] + parts[1].scaled(Fraction(-1))
            case ca.OP_MUL:
                return parts[0] * parts[1]
            case ca.OP_SQ:
                return parts[0] * parts[0]
            case ca.OP_NEG:
                return parts[0].scaled(Fraction(-1))
            case ca.OP_TWICE:
                return parts[0].scaled(Fraction(2))
            case _:
                raise LookupError(f"an operation that is none of + - * sin cos: {kind}")

    def _wave(self, joint: int, kind: int) -> Harmonics:
        up = tuple(int(place == joint) for place in range(self.n))
        down = tuple(-k for k in up)
        if kind == ca.OP_COS:
            return Harmonics({(up, ()): (_HALF, Fraction(0)), (down, ()): (_HALF, Fraction(0))})
        return Harmonics({(up, ()): (Fraction(0), -_HALF), (down, ()): (Fraction(0), _HALF)})


def harmonics_latex(value: Harmonics, names: Sequence[str]) -> str:
    """As a textbook writes it: constants first, then c_1, c_12 and so on, each with all that it is multiplied by."""
    groups = dict[tuple[int, Wave], dict[Monomial, Fraction]]()
    for (wave, monomial), (re, im) in value.terms.items():
        lead = next((k for k in wave if k), 0)
        if lead < 0:
            continue  # its mirror image carries both
        kinds = ((0, re),) if lead == 0 else ((1, 2 * re), (2, -2 * im))
        for kind, coefficient in kinds:
            if coefficient:
                groups.setdefault((kind, wave), {})[monomial] = coefficient
    ordered = sorted(groups.items(), key=lambda item: (item[0][0], tuple(map(abs, item[0][1])), item[0][1]))
    pieces = [_group(coefficients, _trig(kind, wave), names) for (kind, wave), coefficients in ordered]
    text = " ".join(piece if piece.startswith("-") else f"+ {piece}" for piece in pieces)
    return text.removeprefix("+ ") or "0"


def _trig(kind: int, wave: Wave) -> str:
    if kind == 0:
        return ""
    name = "cs"[kind - 1]
    if all(k in (0, 1) for k in wave):
        return f"{name}_{{{''.join(str(i) for i, k in enumerate(wave, start=1) if k)}}}"
    angle = " ".join(
        f"{'+' if k > 0 else '-'} {abs(k) if abs(k) > 1 else ''} q_{i}" for i, k in enumerate(wave, start=1) if k
    ).removeprefix("+ ")
    return rf"\{'cos' if kind == 1 else 'sin'}({angle})"


def _group(coefficients: Mapping[Monomial, Fraction], trig: str, names: Sequence[str]) -> str:
    """The sum of monomials times one sine or cosine, with what they have in common before the bracket."""
    if not trig:
        return _sum(coefficients, names)
    if len(coefficients) == 1:
        ((monomial, coefficient),) = coefficients.items()
        return _product(coefficient, monomial, names, trig)
    common = dict(reduce(_shared, coefficients))
    sizes = list(coefficients.values())
    scale = Fraction(gcd(*(c.numerator for c in sizes)), lcm(*(c.denominator for c in sizes)))
    if all(c < 0 for c in sizes):
        scale = -scale
    rest = {_without(monomial, common): c / scale for monomial, c in coefficients.items()}
    return _product(scale, tuple(sorted(common.items())), names, rf"({_sum(rest, names)})\, {trig}")


def _without(monomial: Monomial, common: Mapping[int, int]) -> Monomial:
    left = ((name, power - common.get(name, 0)) for name, power in monomial)
    return tuple((name, power) for name, power in left if power)


def _shared(a: Monomial, b: Monomial) -> Monomial:
    other = dict(b)
    return tuple((name, min(power, other[name])) for name, power in a if name in other)


def _sum(coefficients: Mapping[Monomial, Fraction], names: Sequence[str]) -> str:
    pieces = [_product(c, m, names) for m, c in sorted(coefficients.items(), key=lambda item: item[0])]
    return " ".join(p if p.startswith("-") else f"+ {p}" for p in pieces).removeprefix("+ ")


def _product(coefficient: Fraction, monomial: Monomial, names: Sequence[str], last: str = "") -> str:
    factors = [f"{names[name]}^{power}" if power > 1 else names[name] for name, power in monomial] + [last] * bool(last)
    size = abs(coefficient)
    number = str(size.numerator) if size.denominator == 1 else rf"\tfrac{{{size.numerator}}}{{{size.denominator}}}"
    shown = factors if size == 1 and factors else [number, *factors]
    return "- " * (coefficient < 0) + " ".join(shown)
