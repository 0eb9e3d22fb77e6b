"""Partial operations: divisions, and functions with a restricted domain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.certify.sign import SIGNED, Sign, sign_after
from dmframe.program import CONST, DIVISIONS, OPERATIONS, POWERS, TO_READ, Program, read


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
    """Divisions and partial functions in expressions, once for each operand that their domain restricts."""
    column = ca.veccat(ca.SX(0, 1), *map(ca.densify, outputs))
    function = ca.Function("domains_of", [], [column], {"allow_free": True, **TO_READ})
    program = read(function)
    expressions: SX | None = None
    found = {(program.nodes[place].code, operand): place for place, operand in restricted(program, program.sources[0])}
    for place in found.values():
        node = program.nodes[place]
        if expressions is None:
            expressions = function.instructions_sx()  # ten times as fast as SX.dep
        yield node.code, expressions[node.line].dep(OPERATIONS[node.code].domain)


def restricted(program: Program, roots: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Divisions and partial functions below some values of a program, with the operand that their domain restricts."""
    todo, seen, signs = [*roots], set[int](), dict[tuple[int, int], Sign]()
    while todo:
        place = todo.pop()
        node = program.nodes[place]
        if place in seen or node.code not in OPERATIONS:
            continue
        seen.add(place)
        domain = OPERATIONS[node.code].domain
        if domain is not None and not _is_safe(program, place, node.operands[domain], signs):
            yield place, node.operands[domain]
        todo += node.operands


_ABOVE: Final = (*DIVISIONS, ca.OP_SQRT, ca.OP_LOG, ca.OP_LOG1P)
_DEEP: Final = 12
"""Number of operations that are traced back to determine the sign of a value."""


def _sign_of(program: Program, place: int, known: dict[tuple[int, int], Sign], deep: int = _DEEP) -> Sign:
    """Sign of a value of a program, derived from its last operations."""
    node = program.nodes[place]
    if node.code == CONST:
        return sign_after(CONST, (), positive=node.constant > 0)
    if not deep or node.code not in SIGNED:
        return Sign.ANY
    if (place, deep) not in known:
        operands = [_sign_of(program, k, known, deep - 1) for k in node.operands]
        known[place, deep] = sign_after(node.code, operands)
    return known[place, deep]


def _is_safe(program: Program, place: int, operand: int, signs: dict[tuple[int, int], Sign]) -> bool:
    """True for an operation that is always defined: a divisor or argument that is positive by construction, such as
    max(x, c) or x^2 + c with c > 0, or a nonnegative integer power.
    """
    node = program.nodes[place]
    if node.code in _ABOVE and _sign_of(program, operand, signs) is Sign.ABOVE:
        return True
    exponent = program.nodes[node.b]
    if node.code in POWERS and exponent.code == CONST:
        return exponent.constant >= 0 and exponent.constant.is_integer()
    return False
