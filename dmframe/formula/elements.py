"""Formulas element by element from scalar expressions, for blocks that cannot be read as matrices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.formula import tree
from dmframe.formula.read import FUNCTIONS, MOST, MULTIPLE, RELATIONS, UnreadableError, constant, relation
from dmframe.formula.tree import SCALAR, Applied, Name, Node, Number, Piece, Power, Relation, Stack, Unprinted
from dmframe.program import by_code

FEW: Final = 16
"""Largest number of elements of a matrix that is printed completely."""


@final
class Elements:
    """Reads scalar expressions of the elements of named columns or matrices of symbols."""

    def __init__(self, symbols: Mapping[str, SX]) -> None:
        self._symbols, self._count = symbols, 0

    @cached_property
    def _known(self) -> dict[int, Node]:
        known = dict[int, Node]()
        for name, symbol in self._symbols.items():
            whole = Name(name, symbol.shape)
            rows = symbol.shape[0]
            for place, element in enumerate(symbol.nonzeros()):
                row, column = place % rows, place // rows
                columns = None if symbol.is_column() else (column, column + 1)
                one = whole if symbol.is_scalar() else Piece(whole, (row, row + 1), columns, SCALAR)
                known[element.element_hash()] = one
        return known

    def read(self, expression: SX) -> Node:
        """The tree of an expression; an expression that is too long, or empty, is given by its symbols."""
        self._count = 0
        try:
            if expression.is_constant():
                return constant(ca.DM(expression))
            if expression.numel() > FEW:
                raise UnreadableError("too many elements")
            rows = [ca.horzsplit(row) for row in ca.vertsplit(ca.densify(expression))]
            written = tuple(tuple(self._scalar(item) for item in row) for row in rows)
        except UnreadableError:
            return self.unprinted(expression)
        if expression.is_scalar():
            return written[0][0]
        return lifted(written, expression.shape) or Stack(written, expression.shape)

    def unprinted(self, expression: SX) -> Node:
        """The names on which an expression depends."""
        used = dict[str, None]()
        for symbol in ca.symvar(expression):
            known = self._known.get(symbol.element_hash())
            whole = known.of if isinstance(known, Piece) else known
            if isinstance(whole, Name):
                used[whole.name] = None
        return Unprinted(tuple(used), expression.shape)

    def _scalar(self, x: SX) -> Node:
        self._count += 1
        if self._count > MOST:
            raise UnreadableError("too long to be printed")
        if x.is_constant():
            return constant(ca.DM(x))
        if x.is_symbolic():
            if x.element_hash() not in self._known:  # a number of the robot
                raise UnreadableError("it contains a symbol without a name")
            return self._known[x.element_hash()]
        parts = [self._scalar(x.dep(k)) for k in range(x.n_dep())]
        if x.op() not in RULES:
            raise UnreadableError("it contains an operation without a printed symbol")
        return RULES[x.op()](*parts)


def _applied(sign: str, *parts: Node) -> Node:
    return Applied(sign, parts, SCALAR)


def _related(sign: str, left: Node, right: Node) -> Node:
    return relation(sign, left, right, SCALAR)


RULES: Final[dict[int, Callable[..., Node]]] = {
    **{code: partial(tree.scale, factor) for code, factor in MULTIPLE.items()},
    **{code: partial(_applied, sign) for code, sign in FUNCTIONS.items()},
    **{code: partial(_related, sign) for code, sign in RELATIONS.items()},
    **by_code(
        {
            "add": lambda left, right: tree.add(left, right, SCALAR),
            "sub": lambda left, right: tree.subtract(left, right, SCALAR),
            "mul": lambda left, right: tree.multiply(left, right, SCALAR),
            "div": lambda left, right: tree.divide(left, right, SCALAR),
            "inv": lambda x: tree.divide(Number(Fraction(1)), x, SCALAR),
            "sq": lambda x: Power(x, Fraction(2), SCALAR),
            "fabs": partial(_applied, "abs"),
            "not": lambda x: Relation("not", x, None, SCALAR),
        }
    ),
}


def lifted(rows: tuple[tuple[Node, ...], ...], shape: tree.Shape) -> Node | None:
    """One formula for all elements of a column if they differ only in the index of the element; else None."""
    if shape[1] != 1:
        return None
    wholes = {_without(row[0], place) for place, row in enumerate(rows)}
    found = wholes.pop() if len(wholes) == 1 else None
    return replace(found, shape=shape) if found is not None else None


def _without(node: Any, place: int) -> Any:
    """The node with elements at this index replaced by the whole columns."""
    if isinstance(node, Piece) and node.columns is None and node.rows == (place, place + 1):
        return node.of
    if isinstance(node, tuple):
        return tuple(_without(item, place) for item in node)
    if is_dataclass(node) and not isinstance(node, type):
        inner = {item.name: _without(getattr(node, item.name), place) for item in fields(node) if item.name != "shape"}
        return replace(node, **inner)
    return node
