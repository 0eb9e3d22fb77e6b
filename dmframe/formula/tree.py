"""Formula trees, the intermediate form between CasADi expressions and printed text.

A product is evaluated from right to left, and a column that is not its last factor means a diagonal matrix. The
elementwise product of two columns and a diagonal gain are therefore written like products of numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import final

Shape = tuple[int, int]
Description = tuple[tuple[str, ...], str]
"""Description of a function, and the names of its arguments."""
SCALAR: Shape = (1, 1)
MINUS = Fraction(-1)


@final
@dataclass(frozen=True)
class Number:
    """A number, or a column or matrix of equal numbers."""

    value: Fraction
    shape: Shape = SCALAR


@final
@dataclass(frozen=True)
class Name:
    """A symbol, by its name in the code."""

    name: str
    shape: Shape = SCALAR


@final
@dataclass(frozen=True)
class Identity:
    """The identity matrix."""

    shape: Shape


@final
@dataclass(frozen=True)
class Sum:
    """Terms, the sign of each in its coefficient."""

    terms: tuple[Node, ...]
    shape: Shape


@final
@dataclass(frozen=True)
class Product:
    """coefficient * factors / below."""

    coefficient: Fraction
    factors: tuple[Node, ...]
    below: tuple[Node, ...]
    shape: Shape


@final
@dataclass(frozen=True)
class Transposed:
    """of'."""

    of: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Diagonal:
    """diag(of), of a column."""

    of: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Inverse:
    """The inverse of a matrix."""

    of: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Power:
    """of^exponent, of a scalar or of each element."""

    of: Node
    exponent: Fraction
    shape: Shape


@final
@dataclass(frozen=True)
class Norm:
    """|of|, or |of|^2, or |of|^2_weight."""

    of: Node
    squared: bool = False
    weight: Node | None = None
    shape: Shape = SCALAR


@final
@dataclass(frozen=True)
class Applied:
    """function(arguments); a `symbol` is a name such as J, else a word such as tanh."""

    function: str
    arguments: tuple[Node, ...]
    shape: Shape
    symbol: bool = False
    description: Description | None = field(default=None, compare=False)


@final
@dataclass(frozen=True)
class Derivative:
    """The Jacobian of a column by names."""

    of: Node
    by: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Piece:
    """Rows, and columns of a matrix, counted from zero; the end is excluded."""

    of: Node
    rows: tuple[int, int]
    columns: tuple[int, int] | None
    shape: Shape


@final
@dataclass(frozen=True)
class Stack:
    """Blocks of a matrix, row by row."""

    rows: tuple[tuple[Node, ...], ...]
    shape: Shape


@final
@dataclass(frozen=True)
class Choice:
    """`yes` where the relation holds, else `no`."""

    relation: Node
    yes: Node
    no: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Relation:
    """left sign right, of <, <=, =, !=; or not left."""

    sign: str
    left: Node
    right: Node | None
    shape: Shape


@final
@dataclass(frozen=True)
class Rate:
    """The time derivative of a name; `sampled`, its value one sample later."""

    of: Name
    shape: Shape
    sampled: bool = False


@final
@dataclass(frozen=True)
class Equation:
    """left = right."""

    left: Node
    right: Node
    shape: Shape


@final
@dataclass(frozen=True)
class Unprinted:
    """An expression that is too long to print, given by its symbols."""

    names: tuple[str, ...]
    shape: Shape


Node = (
    Number
    | Name
    | Identity
    | Sum
    | Product
    | Transposed
    | Diagonal
    | Inverse
    | Power
    | Norm
    | Applied
    | Derivative
    | Piece
    | Stack
    | Choice
    | Relation
    | Rate
    | Equation
    | Unprinted
)
"""Any node."""


def is_scalar(node: Node) -> bool:
    """True for one number."""
    return node.shape == SCALAR


def is_column(node: Node) -> bool:
    """True for a column, or a number."""
    return node.shape[1] == 1


def add(left: Node, right: Node, shape: Shape) -> Node:
    """Left + right."""
    terms = (*_terms(left), *_terms(right))
    kept = tuple(term for term in terms if not _is_zero(term))
    if not kept:
        return Number(Fraction(0), shape)
    return kept[0] if len(kept) == 1 and kept[0].shape == shape else Sum(kept, shape)


def subtract(left: Node, right: Node, shape: Shape) -> Node:
    """Left - right; the subtrahend is in brackets, unless it contains the left: a - (a + b) is -b."""
    if isinstance(right, Sum) and left in right.terms and left.shape == right.shape:
        place = right.terms.index(left)
        rest = (*right.terms[:place], *right.terms[place + 1 :])
        return scale(MINUS, rest[0] if len(rest) == 1 and rest[0].shape == shape else Sum(rest, shape))
    return add(left, scale(MINUS, right), shape)


