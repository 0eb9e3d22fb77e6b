"""The map of a sample with a constant estimate: the law as it runs when its adaptation is switched off.

A law often uses the new estimate of a sample in the same sample, so that its expressions contain the update. The update
is removed from the program of the expressions: wherever a value of the next estimate is used, the constant estimate is
used instead. Equal operations on equal operands are one value (`dmframe.program.program.shared`).
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.program import CONST, INPUT, TO_READ, Program, read, shared
from dmframe.program.operations import OPERATIONS


def with_constant(arguments: Sequence[SX], next_estimate: SX, estimate: SX, expression: SX) -> SX:
    """A column of expressions in which the next value of an estimate is replaced by the estimate.

    Parameters
    ----------
    arguments
        Columns of symbols that the expressions contain, all of them.
    next_estimate, estimate
        Columns of the same size; the second one contains symbols.
    """
    outputs = [ca.densify(next_estimate), ca.densify(expression)]
    program = shared(read(ca.Function("both", list(arguments), outputs, TO_READ)))
    replaced = {
        place: symbol
        for place, symbol in zip(program.sources[0], ca.vertsplit(estimate), strict=True)
        if program.nodes[place].code not in (CONST, INPUT)  # of an element that no step changes
    }
    values = dict[int, SX]()
    for place in _needed(program, replaced.keys()):
        node = program.nodes[place]
        if place in replaced:
            values[place] = replaced[place]
        elif node.code == INPUT:
            values[place] = arguments[node.a].nz[node.b]
        elif node.code == CONST:
            values[place] = ca.SX(node.constant)
        elif OPERATIONS[node.code].arity == 2:
            values[place] = ca.SX.binary(node.code, values[node.a], values[node.b])
        else:
            values[place] = ca.SX.unary(node.code, values[node.a])
    return ca.vertcat(ca.SX(0, 1), *(values[place] for place in program.sources[1]))


def _needed(program: Program, known: AbstractSet[int]) -> list[int]:
    """Places of the values from which the second output follows, ascending; `known` ones need no operands."""
    found, waiting = set[int](), list(program.sources[1])
    while waiting:
        place = waiting.pop()
        if place not in found:
            found.add(place)
            if place not in known:
                waiting += program.nodes[place].operands
    return sorted(found)
