"""The tree of a formula in three dialects: the code's names, LaTeX, and Unicode for terminals and drawings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Final, final

from dmframe.formula import tree
from dmframe.formula.names import latex_name, unicode_name
from dmframe.formula.tree import (
    Applied,
    Choice,
    Diagonal,
    Equation,
    Identity,
    Inverse,
    Name,
    Node,
    Norm,
    Number,
    Piece,
    Power,
    Product,
    Rate,
    Relation,
    Stack,
    Sum,
    Transposed,
    Unprinted,
)

_SUM, _PRODUCT, _ATOM = range(3)
"""How tightly a piece of text holds together."""


@final
@dataclass(frozen=True)
class Formula:
    """One formula, in three dialects; each is written when it is first asked for."""

    node: Node

    @cached_property
    def text(self) -> str:
        """In the code's names: ``J_hat'(x_o - x)/2 + s/beta``."""
        return TEXT.write(self.node)

    @cached_property
    def latex(self) -> str:
        """As LaTeX, without dollar signs."""
        return LATEX.write(self.node)

    @cached_property
    def unicode(self) -> str:
        """For a terminal or a drawing: ``ẇ = −Λ τ_dc σ``."""
        return UNICODE.write(self.node)

    def __str__(self) -> str:
        return self.text


class Dialect(ABC):
    """How a tree is written; a dialect says what its signs are."""

    minus: str
    gap: str
    comma = ", "
    less: str
    relations: dict[str, str]

    def write(self, node: Node) -> str:
        """The text of a tree."""
        return self._written(node)[0]

    @abstractmethod
    def name(self, name: str) -> str:
        """A name."""

    @abstractmethod
    def rate(self, name: str) -> str:
        """The time derivative of a name."""

    @abstractmethod
    def fraction(self, value: Fraction) -> str:
        """A positive number, as a factor or alone."""

    @abstractmethod
    def raised(self, base: str, exponent: str) -> str:
        """Base to the exponent, of "T", "-1" or a number."""

    @abstractmethod
    def over(self, above: str, below: str, *, simple: bool) -> str:
        """A quotient."""

    @abstractmethod
    def bracketed(self, text: str) -> str:
        """In brackets."""

    @abstractmethod
    def norm(self, text: str, *, squared: bool, weight: str) -> str:
        """|text|, its square, its weighted square."""

    @abstractmethod
    def word(self, word: str) -> str:
        """A function such as tanh."""

    @abstractmethod
    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Blocks of a matrix."""

    @abstractmethod
    def part(self, text: str, piece: Piece) -> str:
        """Rows and columns of something."""

    @abstractmethod
    def choice(self, relation: str, yes: str, no: str) -> str:
        """One of two."""

    @abstractmethod
    def unprinted(self, names: Sequence[str]) -> str:
        """What is too long to be written."""

    def half(self, above: str, value: Fraction) -> str:
        """A numerator with its number; the denominator of the number stands below."""
        return above

    def _held(self, node: Node, least: int = _ATOM) -> str:
        text, holds = self._written(node)
        return text if holds >= least else self.bracketed(text)

    def _written(self, node: Node) -> tuple[str, int]:
        match node:
            case Number(value):
                text = self.fraction(abs(value))
                return (text, _ATOM) if value >= 0 else (f"{self.minus}{text}", _SUM)
            case Name(name):
                return self.name(name), _ATOM
            case Identity():
                return self.name("I"), _ATOM
            case Sum(terms):
                return self._sum(terms), _SUM
            case Product():
                return self._product(node)
            case Transposed(of):
                return self.raised(self._held(of), "T"), _ATOM
            case Diagonal(of):
                return f"{self.word('diag')}{self.bracketed(self.write(of))}", _ATOM
            case Inverse(of):
                return self.raised(self._held(of), "-1"), _ATOM
            case Power(of, exponent):
                return self.raised(self._held(of), str(exponent)), _ATOM
            case Norm(of, squared, weight):
                below = self.write(weight) if weight is not None else ""
                return self.norm(self.write(of), squared=squared, weight=below), _ATOM
            case Applied():
                return self._applied(node), _ATOM
            case Piece(of):
                return self.part(self._held(of), node), _ATOM
            case Stack(rows):
                return self.matrix([[self.write(item) for item in row] for row in rows]), _ATOM
            case Choice(relation, yes, no):
                return self.choice(*map(self.write, (relation, yes, no))), _SUM
            case Relation(sign, left, right):
                if right is None:
                    return f"{self.relations[sign]} {self._held(left)}", _SUM
                return f"{self.write(left)} {self.relations[sign]} {self.write(right)}", _SUM
            case Equation(left, right):
                return f"{self.write(left)} = {self.write(right)}", _SUM
            case Rate(of):
                return self.rate(of.name), _ATOM
            case Unprinted(names):
                return self.unprinted([self.name(name) for name in names]), _SUM

    def _sum(self, terms: Sequence[Node]) -> str:
        text = self.write(terms[0])
        for term in terms[1:]:
            negative = isinstance(term, Product | Number) and _sign(term) < 0
            sign = self.minus if negative else "+"
            text += f" {sign} {self._held(tree.scale(Fraction(-1), term) if negative else term, _PRODUCT)}"
        return text

    def _product(self, product: Product) -> tuple[str, int]:
        coefficient, sign = abs(product.coefficient), self.minus if product.coefficient < 0 else ""
        lead, factors = self.lead(coefficient, bool(product.factors), bool(product.below))
        divisors = [factors] * bool(factors) + [self._held(node) for node in product.below]
        chain = self._chain(product.factors)
        above = self.joined([lead, chain] if lead and chain else [lead or chain or "1"])
        holds = _SUM if sign else _PRODUCT
        if not divisors:
            return f"{sign}{above}", holds
        below = self.joined(divisors)
        if _mixed_quotient(product):
            above = self.bracketed(above)
        simple = len(divisors) == 1
        return f"{sign}{self.over(above, below if simple else below, simple=simple)}", holds

    def lead(self, coefficient: Fraction, more: bool, below: bool) -> tuple[str, str]:
        """What stands before the factors, and what stands below them, of a number."""
        top = "" if coefficient.numerator == 1 and more else str(coefficient.numerator)
        if coefficient == 1 and more:
            top = ""
        return top, "" if coefficient.denominator == 1 else str(coefficient.denominator)

    def _chain(self, factors: Sequence[Node]) -> str:
        pieces = list[str]()
        for place, factor in enumerate(factors):
            last = place == len(factors) - 1
            if isinstance(factor, Diagonal) and not last:
                factor = factor.of
            pieces.append(self._held(factor))
        return self.joined(pieces)

    def joined(self, pieces: Sequence[str]) -> str:
        """Factors side by side."""
        text = ""
        for piece in pieces:
            text += (self.between(text, piece) if text else "") + piece
        return text

    def between(self, left: str, right: str) -> str:
        """What stands between two factors."""
        return self.gap

    def _applied(self, node: Applied) -> str:
        arguments = [self.write(item) for item in node.arguments]
        if node.function == "abs":
            return self.norm(arguments[0], squared=False, weight="")
        if node.function == "sqrt":
            return f"{self.word('sqrt')}{self.bracketed(arguments[0])}"
        if node.function == "hadamard":
            return self.bracketed(f"{self._held(node.arguments[0])} .* {self._held(node.arguments[1])}")
        head = self.name(node.function) if node.symbol else self.word(node.function)
        return f"{head}{self.bracketed(self.comma.join(arguments))}"


