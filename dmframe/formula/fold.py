"""Replace sub-formulas that are outputs of the block by the names of the outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Final

from dmframe.formula import tree
from dmframe.formula.tree import Identity, Name, Node, Number, Piece, Product, Stack, Sum, Unprinted

_PLAIN: Final = (Name, Number, Identity, Piece, Stack, Unprinted)
"""Nodes that are not replaced: short ones, and ones that are more informative than a name."""


def folded(node: Node, names: Mapping[Node, Name], own: str = "") -> Node:
    """The formula with every part that has a name replaced by the name; `own` is the name of the formula itself."""
    if not names:
        return node
    if node in names and names[node].name != own:
        return names[node]
    if isinstance(node, Product | Sum):  # before and after its parts are replaced
        node = _product(node, names, own) if isinstance(node, Product) else _sum(node, names, own)
    inside: Any = {field.name: _within(getattr(node, field.name), names) for field in fields(node)}
    match replace(node, **inside):
        case Product() as product:
            return _product(product, names, own)
        case Sum() as total:
            return _sum(total, names, own)
        case other:
            return other


def _within(item: Any, names: Mapping[Node, Name]) -> Any:
    if isinstance(item, tuple):
        return tuple(_within(part, names) for part in item)
    return folded(item, names) if isinstance(item, Node) else item


def _product(product: Product, names: Mapping[Node, Name], own: str) -> Node:
    """A product that ends with a known one: products are evaluated from right to left, so the end is a result."""
    for known, name in names.items():
        if isinstance(known, Product) and name.name != own and known.coefficient == 1 and not known.below:
            count = len(known.factors)
            if product.factors[-count:] == known.factors:
                return tree.finished(replace(product, factors=(*product.factors[:-count], name)))
    return product


def _sum(total: Sum, names: Mapping[Node, Name], own: str) -> Node:
    """A sum that begins with a known one."""
    for known, name in names.items():
        if isinstance(known, Sum) and name.name != own:
            count = len(known.terms)
            if count < len(total.terms) and total.terms[:count] == known.terms:
                return replace(total, terms=(name, *total.terms[count:]))
    return total


def is_difference(node: Node) -> bool:
    """True for one name minus another, an error."""
    if not isinstance(node, Sum) or len(node.terms) != 2:
        return False
    first, second = node.terms
    return isinstance(first, Name) and isinstance(tree.scale(tree.MINUS, second), Name)


def names_of(outputs: Mapping[str, Node], taken: Mapping[str, str]) -> dict[Node, Name]:
    """The formulas of outputs that may be replaced by their names; the first of equal ones."""
    found = dict[Node, Name]()
    for name, node in outputs.items():
        short = isinstance(node, _PLAIN) or (isinstance(node, Product) and len(node.factors) < 2 and not node.below)
        if name not in taken and not short:
            found.setdefault(node, Name(name, node.shape))
    return found