def _terms(node: Node) -> tuple[Node, ...]:
    return node.terms if isinstance(node, Sum) else (node,)


def _is_zero(node: Node) -> bool:
    return isinstance(node, Number) and node.value == 0


def product_of(node: Node) -> Product:
    """Any node as a product."""
    if isinstance(node, Product):
        return node
    if isinstance(node, Number):
        return Product(node.value, (), (), node.shape)
    return Product(Fraction(1), (node,), (), node.shape)


def finished(product: Product) -> Node:
    """A product in its simplest form."""
    if product.coefficient == 0:
        return Number(Fraction(0), product.shape)
    if product.below:
        return product
    if not product.factors:
        return Number(product.coefficient, product.shape)
    if product.coefficient == 1 and len(product.factors) == 1 and product.factors[0].shape == product.shape:
        return product.factors[0]
    return product


def scale(factor: Fraction, node: Node) -> Node:
    """A number times a node."""
    product = product_of(node)
    return finished(replace(product, coefficient=factor * product.coefficient))


def multiply(left: Node, right: Node, shape: Shape) -> Node:
    """Element by element, or by a scalar."""
    one, other = product_of(left), product_of(right)
    if not is_scalar(left) and not is_scalar(right):
        if _mixes(one) and not _mixes(other):
            one, other = other, one  # a factor of a matrix-vector product precedes the matrix
        elif _mixes(one):
            one = _bracketed(one)
        if _mixes(other) and _others(other.below):
            other = _bracketed(other)
    return _chain(one, other, shape)


def matrix_multiply(left: Node, right: Node, shape: Shape) -> Node:
    """A matrix times a matrix or a column."""
    one, other = product_of(left), product_of(right)
    # an elementwise divisor applies to its own factor only
    one, other = (_bracketed(side) if _others(side.below) else side for side in (one, other))
    return _chain(one, other, shape)


def divide(left: Node, right: Node, shape: Shape) -> Node:
    """Element by element, or by a scalar."""
    one, other = product_of(left), product_of(right)
    if _mixes(other):
        other = _bracketed(other)
    if not is_scalar(right) and _mixes(one):
        one = _bracketed(one)
    coefficient = one.coefficient / other.coefficient
    return finished(Product(coefficient, (*one.factors, *other.below), (*one.below, *other.factors), shape))


def _bracketed(product: Product) -> Product:
    """The product as one factor in brackets, its coefficient in front."""
    inner = replace(product, coefficient=Fraction(1))
    return Product(product.coefficient, (inner,), (), product.shape)


def transpose(node: Node) -> Node:
    """The transpose; a symmetric node or a number is unchanged."""
    if is_scalar(node) or isinstance(node, Diagonal | Identity):
        return node
    shape = (node.shape[1], node.shape[0])
    match node:
        case Transposed(of):
            return of
        case Number(value):
            return Number(value, shape)
        case Stack(rows):
            columns = zip(*rows, strict=True)
            return Stack(tuple(tuple(transpose(item) for item in column) for column in columns), shape)
        case Product(coefficient, factors, below) if any(map(is_scalar, factors + below)) or coefficient != 1:
            rest = finished(Product(Fraction(1), _others(factors), _others(below), node.shape))
            outer = Product(coefficient, (*_only(factors), transpose(rest)), _only(below), shape)
            return finished(outer)
        case _:
            return Transposed(node, shape)


def dot(left: Node, right: Node) -> Node:
    """The scalar product of two columns."""
    if left == right:
        return Norm(left, squared=True)
    return matrix_multiply(transpose(left), right, SCALAR)


def diagonal(node: Node) -> Node:
    """The diagonal matrix of a column."""
    size = node.shape[0]
    product = product_of(node)
    if not product.factors and not product.below:
        return scale(product.coefficient, Identity((size, size)))
    return Diagonal(node, (size, size))


def _chain(one: Product, other: Product, shape: Shape) -> Node:
    """Both products as one; a scalar product a'b comes last or is in brackets."""
    if _made_of_vectors(one):
        if all(map(is_scalar, other.factors)) and not _made_of_vectors(other):
            one, other = other, one
        else:
            one = _bracketed(one)
    if _made_of_vectors(other) and not is_scalar(one):
        one, other = _bracketed(other), one
    factors = (*one.factors, *other.factors)
    return finished(Product(one.coefficient * other.coefficient, factors, (*one.below, *other.below), shape))


def _made_of_vectors(product: Product) -> bool:
    return is_scalar(product) and not all(map(is_scalar, product.factors))


def _mixes(product: Product) -> bool:
    """True if it contains a matrix, which mixes the elements of the factors to its right."""
    return any(not is_column(factor) for factor in product.factors)


def _only(nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    return tuple(node for node in nodes if is_scalar(node))


def _others(nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    return tuple(node for node in nodes if not is_scalar(node))