def _sign(term: Product | Number) -> Fraction:
    return term.coefficient if isinstance(term, Product) else term.value


def _mixed_quotient(product: Product) -> bool:
    """Is a product with a matrix divided element by element?"""
    matrix = any(not tree.is_column(factor) for factor in product.factors)
    return matrix and any(not tree.is_scalar(node) for node in product.below)


class _Plain(Dialect):
    """What the two dialects of running text share."""

    prime: str
    square: str

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

    def between(self, left: str, right: str) -> str:
        return "" if left.endswith(self.prime) and right.startswith("(") else " "


@final
class _Text(_Plain):
    minus, gap, prime, square = "-", " ", "'", "^2"
    relations = {
        "<": "<",
        "<=": "<=",
        ">": ">",
        ">=": ">=",
        "=": "=",
        "!=": "!=",
        "and": "and",
        "or": "or",
        "not": "not",
    }

    def name(self, name: str) -> str:
        return name

    def rate(self, name: str) -> str:
        return f"d{name}/dt"

    def fraction(self, value: Fraction) -> str:
        return _decimal(value)

    def raised(self, base: str, exponent: str) -> str:
        return (
            f"{base}'" if exponent == "T" else f"{base}^{exponent}" if "/" not in exponent else f"{base}^({exponent})"
        )

    def part(self, text: str, piece: Piece) -> str:
        ends = [piece.rows] if piece.columns is None else [piece.rows, piece.columns]
        sizes = piece.of.shape
        return f"{text}[{', '.join(_span(end, size) for end, size in zip(ends, sizes, strict=False))}]"


