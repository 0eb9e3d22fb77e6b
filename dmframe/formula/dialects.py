"""The three dialects: the code's names, LaTeX, and Unicode for terminals and drawings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import ClassVar, Final, final

from dmframe.common.names import latex_name, unicode_name
from dmframe.formula.write import Dialect


def _relations(signs: str) -> dict[str, str]:
    """The signs of a dialect, by those of the code."""
    return dict(zip("< <= > >= = != and or not".split(), signs.split(), strict=True))


class _Plain(Dialect):
    """Base class of the two dialects for plain text."""

    prime: str
    square: str
    partial: str

    def over(self, above: str, below: str, *, simple: bool) -> str:
        return f"{above}/{below if simple else self.bracketed(below)}"

    def bracketed(self, text: str) -> str:
        return f"({text})"

    def norm(self, text: str, *, squared: bool, weight: str) -> str:
        below = f"_({weight})" if " " in weight or "/" in weight else f"_{weight}" * bool(weight)
        return f"|{text}|" + self.square * squared + below

    def word(self, word: str) -> str:
        return word

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        if all(len(row) == 1 for row in rows):
            return f"({', '.join(row[0] for row in rows)})"
        return f"[{'; '.join(', '.join(row) for row in rows)}]"

    def choice(self, relation: str, yes: str, no: str) -> str:
        return f"{yes} if {relation}, else {no}"

    def unprinted(self, names: Sequence[str]) -> str:
        return f"an expression of {', '.join(names)}" if names else "a matrix of numbers"

    def part(self, text: str, places: str) -> str:
        return f"{text}_{places}" if places.isdigit() else f"{text}_({places})"

    def derivative(self, of: str, by: str) -> str:
        return f"({self.partial}{of}/{self.partial}{by})"

    def between(self, left: str, right: str) -> str:
        return "" if left.endswith(self.prime) and right.startswith("(") else " "


@final
class _Text(_Plain):
    minus, prime, square, dots, partial = "-", "'", "^2", "..", "d"
    relations: ClassVar[Mapping[str, str]] = _relations("< <= > >= = != and or not")

    def name(self, name: str) -> str:
        return name

    def rate(self, name: str) -> str:
        return f"d{name}/dt"

    def after(self, name: str) -> str:
        return f"{name}+"

    def fraction(self, value: Fraction) -> str:
        return _decimal(value)

    def raised(self, base: str, exponent: str) -> str:
        return (
            f"{base}'" if exponent == "T" else f"{base}^{exponent}" if "/" not in exponent else f"{base}^({exponent})"
        )


def _decimal(value: Fraction) -> str:
    if value.denominator == 1:
        return str(value.numerator)
    exact = float(value)
    return f"{value.numerator}/{value.denominator}" if value.denominator <= 1000 and len(str(exact)) > 6 else str(exact)


@final
class _Latex(Dialect):
    minus, dots = "-", r" \ldots "
    relations: ClassVar[Mapping[str, str]] = _relations(r"< \le > \ge = \ne \land \lor \lnot")

    def name(self, name: str) -> str:
        return latex_name(name)

    def rate(self, name: str) -> str:
        return latex_name(name, "dot")

    def after(self, name: str) -> str:
        return f"{latex_name(name)}^{{+}}"

    def fraction(self, value: Fraction) -> str:
        return str(value.numerator) if value.denominator == 1 else self._small(value)

    @staticmethod
    def _small(value: Fraction) -> str:
        if value.denominator > 1000:
            return str(float(value))
        return rf"\tfrac{{{value.numerator}}}{{{value.denominator}}}"

    def lead(self, coefficient: Fraction, more: bool, below: bool) -> tuple[str, str]:
        """A number precedes its factors, unless it is combined with that of a quotient."""
        if coefficient == 1 and (more or below):
            return "" if more else "1", ""
        return self.fraction(coefficient), ""

    def raised(self, base: str, exponent: str) -> str:
        return f"{base}^{{{exponent}}}" if exponent != "T" else rf"{base}^\top"

    def over(self, above: str, below: str, *, simple: bool) -> str:
        if simple and "\\left" not in above + below:
            return f"{above}/{below}"
        return rf"\frac{{{above}}}{{{below}}}"

    def bracketed(self, text: str) -> str:
        return rf"\left({text}\right)" if "\\frac" in text or "\\tfrac" in text else f"({text})"

    def norm(self, text: str, *, squared: bool, weight: str) -> str:
        return f"|{text}|" + "^2" * squared + (f"_{{{weight}}}" if weight else "")

    def word(self, word: str) -> str:
        known = {"sgn": r"\operatorname{sgn}", "diag": r"\operatorname{diag}", "sqrt": r"\operatorname{sqrt}"}
        standard = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "min", "max")
        if word in standard:
            return f"\\{word}"
        plain = word.replace("_", r"\_")
        return known.get(word, rf"\operatorname{{{plain}}}")

    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        body = r" \\ ".join(" & ".join(row) for row in rows)
        return rf"\left[\begin{{matrix}} {body} \end{{matrix}}\right]"

    def part(self, text: str, places: str) -> str:
        return f"{text}_{{{places}}}"

    def derivative(self, of: str, by: str) -> str:
        return rf"\left(\partial {of}/\partial {by}\right)"

    def between(self, left: str, right: str) -> str:
        word = re.search(r"\\(?:mathrm|operatorname)\{[^{}]*\}$", left)
        return r" \, " if word or right.startswith((r"\mathrm", r"\operatorname")) else " "

    def choice(self, relation: str, yes: str, no: str) -> str:
        return rf"\begin{{cases}} {yes} & {relation} \\ {no} & \text{{else}} \end{{cases}}"

    def unprinted(self, names: Sequence[str]) -> str:
        return rf"\text{{an expression of }} {', '.join(names)}" if names else r"\text{a matrix of numbers}"


_VULGAR: Final = {Fraction(1, 2): "½", Fraction(1, 4): "¼", Fraction(3, 4): "¾"}
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@final
class _Unicode(_Plain):
    minus, prime, square, dots, partial = "−", "ᵀ", "²", "…", "∂"
    relations: ClassVar[Mapping[str, str]] = _relations("< ≤ > ≥ = ≠ ∧ ∨ ¬")

    def name(self, name: str) -> str:
        return unicode_name(name)

    def rate(self, name: str) -> str:
        return unicode_name(name, "dot")

    def after(self, name: str) -> str:
        return f"{unicode_name(name)}⁺"

    def fraction(self, value: Fraction) -> str:
        return _VULGAR.get(value) or _decimal(value)

    def lead(self, coefficient: Fraction, more: bool, below: bool) -> tuple[str, str]:
        if coefficient in _VULGAR:
            return _VULGAR[coefficient], ""
        return super().lead(coefficient, more, below)

    def raised(self, base: str, exponent: str) -> str:
        if exponent == "T":
            return f"{base}ᵀ"
        return f"{base}{exponent.translate(_RAISED)}" if "/" not in exponent else f"{base}^({exponent})"


TEXT: Final[Dialect] = _Text()
LATEX: Final[Dialect] = _Latex()
UNICODE: Final[Dialect] = _Unicode()
