"""Expanded equations of motion in textbook form."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple, final

import numpy as np

from dmframe.regressor.polynomial import Polynomial, Wave


class Factor(NamedTuple):
    """sin or cos of a sum of joint angles, k over all joints."""

    sine: bool
    k: tuple[int, ...]


@final
@dataclass(frozen=True)
class Term:
    """Product of a coefficient, symbols, sines and cosines."""

    value: Fraction
    symbols: tuple[str, ...]
    factors: tuple[Factor, ...]

    def at(self, numbers: Mapping[str, float], q: np.ndarray) -> float:
        """Numeric value, for the check of the printed equations."""
        result = float(self.value)
        for symbol in self.symbols:
            result *= numbers[symbol]
        for factor in self.factors:
            angle = float(np.dot(factor.k, q))
            result *= np.sin(angle) if factor.sine else np.cos(angle)
        return result


@final
@dataclass(frozen=True)
class Groups:
    """Groups of adjacent joints with parallel axes: (first joint, signs of their axes) of each group."""

    members: tuple[tuple[int, tuple[int, ...]], ...]
    n: int

    def wide(self, wave: Wave) -> Factor:
        """A wave with k over all joints."""
        first, signs = self.members[wave.group]
        k = [0] * self.n
        k[first : first + len(signs)] = wave.k
        return Factor(wave.sine, tuple(k))

    def nice(self, group: int, k: Sequence[int]) -> bool:
        """True for one joint angle, or the angle of a link: the signed sum over adjacent parallel joints."""
        signs = self.members[group][1]
        used = [place for place, number in enumerate(k) if number]
        if not used or used[-1] - used[0] != len(used) - 1:
            return False
        return len({k[place] * signs[place] for place in used}) == 1 and abs(k[used[0]]) == 1


def terms_of(polynomial: Polynomial, groups: Groups, order: Mapping[str, int]) -> tuple[Term, ...]:
    """The polynomial as few readable terms, in the order of their symbols."""
    by_symbols: defaultdict[tuple[str, ...], dict[tuple[Wave, ...], Fraction]] = defaultdict(dict)
    for key, value in polynomial.terms.items():
        by_symbols[key.symbols][key.waves] = value
    found = []
    for symbols, waves in sorted(by_symbols.items(), key=lambda item: [order[name] for name in reversed(item[0])]):
        named = tuple(sorted(symbols, key=lambda name: order[name]))
        found += [Term(value, named, factors) for value, factors in _folded(waves, groups)]
    return tuple(found)


_Sum = list[tuple[Fraction, tuple[Factor, ...]]]


def _folded(waves: Mapping[tuple[Wave, ...], Fraction], groups: Groups) -> _Sum:
    """Products of waves of several groups, folded in one group after the other."""
    rows: list[tuple[Fraction, tuple[Factor, ...], tuple[Wave, ...]]] = [(v, (), w) for w, v in waves.items()]
    for group, (_, signs) in enumerate(groups.members):
        zero = Wave(group, False, (0,) * len(signs))
        inner: defaultdict[Any, dict[Wave, Fraction]] = defaultdict(dict)
        for value, factors, left in rows:
            mine = next((w for w in left if w.group == group), zero)
            inner[factors, tuple(w for w in left if w != mine)][mine] = value
        rows = [
            (value, (*factors, *more), rest)
            for (factors, rest), sums in inner.items()
            for value, more in _fold(sums, zero, groups)
        ]
    return [(value, factors) for value, factors, _ in rows]


def _fold(sums: Mapping[Wave, Fraction], zero: Wave, groups: Groups) -> _Sum:
    """Sums as products if that leaves single angles, cos(2a + b) + cos b = 2 cos(a + b) cos a; others are unchanged."""
    left, found = dict(sums), list[tuple[Fraction, tuple[Factor, ...]]]()
    awkward = [wave for wave in left if wave != zero and not groups.nice(zero.group, wave.k)]
    for wave in sorted(awkward, key=lambda w: [-abs(x) for x in w.k]):
        other = _partner(wave, left, zero, groups) if wave in left else None
        if other is None:
            continue
        value, own = left.pop(wave), left.pop(other, Fraction(0))
        sign = 1 if own * value >= 0 else -1
        if other == zero and own != sign * value:
            left[zero] = own - sign * value
        found.append(_product_form(wave, other, value, sign, groups))
    plain = [(left[wave], () if wave == zero else (groups.wide(wave),)) for wave in sorted(left) if left[wave]]
    return [*plain, *found]


def _partner(wave: Wave, left: Mapping[Wave, Fraction], zero: Wave, groups: Groups) -> Wave | None:
    """Partner of a wave whose half sum and half difference are single angles: another wave, or zero."""
    alike = [w for w in left if w not in (wave, zero) and w.sine == wave.sine and abs(left[w]) == abs(left[wave])]
    if wave.sine:
        alike.append(zero._replace(sine=True))
    elif zero in left:
        alike.append(zero)
    return next((other for other in alike if _halves(wave, other, groups)), None)


def _halves(a: Wave, b: Wave, groups: Groups) -> tuple[Wave, Wave] | None:
    """(a + b)/2 and (a - b)/2, if both are single angles."""
    sides = [tuple(x + sign * y for x, y in zip(a.k, b.k, strict=True)) for sign in (1, -1)]
    if any(number % 2 for side in sides for number in side):
        return None
    halves = [tuple(number // 2 for number in side) for side in sides]
    if not all(groups.nice(a.group, half) for half in halves):
        return None
    return Wave(a.group, False, halves[0]), Wave(a.group, False, halves[1])


def _product_form(a: Wave, b: Wave, value: Fraction, sign: int, groups: Groups) -> tuple[Fraction, tuple[Factor, ...]]:
    """The value of (cos a + sign cos b), or (sin a + sign sin b), as a product."""
    halves = _halves(a, b, groups)
    assert halves is not None  # ensured by `_partner`
    sines = {(False, 1): (False, False), (False, -1): (True, True), (True, 1): (True, False), (True, -1): (False, True)}
    value = -2 * value if (a.sine, sign) == (False, -1) else 2 * value
    factors = []
    for half, sine in zip(halves, sines[a.sine, sign], strict=True):
        if next(number for number in half.k if number) < 0:
            half = half._replace(k=tuple(-number for number in half.k))
            value = -value if sine else value
        factors.append(groups.wide(half._replace(sine=sine)))
    return value, tuple(sorted(factors))


@final
@dataclass(frozen=True)
class Style:
    """Output format of terms: plain text or LaTeX."""

    latex: bool

    def sum(self, terms: Sequence[Term], line: int = 0) -> str:
        """All terms; in LaTeX, a new line of an align after every `line` of them."""
        if not terms:
            return "0"
        pieces = []
        for number, term in enumerate(terms):
            sign = "-" if term.value < 0 else "+" if number else ""
            gap = " " if number else ""
            broken = r" \\ &\quad" + "\n   " if line and number and number % line == 0 else ""
            pieces.append(f"{broken}{gap}{sign}{gap}{self._term(term)}")
        return "".join(pieces)

    def symbol(self, name: str) -> str:
        """A symbol's name."""
        return latex_name(name) if self.latex else name

    def _term(self, term: Term) -> str:
        powers = [(name, self._power(self.symbol(name), power)) for name, power in Counter(term.symbols).items()]
        parts = [text for name, text in powers if not _moves(name)]
        parts += [self._wave(factor, power) for factor, power in Counter(term.factors).items()]
        parts += [text for name, text in powers if _moves(name)]
        number = self._number(abs(term.value))
        return " ".join([number, *parts] if number != "1" or not parts else parts)

    def _number(self, value: Fraction) -> str:
        if value.denominator == 1 and value < 1000:
            return str(value)
        if max(value.numerator, value.denominator) > 1000:  # from a general rotation
            return f"{float(value):.6g}"
        return rf"\tfrac{{{value.numerator}}}{{{value.denominator}}}" if self.latex else f"{float(value):.6g}"

    def _power(self, text: str, power: int) -> str:
        if power == 1:
            return text
        if self.latex and text.startswith(r"\d"):  # a dot over a letter does not take an exponent well
            return f"{{{text}}}^{{{power}}}"
        return f"{text}^{{{power}}}" if self.latex else f"{text}^{power}"

    def _wave(self, factor: Factor, power: int) -> str:
        letter = "s" if factor.sine else "c"
        used = [place for place, number in enumerate(factor.k) if number]
        if {factor.k[place] for place in used} == {1} and used[-1] - used[0] == len(used) - 1:
            digits = "".join(str(place + 1) for place in used)
            return self._power(f"{letter}_{{{digits}}}" if self.latex else f"{letter}_{digits}", power)
        angle = Style(self.latex).sum([Term(Fraction(factor.k[p]), (f"q_{p + 1}",), ()) for p in used])
        function = (r"\sin" if factor.sine else r"\cos") if self.latex else ("sin" if factor.sine else "cos")
        return self._power(f"{function}({angle})", power)


_ACCENTS = {"ddq_ref": r"\ddot q_{{\mathrm r{0}}}", "dq_ref": r"\dot q_{{\mathrm r{0}}}", "dq": r"\dot q_{{{0}}}"}
_GREEK = {"psi": r"\psi", "phi": r"\varphi"}


def _moves(name: str) -> bool:
    """True for a rate, which is printed after sines and cosines."""
    return name.rpartition("_")[0] in (*_ACCENTS, *_GREEK)


def latex_name(name: str) -> str:
    """``dq_1`` as a dotted q, ``I_yy2`` with its index below."""
    stem, _, index = name.rpartition("_")
    if stem in _ACCENTS:
        return _ACCENTS[stem].format(index)
    if stem == "phi":
        return rf"\varphi(\dot q_{{\mathrm r{index}}})"
    return f"{_GREEK.get(stem, stem)}_{{{index}}}" if stem else name