def _span(ends: tuple[int, int], size: int) -> str:
    """As Python writes it."""
    start, stop = ends
    if stop - start == 1:
        return str(start)
    return f"{start or ''}:{stop if stop < size else ''}"


def _decimal(value: Fraction) -> str:
    if value.denominator == 1:
        return str(value.numerator)
    exact = float(value)
    return f"{value.numerator}/{value.denominator}" if value.denominator <= 1000 and len(str(exact)) > 6 else str(exact)


@final
class _Latex(Dialect):
    minus, gap = "-", " "
    relations = {
        "<": "<",
        "<=": r"\le",
        ">": ">",
        ">=": r"\ge",
        "=": "=",
        "!=": r"\ne",
        "and": r"\land",
        "or": r"\lor",
        "not": r"\lnot",
    }

    def name(self, name: str) -> str:
        return latex_name(name)

    def rate(self, name: str) -> str:
        return latex_name(name, "dot")

    def fraction(self, value: Fraction) -> str:
        return str(value.numerator) if value.denominator == 1 else self._small(value)

    @staticmethod
    def _small(value: Fraction) -> str:
        if value.denominator > 1000:
            return str(float(value))
        return rf"\tfrac{{{value.numerator}}}{{{value.denominator}}}"

    def lead(self, coefficient: Fraction, more: bool, below: bool) -> tuple[str, str]:
        """A number stands before its factors, unless it joins a quotient's."""
        if (coefficient == 1 and more) or (below and not more and coefficient == 1):
            return "" if more else "1", ""
        return self.fraction(coefficient), ""

    def raised(self, base: str, exponent: str) -> str:
        return f"{base}^{{{self._top(exponent)}}}" if exponent != "T" else rf"{base}^\top"

    @staticmethod
    def _top(exponent: str) -> str:
        return exponent

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
        return rf"\begin{{bmatrix}} {body} \end{{bmatrix}}"

    def part(self, text: str, piece: Piece) -> str:
        return f"[{text}]_{{{_counted(piece)}}}"

    def choice(self, relation: str, yes: str, no: str) -> str:
        return rf"\begin{{cases}} {yes} & {relation} \\ {no} & \text{{else}} \end{{cases}}"

    def unprinted(self, names: Sequence[str]) -> str:
        return rf"\text{{an expression of }} {', '.join(names)}" if names else r"\text{a matrix of numbers}"


def _counted(piece: Piece) -> str:
    """Rows and columns counted from one, both ends included."""
    ends = [piece.rows] if piece.columns is None else [piece.rows, piece.columns]
    sizes = piece.of.shape
    spans = []
    for (start, stop), size in zip(ends, sizes, strict=False):
        whole = (start, stop) == (0, size)
        spans.append(":" if whole else str(stop) if stop - start == 1 else f"{start + 1}:{stop}")
    return ",".join(spans)


_VULGAR: Final = {Fraction(1, 2): "½", Fraction(1, 4): "¼", Fraction(3, 4): "¾"}
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@final
class _Unicode(_Plain):
    minus, gap, prime, square = "−", " ", "ᵀ", "²"
    relations = {"<": "<", "<=": "≤", ">": ">", ">=": "≥", "=": "=", "!=": "≠", "and": "∧", "or": "∨", "not": "¬"}

    def name(self, name: str) -> str:
        return unicode_name(name)

    def rate(self, name: str) -> str:
        return unicode_name(name, "dot")

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

    def part(self, text: str, piece: Piece) -> str:
        return f"{text}[{_counted(piece)}]"


TEXT: Final[Dialect] = _Text()
LATEX: Final[Dialect] = _Latex()
UNICODE: Final[Dialect] = _Unicode()
