"""Convert a CasADi MX expression to the tree of a formula, with the structure of the code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from inspect import unwrap
from typing import Any, Final, final

import casadi as ca

from dmframe.block.linalg import solve_spd
from dmframe.block.naming import operation_of
from dmframe.block.terms import norm
from dmframe.formula import tree
from dmframe.formula.robot import written as robot_call
from dmframe.formula.tree import (
    SCALAR,
    Applied,
    Choice,
    Derivative,
    Identity,
    Inverse,
    Name,
    Node,
    Norm,
    Number,
    Piece,
    Power,
    Relation,
    Shape,
    Stack,
    Transposed,
)


@final
class UnreadableError(Exception):
    """An expression with an operation that has no printed symbol."""


MOST: Final = 250
"""Largest number of nodes of a printed formula."""

FUNCTIONS: Final[Mapping[int, str]] = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIGN: "sgn",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_ATAN2: "atan2",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMOD: "mod",
}
RELATIONS: Final[Mapping[int, str]] = {
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "=",
    ca.OP_NE: "!=",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
}
MULTIPLE: Final[Mapping[int, Fraction]] = {ca.OP_NEG: Fraction(-1), ca.OP_TWICE: Fraction(2)}
_SAME: Final = (ca.OP_PROJECT, ca.OP_ASSIGN)


def read(expression: Any) -> Node:
    """The tree of an expression. Raises `UnreadableError`."""
    try:
        return _Reader().node(expression)
    except RecursionError:
        raise UnreadableError("nested too deeply to be printed") from None


@final
class _Reader:
    """Reads one expression and counts its nodes."""

    def __init__(self) -> None:
        self._count = 0

    def node(self, x: Any) -> Node:
        """The tree of a part."""
        self._count += 1
        if self._count > MOST:
            raise UnreadableError("too long to be printed")
        if x.is_symbolic():
            return Name(x.name(), x.shape)
        if x.is_constant():
            return constant(x.to_DM())
        if x.is_output():
            return self._output(x)
        return self._operation(x)

    def _operation(self, x: Any) -> Node:
        kind, shape = x.op(), x.shape
        if kind in _SAME:
            return self.node(x.dep(0))
        if kind in MULTIPLE:
            return tree.scale(MULTIPLE[kind], self.node(x.dep(0)))
        if kind in FUNCTIONS:
            return Applied(FUNCTIONS[kind], tuple(self.node(x.dep(k)) for k in range(x.n_dep())), shape)
        if kind in RELATIONS:
            return relation(RELATIONS[kind], self.node(x.dep(0)), self.node(x.dep(1)), shape)
        if kind in _RULES:
            return _RULES[kind](self, x, shape)
        raise UnreadableError(f"it contains an operation without a printed symbol: {x}")

    def _output(self, x: Any) -> Node:
        of = x.dep(0)
        if of.op() == ca.OP_VERTSPLIT:
            start, stop = of.info()["offset"][x.which_output() : x.which_output() + 2]
            inner = self.node(of.dep(0))
            return Piece(inner, (start, stop), None if of.dep(0).is_column() else (0, x.shape[1]), x.shape)
        if of.op() == ca.OP_HORZSPLIT:
            rows, inner = x.shape[0], self.node(of.dep(0))
            start, stop = (end // rows for end in of.info()["offset"][x.which_output() : x.which_output() + 2])
            if isinstance(inner, Transposed):  # rows of a matrix, as vertsplit gives them
                return tree.transpose(Piece(inner.of, (start, stop), (0, rows), (stop - start, rows)))
            return Piece(inner, (0, rows), (start, stop), x.shape)
        if not of.is_call():
            raise UnreadableError(f"it contains an operation without a printed symbol: {of}")
        called = operation_of(of.which_function())
        if called is None:
            raise UnreadableError(f"it calls {of.which_function().name()}, which is not an operation")
        if (
            called.sign == "derivative" and called.function is None
        ):  # numerator and denominator of the derivative; the third argument is its value
            return Derivative(self.node(of.dep(0)), self.node(of.dep(1)), x.shape)
        arguments = [self.node(of.dep(k)) for k in range(of.n_dep())]
        if called.given:
            return robot_call(called, arguments, x.shape)
        if called.function in _SIGNS:
            return _SIGNS[called.function](arguments, x.shape)
        return Applied(called.sign, tuple(arguments), x.shape, description=called.description)

    def add(self, x: Any, shape: Shape) -> Node:
        """A + b, and the two halves of if_else."""
        if x.dep(0).op() == x.dep(1).op() == ca.OP_IF_ELSE_ZERO:
            yes, no = x.dep(0), x.dep(1)
            if no.dep(0).op() == ca.OP_NOT and ca.is_equal(no.dep(0).dep(0), yes.dep(0), 100):
                return Choice(self.node(yes.dep(0)), self.node(yes.dep(1)), self.node(no.dep(1)), shape)
        return tree.add(self.node(x.dep(0)), self.node(x.dep(1)), shape)

    def elementwise(self, x: Any, shape: Shape) -> Node:
        """A * b."""
        left, right = self.node(x.dep(0)), self.node(x.dep(1))
        if not tree.is_scalar(left) and not tree.is_scalar(right) and not tree.is_column(left):
            return Applied("hadamard", (left, right), shape)
        return tree.multiply(left, right, shape)

    def matrix_product(self, x: Any, shape: Shape) -> Node:
        """C + a @ b."""
        base, left, right = (x.dep(k) for k in range(3))
        if left.is_constant() and shape == SCALAR and left.shape[0] == 1 and left.to_DM().is_one():
            product: Node = Applied("sum", (self.node(right),), shape)
        else:
            product = tree.matrix_multiply(self.node(left), self.node(right), shape)
        return tree.add(self.node(base), product, shape)

    def reshape(self, x: Any, shape: Shape) -> Node:
        """A transposed column; the stacked columns of a matrix."""
        of = x.dep(0)
        if of.shape == shape:
            return self.node(of)
        if (of.is_column() and x.is_row()) or (of.is_row() and x.is_column()):
            return tree.transpose(self.node(of))
        if x.is_column():
            return Applied("vec", (self.node(of),), shape)
        raise UnreadableError("it reshapes a matrix")

    def cast(self, x: Any, shape: Shape) -> Node:
        """A column on a diagonal."""
        of = x.dep(0)
        if shape[0] == shape[1] == of.shape[0] and of.is_column() and x.sparsity() == ca.Sparsity.diag(shape[0]):
            return tree.diagonal(self.node(of))
        raise UnreadableError("it distributes elements over a matrix")

    def nonzeros(self, x: Any, shape: Shape) -> Node:
        """Elements of a column or a matrix."""
        of, chosen = x.dep(0), x.info()
        if of.is_scalar():  # one number, as often as needed
            diagonal = shape[0] == shape[1] and x.sparsity() == ca.Sparsity.diag(shape[0])
            if not diagonal and not x.is_dense():
                raise UnreadableError("it distributes elements over a matrix")
            inner = self.node(of)
            return (
                tree.multiply(inner, Identity(shape), shape) if diagonal else tree.multiply(inner, _ones(shape), shape)
            )
        if not of.is_dense() or not x.is_dense() or "slice" not in chosen or chosen["slice"]["step"] != 1:
            raise UnreadableError("it selects elements that are not adjacent")
        start, stop, rows = chosen["slice"]["start"], chosen["slice"]["stop"], of.shape[0]
        inner = self.node(of)
        if of.is_column() and x.is_column():
            return Piece(inner, (start, stop), None, shape)
        if start % rows == stop % rows == 0 and shape[0] == rows:
            return Piece(inner, (0, rows), (start // rows, stop // rows), shape)
        if stop - start == 1:
            return Piece(inner, (start % rows, start % rows + 1), (start // rows, start // rows + 1), shape)
        raise UnreadableError("it selects elements that are not adjacent")

    def stacked(self, x: Any, shape: Shape) -> Node:
        """Vertically stacked blocks."""
        return Stack(tuple((self.node(x.dep(k)),) for k in range(x.n_dep())), shape)

    def side_by_side(self, x: Any, shape: Shape) -> Node:
        """Horizontally stacked blocks; blockcat makes them from transposes."""
        parts = [self.node(x.dep(k)) for k in range(x.n_dep())]
        heights = {len(part.rows) if isinstance(part, Stack) else 0 for part in parts}
        if len(heights) == 1 and heights != {0}:
            rows = zip(*(part.rows for part in parts if isinstance(part, Stack)), strict=True)
            return Stack(tuple(tuple(item for row in pieces for item in row) for pieces in rows), shape)
        return Stack((tuple(parts),), shape)

    def power(self, x: Any, shape: Shape) -> Node:
        """a^b of a number b."""
        exponent = self.node(x.dep(1))
        if not isinstance(exponent, Number):
            raise UnreadableError("it contains a power whose exponent is not a number")
        return Power(self.node(x.dep(0)), exponent.value, shape)

    def solution(self, x: Any, shape: Shape) -> Node:
        """The solution of a linear system, or an inverse."""
        matrix = self.node(x.dep(1))
        if x.info()["tr"]:
            matrix = tree.transpose(matrix)
        return _solved([matrix, self.node(x.dep(0))], shape)


def relation(sign: str, left: Node, right: Node, shape: Shape) -> Node:
    """A relation; CasADi represents a > 0 as 0 < a."""
    if isinstance(left, Number) and sign in ("<", "<="):
        return Relation(sign.replace("<", ">"), right, left, shape)
    return Relation(sign, left, right, shape)


def _solved(arguments: list[Node], shape: Shape) -> Node:
    matrix, right = arguments
    inverse = Inverse(matrix, matrix.shape)
    if tree.is_scalar(matrix):
        return tree.divide(right, matrix, shape)
    return inverse if isinstance(right, Identity) else tree.matrix_multiply(inverse, right, shape)


def _ones(shape: Shape) -> Node:
    return Number(Fraction(1), shape)


def constant(value: Any) -> Node:
    """Numbers: a uniform matrix, the identity, or all elements."""
    shape = value.shape
    dense = ca.densify(value)
    if dense.numel() == 0:
        raise UnreadableError("it contains an empty matrix")
    first = _fraction(float(dense[0, 0]))
    if all(float(item) == float(dense[0, 0]) for item in dense.nonzeros()):
        return Number(first, shape)
    if shape[0] == shape[1] and ca.DM(dense - dense[0, 0] * ca.DM.eye(shape[0])).is_zero():
        return tree.scale(first, Identity(shape))
    if dense.numel() > 16:
        raise UnreadableError("it contains a large numeric matrix")
    rows = ca.vertsplit(dense)
    return Stack(tuple(tuple(Number(_fraction(float(x))) for x in row.nonzeros()) for row in rows), shape)


def _fraction(value: float) -> Fraction:
    """The intended number: the shortest decimal or small fraction with this value."""
    if not math.isfinite(value):
        raise UnreadableError("it contains a number that is not finite")
    small = Fraction(value).limit_denominator(1000)
    return small if float(small) == value else Fraction(repr(value))


Rule = Callable[[_Reader, Any, Shape], Node]

_RULES: Final[Mapping[int, Rule]] = {
    ca.OP_ADD: _Reader.add,
    ca.OP_SUB: lambda self, x, shape: tree.subtract(self.node(x.dep(0)), self.node(x.dep(1)), shape),
    ca.OP_MUL: _Reader.elementwise,
    ca.OP_DIV: lambda self, x, shape: tree.divide(self.node(x.dep(0)), self.node(x.dep(1)), shape),
    ca.OP_INV: lambda self, x, shape: tree.divide(Number(Fraction(1)), self.node(x.dep(0)), shape),
    ca.OP_SQ: lambda self, x, shape: Power(self.node(x.dep(0)), Fraction(2), shape),
    ca.OP_CONSTPOW: _Reader.power,
    ca.OP_POW: _Reader.power,
    ca.OP_FABS: lambda self, x, shape: Applied("abs", (self.node(x.dep(0)),), shape),
    ca.OP_NOT: lambda self, x, shape: Relation("not", self.node(x.dep(0)), None, shape),
    ca.OP_IF_ELSE_ZERO: lambda self, x, shape: Choice(
        self.node(x.dep(0)), self.node(x.dep(1)), Number(Fraction(0)), shape
    ),
    ca.OP_MTIMES: _Reader.matrix_product,
    ca.OP_TRANSPOSE: lambda self, x, shape: tree.transpose(self.node(x.dep(0))),
    ca.OP_RESHAPE: _Reader.reshape,
    ca.OP_SPARSITY_CAST: _Reader.cast,
    ca.OP_GETNONZEROS: _Reader.nonzeros,
    ca.OP_VERTCAT: _Reader.stacked,
    ca.OP_HORZCAT: _Reader.side_by_side,
    ca.OP_DOT: lambda self, x, shape: tree.dot(self.node(x.dep(0)), self.node(x.dep(1))),
    ca.OP_NORMF: lambda self, x, shape: Norm(self.node(x.dep(0))),
    ca.OP_NORM2: lambda self, x, shape: Norm(self.node(x.dep(0))),
    ca.OP_BILIN: lambda self, x, shape: tree.dot(
        self.node(x.dep(1)),
        tree.matrix_multiply(self.node(x.dep(0)), self.node(x.dep(2)), x.dep(1).shape),
    ),
    ca.OP_SOLVE: _Reader.solution,
    ca.OP_INVERSE: lambda self, x, shape: Inverse(self.node(x.dep(0)), shape),
}

_SIGNS: Final[Mapping[Callable[..., Any] | None, Callable[[list[Node], Shape], Node]]] = {
    unwrap(solve_spd): _solved,
    unwrap(norm): lambda arguments, shape: Norm(arguments[0]),
}
"""Operations with their own symbol, by the function itself; all others print as functions, ``clip(a, v)``."""
