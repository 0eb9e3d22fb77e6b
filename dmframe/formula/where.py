"""Explanations of the operations and conventions in printed laws."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from typing import Any, Final

from dmframe.common.names import unicode_name
from dmframe.formula import tree
from dmframe.formula.dialects import UNICODE
from dmframe.formula.law import Line
from dmframe.formula.reading import GIVEN, START
from dmframe.formula.robot import MEANINGS
from dmframe.formula.tree import Applied, Derivative, Diagonal, Name, Node, Norm, Piece, Product, Stack

_SUMMED: Final = "the sum of the elements of a"


def where(lines: Iterable[Line]) -> tuple[tuple[str, str], ...]:
    """Each operation, quantity of the robot and convention that the lines use, with its meaning."""
    found = dict[str, str]()
    for line in lines:
        for node in _nodes(line.right.node):
            for sign, text in _descriptions(node):
                found.setdefault(sign, text)
    return tuple(sorted(found.items(), key=lambda item: item[0] in _CONVENTIONS))


def sizes_show(lines: Iterable[Line]) -> bool:
    """True if the lines contain an index that depends on the robot's size."""
    return any(isinstance(node, Piece) for line in lines for node in _nodes(line.right.node))


_ELEMENT, _ROW, _PIECE = "a_i", "a_(i,:)", "a_(i…j)"
_BLOCKS, _COLUMNS, _WEIGHTED, _DIAGONAL = "[a, b; …]", "(a, b)", "|a|²_W", "K a"
_CONVENTIONS: Final = (_ELEMENT, _ROW, _PIECE, _BLOCKS, _COLUMNS, _WEIGHTED, _DIAGONAL)
"""Conventions, which are listed last."""


def _descriptions(node: Node) -> Iterator[tuple[str, str]]:
    match node:
        case Applied(function, _, _, symbol, description) if description is not None:
            names = tuple(Name(name) for name in description[0])
            yield UNICODE.write(Applied(function, names, node.shape, symbol)), _unicode(description[1])
        case Applied("sum"):
            yield "sum(a)", _SUMMED
        case Applied("vec"):
            yield "vec(A)", "the stacked columns of A"
        case Applied("hadamard"):
            yield "A .* B", "the elementwise product"
        case Name(name) if name in MEANINGS:
            yield unicode_name(name), MEANINGS[name]
        case Name(name) if name.endswith(START):
            bare = unicode_name(name.removesuffix(START))
            yield unicode_name(name), f"the initial value of {bare}, the parameter of its name"
        case Name(name) if name.endswith(GIVEN):
            yield unicode_name(name), f"the parameter {name.removesuffix(GIVEN)}"
        case Applied("floor"):
            yield "floor(a)", "the largest integer not greater than a"
        case Derivative():
            yield "∂a/∂q", "the Jacobian: a row for each element of a, a column for each of q"
        case Piece(_, rows, columns):
            if all(stop - start == 1 for start, stop in (rows, columns or rows)):
                yield _ELEMENT, "element i of a, counted from 1"
            elif rows[1] - rows[0] == 1:
                yield _ROW, "row i of a, counted from 1"
            else:
                yield _PIECE, "elements i to j of a, of a matrix rows or columns, counted from 1, both ends included"
        case Stack(rows) if len(rows[0]) > 1:
            yield _BLOCKS, "blocks of a matrix side by side; a semicolon begins the next row"
        case Stack():
            yield _COLUMNS, "stacked columns"
        case Norm(_, True, weight) if weight is not None:
            yield _WEIGHTED, "aᵀ W a; a column W means diag(W)"
        case Product(_, factors) if any(map(_scales, _vectors(factors)[:-1])):
            yield _DIAGONAL, "diag(K) a if K is a column: products are evaluated from right to left"
        case _:
            return


def _vectors(factors: Sequence[Node]) -> list[Node]:
    return [node for node in factors if not tree.is_scalar(node)]


def _scales(node: Node) -> bool:
    return isinstance(node, Diagonal) or tree.is_column(node)


def _nodes(node: Any) -> Iterator[Node]:
    """A tree's nodes, from left to right."""
    if isinstance(node, tuple):
        for item in node:
            yield from _nodes(item)
    elif isinstance(node, Node):
        yield node
        for item in fields(node):
            yield from _nodes(getattr(node, item.name))


def _unicode(text: str) -> str:
    """The first line of a docstring as a part of a sentence, names between backticks as symbols."""
    text = text[:1].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text
    return re.sub(r"`(\w+)`", lambda found: unicode_name(found[1]), text).rstrip(".")
