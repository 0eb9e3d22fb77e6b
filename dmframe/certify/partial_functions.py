"""Instructions that do not give a number everywhere: divisions, and functions that are not defined everywhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.certify.sign import SIGNED, Sign, sign_after
from dmframe.program import DIVISIONS, OPERATIONS, POWERS, TO_READ, read


def instructions(expressions: Iterable[SX]) -> Iterator[tuple[SX, list[SX]]]:
    """Each instruction of expressions once, with its operands."""
    todo = [element for item in expressions for element in ca.vertsplit(ca.vec(ca.densify(item)))]
    seen = set[int]()
    while todo:
        x = todo.pop()
        if x.element_hash() not in seen and x.n_dep():
            seen.add(x.element_hash())
            parts = [x.dep(k) for k in range(x.n_dep())]
            yield x, parts
            todo += parts


def domains_of(outputs: Sequence[SX]) -> Iterator[tuple[int, SX]]:
    """Instructions that divide or are not defined everywhere, with what must keep away from a bad value."""
    column = ca.veccat(ca.SX(0, 1), *map(ca.densify, outputs))
    function = ca.Function("domains_of", [], [column], {"allow_free": True, **TO_READ})
    program, expressions = read(function), function.instructions_sx()  # SX.dep takes ten times as long
    todo, seen = [*program.sources[0]], set[int]()
    while todo:
        place = todo.pop()
        node = program.nodes[place]
        if place in seen or node.code not in OPERATIONS:
            continue
        seen.add(place)
        domain = OPERATIONS[node.code].domain
        if domain is not None:
            x = expressions[node.line]
            parts = [x.dep(k) for k in range(x.n_dep())]
            if not _is_safe(node.code, parts):
                yield node.code, parts[domain]
        todo += node.operands


_ABOVE: Final = (*DIVISIONS, ca.OP_SQRT, ca.OP_LOG, ca.OP_LOG1P)
_DEEP: Final = 12
"""How far back the sign of a value is looked for."""


def sign_of_node(x: SX, deep: int = _DEEP) -> Sign:
    """What is known of a scalar's sign by its last operations."""
    if x.is_constant():
        return sign_after(ca.OP_CONST, (), positive=float(x) > 0)
    if not x.n_dep() or not deep or x.op() not in SIGNED:
        return Sign.ANY
    return sign_after(x.op(), [sign_of_node(x.dep(k), deep - 1) for k in range(x.n_dep())])


def _is_safe(code: int, parts: Sequence[SX]) -> bool:
    """What divides by, or is the root or logarithm of, something that is above zero by how it is computed, such as
    max(x, c) or x^2 + c, c > 0, and a whole power that is not negative, are defined everywhere.
    """
    domain = OPERATIONS[code].domain
    if code in _ABOVE and domain is not None and sign_of_node(parts[domain]) is Sign.ABOVE:
        return True
    if code in POWERS and parts[1].is_constant():
        return float(parts[1]) >= 0 and float(parts[1]).is_integer()
    return False
