"""The printed name of a condition: its author's words, followed by the decided expression unless the words state it."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from typing import Any, Final

import casadi as ca

from dmframe.certificate import SX
from dmframe.certify.claim import Claim
from dmframe.condition import Inequality
from dmframe.diagram.view import view
from dmframe.errors import DmframeError
from dmframe.exact import zero_test
from dmframe.formula.elements import Elements
from dmframe.formula.formula import Formula
from dmframe.formula.read import UnreadableError
from dmframe.naming import Naming, expression_of, reading

SHORT: Final = 40
"""Length up to which an expression is printed after a name."""


def _decided(claim: Claim, block: str, condition: Inequality) -> str:
    """``k + 10 > 0``: what is decided, printed from the expression; a parameter of another block with its block."""
    symbols = {item.label: item.symbol for item in claim.loop.parameters}
    symbols |= {item.label: item.symbol for item in (*claim.loop.plant, *claim.loop.controller)}
    elements = Elements({label.removeprefix(f"{block}."): symbol for label, symbol in symbols.items()})
    (joined,) = claim.loop.joined([ca.SX(condition.expression)])
    try:
        text = Formula(elements.read(joined)).text if joined.numel() else "nothing"
    except (UnreadableError, OverflowError, ValueError):  # many numbers, or one that is not finite
        text = ""
    if not 0 < len(text) <= SHORT:
        text = Formula(elements.unprinted(joined)).text
    return f"{text} {_sign(condition)} 0"


def worded(claim: Claim, block: str, condition: Inequality) -> tuple[str, str]:
    """The name, and what is decided: the author's words alone where they state it, else followed by it."""
    if _says(claim, block, condition):
        return condition.name, condition.name
    text = _decided(claim, block, condition)
    return f"{condition.name} [{text}]", text


def _sign(condition: Inequality) -> str:
    return ">" if condition.strict else ">="


_RELATION: Final = re.compile(r"([\w\s.+*/()-]+?)\s*(<=|>=|<|>)\s*([\w\s.+*/()-]+)")
_ADJACENT: Final = re.compile(r"(?<=[\w)])\s+(?=[\w(])")
_UNCLEAR: Final = re.compile(r"/\s*[\w.]+\s+[\w(]")
"""``a / 2 b`` may be read in two ways."""


def _says(claim: Claim, block: str, condition: Inequality) -> bool:
    """True where the author's words are this very inequality, in parameters, truths and named parts of the block."""
    found = _RELATION.fullmatch(condition.name)
    if found is None or _UNCLEAR.search(condition.name):
        return False
    left, sign, right = found.groups()
    if sign.startswith("<"):
        left, right = right, left
    if sign.replace("<", ">") != _sign(condition):
        return False
    try:
        known = _known(claim, block)
        sides = [
            _value(ast.parse(_ADJACENT.sub(" * ", side.strip()), mode="eval").body, known) for side in (left, right)
        ]
        difference = sides[0] - sides[1] - ca.SX(condition.expression)
        if difference.shape != ca.SX(condition.expression).shape or not difference.numel():
            return False
        symbols = ca.vertcat(*ca.symvar(difference))
        return bool(zero_test(ca.Function("words", [symbols], [ca.densify(difference)]), trials=1).zero)
    except (SyntaxError, KeyError, RuntimeError, OverflowError, ValueError, DmframeError):
        return False


def _known(claim: Claim, block: str) -> Mapping[str, SX]:
    """What the words of a block may name: its parameters, its truths, and the parts that its certificate names."""
    seen = view(claim.diagram, block, claim.truths)
    naming = Naming(lambda name, shape: ca.SX.sym(name, *shape), {})
    with reading(naming):
        claim.diagram.blocks[block].composed_certificate(seen.u, seen.x, seen.p, seen.truth)
    known = {name: getattr(part, name) for part in (seen.truth, seen.p) for name in part if name != "robot"}
    for name in set(seen.truth) & set(seen.p):  # which of the two is meant?
        del known[name]
    for name, (_, meaning) in naming.definitions.items():
        whole = ca.SX(expression_of(meaning))
        for symbol, other in reversed(naming.definitions.values()):
            whole = ca.substitute(whole, symbol, ca.SX(expression_of(other)))
        known[name] = whole
    return known


def _value(node: ast.expr, known: Mapping[str, SX]) -> Any:
    """A sum, product or quotient of names and numbers. Raises `KeyError` for all else."""
    match node:
        case ast.Constant(int() | float() as number):
            return ca.SX(number)
        case ast.Name(name):
            return known[name]
        case ast.UnaryOp(ast.USub(), operand):
            return -_value(operand, known)
        case ast.BinOp(left, operator, right):
            one, other = _value(left, known), _value(right, known)
            match operator:
                case ast.Add():
                    return one + other
                case ast.Sub():
                    return one - other
                case ast.Mult():
                    return one * other
                case ast.Div():
                    return one / other
    raise KeyError(ast.dump(node))
