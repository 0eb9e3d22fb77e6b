"""The printed name of a condition: its author's words, followed by the decided relation unless the words are it."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.condition import Inequality
from dmframe.block.naming import Naming, reading
from dmframe.certify.claim import Claim
from dmframe.common.text import Text, text_of
from dmframe.diagram import Diagram
from dmframe.diagram.truths import Stated
from dmframe.diagram.view import view
from dmframe.formula import Formula, tree
from dmframe.formula.elements import Elements
from dmframe.formula.read import UnreadableError
from dmframe.formula.tree import SCALAR, Node, Number, Relation, Sum

SHORT: Final = 40
"""Length up to which an expression is printed after a name."""


def worded(claim: Claim, block: str, condition: Inequality) -> tuple[Text, Text]:
    """The name, and what is decided."""
    own = relation(claim.diagram, claim.truths, block, condition)
    if own is not None:
        return own, own
    decided = _decided(claim, block, condition)
    return Text(text_of(condition.name), " [", decided, "]"), decided


def relation(diagram: Diagram, truths: Stated, block: str, condition: Inequality) -> Text | None:
    """The author's words as a formula, where they are exactly the relation."""
    found = _in_names_of(diagram, truths, block, condition)
    return next((Text(own) for own in found if own.text == condition.name), None)


def _decided(claim: Claim, block: str, condition: Inequality) -> Text:
    """``k + 10 > 0``: what is decided, printed from the expression; a parameter of another block with its block."""
    symbols = {item.label: item.symbol for item in claim.loop.parameters}
    symbols |= {item.label: item.symbol for item in (*claim.loop.plant, *claim.loop.controller)}
    elements = Elements({label.removeprefix(f"{block}."): symbol for label, symbol in symbols.items()})
    (joined,) = claim.loop.joined([ca.SX(condition.expression)])
    sign = f" {_sign(condition)} 0"
    if not joined.numel():
        return Text("nothing", sign)
    formula = _read(elements, joined)
    if formula is None or len(formula.text) > SHORT:
        formula = Formula(elements.unprinted(joined))
    return Text(formula, sign)


def _in_names_of(diagram: Diagram, truths: Stated, block: str, condition: Inequality) -> tuple[Formula, ...]:
    """``beta > 4 gamma/9`` and ``4 gamma/9 < beta``: the same in names of the block's parameters, truths and parts.

    A named part is one of the certificate; another one would have no definition in print.
    """
    seen, own = view(diagram, block, truths), diagram.blocks[block]
    naming = Naming(lambda name, shape: ca.SX.sym(name, *shape), {})
    with reading(naming):
        own.composed_certificate(seen.u, seen.x, seen.p, seen.truth)
        names: dict[str, SX] = {name: symbol for name, (symbol, _) in naming.definitions.items()}
        stated = own.composed_conditions(seen.p, seen.truth)
    same = (item for item in stated if isinstance(item, Inequality) and item.name == condition.name)
    expression = next((ca.SX(item.expression) for item in same), None)
    if naming.again or expression is None or not expression.numel():
        return ()
    given = {name: ca.SX(getattr(part, name)) for part in (seen.p, seen.truth) for name in part if name != "robot"}
    once = {name: x for name, x in given.items() if not (name in seen.p and name in seen.truth)}
    formula = _read(Elements(_symbols(once) | names), expression)
    return () if formula is None else _related(formula.node, _sign(condition))


def _symbols(given: Mapping[str, SX]) -> dict[str, SX]:
    return {name: x for name, x in given.items() if all(element.is_symbolic() for element in x.nonzeros())}


def _read(elements: Elements, expression: SX) -> Formula | None:
    try:
        return Formula(elements.read(expression))
    except (UnreadableError, OverflowError, ValueError):  # many numbers, or one that is not finite
        return None


def _related(node: Node, sign: str) -> tuple[Formula, ...]:
    """Terms below zero on the other side."""
    sides: list[Node] = [Number(Fraction(0)), Number(Fraction(0))]
    for term in node.terms if isinstance(node, Sum) else (node,):
        below = tree.product_of(term).coefficient < 0
        sides[below] = tree.add(sides[below], tree.scale(tree.MINUS, term) if below else term, node.shape)
    left, right = sides
    mirrored = Relation(sign.replace(">", "<"), right, left, SCALAR)
    return Formula(Relation(sign, left, right, SCALAR)), Formula(mirrored)


def _sign(condition: Inequality) -> str:
    return ">" if condition.strict else ">="
