"""Convert formula trees to text: precedence and brackets, common to all dialects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import ClassVar

from dmframe.formula import tree
from dmframe.formula.tree import (
    Applied,
    Choice,
    Derivative,
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
"""Operator precedence of a text."""


class Dialect(ABC):
    """Base class of dialects: writes a tree with the symbols of the dialect."""

    minus: str
    dots: str
    relations: ClassVar[Mapping[str, str]]

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
    def after(self, name: str) -> str:
        """The value of a name one sample later."""

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
    def part(self, text: str, places: str) -> str:
        """Something with its rows and columns below."""

    @abstractmethod
    def derivative(self, of: str, by: str) -> str:
        """The Jacobian of something, as one factor."""

    @abstractmethod
    def choice(self, relation: str, yes: str, no: str) -> str:
        """One of two."""

    @abstractmethod
    def unprinted(self, names: Sequence[str]) -> str:
        """An expression that is too long to print."""

    def _operand(self, node: Node, least: int = _ATOM) -> str:
        text, precedence = self._written(node)
        return text if precedence >= least else self.bracketed(text)

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
                return self.raised(self._operand(of), "T"), _ATOM
            case Diagonal(of):
                return f"{self.word('diag')}{self.bracketed(self.write(of))}", _ATOM
            case Inverse(of):
                return self.raised(self._operand(of), "-1"), _ATOM
            case Power(of, exponent):
                return self.raised(self._operand(of), str(exponent)), _ATOM
            case Norm(of, squared, weight):
                below = self.write(weight) if weight is not None else ""
                return self.norm(self.write(of), squared=squared, weight=below), _ATOM
            case Applied():
                return self._applied(node), _ATOM
            case Derivative(of, by):
                return self.derivative(self._operand(of), self.write(by)), _ATOM
            case Piece(of):
                return self._piece(node, of), _ATOM
            case Stack(rows):
                return self.matrix([[self.write(item) for item in row] for row in rows]), _ATOM
            case Choice(relation, yes, no):
                return self.choice(*map(self.write, (relation, yes, no))), _SUM
            case Relation(sign, left, right):
                if right is None:
                    return f"{self.relations[sign]} {self._operand(left)}", _SUM
                return f"{self.write(left)} {self.relations[sign]} {self.write(right)}", _SUM
            case Equation(left, right):
                return f"{self.write(left)} = {self.write(right)}", _SUM
            case Rate(of):
                return self.after(of.name) if node.sampled else self.rate(of.name), _ATOM
            case Unprinted(names):
                return self.unprinted([self.name(name) for name in names]), _SUM

    def _piece(self, piece: Piece, of: Node) -> str:
        """Indices counted from one, both ends included, as a subscript; a name with its own index is in brackets."""
        text = self.write(of)
        bare = len(of.name) == 1 or of.name.isalpha() if isinstance(of, Name) else isinstance(of, Applied)
        ends = [piece.rows] if piece.columns is None else [piece.rows, piece.columns]
        places = []
        for (start, stop), size in zip(ends, of.shape, strict=False):
            whole = (start, stop) == (0, size) and len(ends) > 1
            places.append(":" if whole else str(stop) if stop - start == 1 else f"{start + 1}{self.dots}{stop}")
        return self.part(text if bare else self.bracketed(text), ",".join(places))

    def _sum(self, terms: Sequence[Node]) -> str:
        text = self.write(terms[0])
        for term in terms[1:]:
            negative = isinstance(term, Product | Number) and _sign(term) < 0
            sign = self.minus if negative else "+"
            text += f" {sign} {self._operand(tree.scale(Fraction(-1), term) if negative else term, _PRODUCT)}"
        return text

    def _product(self, product: Product) -> tuple[str, int]:
        coefficient, sign = abs(product.coefficient), self.minus if product.coefficient < 0 else ""
        lead, factors = self.lead(coefficient, bool(product.factors), bool(product.below))
        divisors = [factors] * bool(factors) + [self._operand(node) for node in product.below]
        chain = self._chain(product.factors)
        above = self.joined([lead, chain] if lead and chain else [lead or chain or "1"])
        precedence = _SUM if sign else _PRODUCT
        if not divisors:
            return f"{sign}{above}", precedence
        below = self.joined(divisors)
        if _mixed_quotient(product):
            above = self.bracketed(above)
        simple = len(divisors) == 1
        return f"{sign}{self.over(above, below, simple=simple)}", precedence

    def lead(self, coefficient: Fraction, more: bool, below: bool) -> tuple[str, str]:
        """The parts of a number before the factors and below them."""
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
            pieces.append(self._operand(factor))
        return self.joined(pieces)

    def joined(self, pieces: Sequence[str]) -> str:
        """Factors side by side."""
        text = ""
        for piece in pieces:
            text += (self.between(text, piece) if text else "") + piece
        return text

    @abstractmethod
    def between(self, left: str, right: str) -> str:
        """The separator of two factors."""

    def _applied(self, node: Applied) -> str:
        arguments = [self.write(item) for item in node.arguments]
        if node.function == "abs":
            return self.norm(arguments[0], squared=False, weight="")
        if node.function == "sqrt":
            return f"{self.word('sqrt')}{self.bracketed(arguments[0])}"
        if node.function == "hadamard":
            return self.bracketed(f"{self._operand(node.arguments[0])} .* {self._operand(node.arguments[1])}")
        head = self.name(node.function) if node.symbol else self.word(node.function)
        return f"{head}{self.bracketed(', '.join(arguments))}"


def _sign(term: Product | Number) -> Fraction:
    return term.coefficient if isinstance(term, Product) else term.value


def _mixed_quotient(product: Product) -> bool:
    """True for a product with a matrix that is divided elementwise."""
    matrix = any(not tree.is_column(factor) for factor in product.factors)
    return matrix and any(not tree.is_scalar(node) for node in product.below)
