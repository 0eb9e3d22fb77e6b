"""Closed loop with free commands: next values of sampled states for arbitrary commands.

A block that stores its own command stores the free one: the expression of a command is replaced by the free symbol
wherever it appears in a next value. No block is identified by name, and no part of a law remains that affects the loop
through its command only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Variable, stack
from dmframe.program import TO_READ, read


@final
class DrivenLoop:
    """Next values of the sampled states of a diagram for free commands.

    Attributes
    ----------
    commands
        Free symbols, a column: the commands to the plant.
    """

    def __init__(self, diagram: Diagram) -> None:
        self._diagram, self._loop = diagram, diagram.loop
        leaves = self._loop.commanded
        self.commands = stack(leaf.symbol for leaf in leaves)
        self._free = {_end(leaf.name): leaf.symbol for leaf in leaves}
        self._resolver = diagram.resolver.with_outputs(self._free)

    def measured(self, expressions: Sequence[SX]) -> list[SX]:
        """Expressions with measured signals replaced by the plant's expressions."""
        leaves, meanings = self._measurements
        return list(ca.substitute(list(expressions), [leaves], [meanings])) if leaves.numel() else list(expressions)

    @property
    def feeds_through(self) -> bool:
        """True if a measured signal contains a command of the same instant."""
        return bool(ca.depends_on(self._measurements[1], self.commands))

    def becomes(self, expressions: Sequence[SX]) -> Mapping[str, SX]:
        """Next values of the states on which expressions depend, by label, and of the states on which these depend."""
        found, waiting = dict[str, SX](), symbols_in(map(ca.SX, expressions))
        while reached := [v for v in self._loop.stepped if v.label not in found and v.identities & waiting]:
            after = self.measured([self._next(variable) for variable in reached])
            found |= {variable.label: value for variable, value in zip(reached, after, strict=True)}
            waiting |= symbols_in(after)
        return found

    @cached_property
    def _measurements(self) -> tuple[SX, SX]:
        done = list[tuple[SX, SX]]()
        for leaf in self._loop.measured:
            known = stack(a for a, _ in done), stack(b for _, b in done)
            (now,) = ca.substitute([leaf.expression], [known[0]], [known[1]]) if done else [leaf.expression]
            done.append((leaf.symbol, now))
        return stack(a for a, _ in done), stack(b for _, b in done)

    def _next(self, variable: Variable) -> SX:
        """Next value in the variables of its side, for free commands; an Euler step for a continuous state."""
        model, resolver = self._diagram.models[variable.block], self._resolver
        stated = model.equations.next.get(variable.name)
        if stated is not None:
            return resolver.expand(variable.block, self._with_commands(variable.block, stated))
        rate, second = (
            resolver.rate(variable.block, variable.name),
            resolver.second(variable.block, variable.name),
        )
        return variable.symbol + self._loop.period * (rate if second is None else rate + self._loop.period * second)

    def _with_commands(self, block: str, after: SX) -> SX:
        """An expression in a block's own symbols with the block's commands replaced by the free ones."""
        for known, free in self._own.get(block, ()):
            after = with_nodes(after, known, free)
        return after

    @cached_property
    def _own(self) -> Mapping[str, Sequence[tuple[Sequence[Known], SX]]]:
        """Commands of each controller block, element by element, with the free symbols."""
        found = dict[str, list[tuple[Sequence[Known], SX]]]()
        for (block, port), free in self._free.items():
            model = self._diagram.models[block]
            found.setdefault(block, []).append((known_elements(model.equations.outputs[port]), ca.vec(free)))
        return found


def _end(label: str) -> tuple[str, str]:
    block, _, port = label.partition(".")
    return block, port


class Known(NamedTuple):
    """An element of a command, and the identities of its symbols."""

    element: SX
    used: set[int]


def known_elements(expression: SX) -> tuple[Known, ...]:
    """Elements, column by column."""
    return tuple(Known(row, symbols_in([row])) for row in ca.vertsplit(ca.vec(ca.densify(expression))))


def with_nodes(expression: SX, known: Sequence[Known], instead: SX) -> SX:
    """An expression with known elements replaced by those of a column of symbols, wherever they appear.

    A repeated element is found as well, if it consists of the same operations.
    """
    if not _may_hold(expression, known):
        return expression
    elements = ca.vertsplit(ca.vec(ca.densify(expression)))
    marks = dict(zip((item.element.element_hash() for item in known), ca.vertsplit(instead), strict=True))
    after = [marks.get(element.element_hash(), element) for element in elements]
    place = [k for k, row in enumerate(after) if row is elements[k] and _may_hold(row, known)]
    if place:
        both = ca.cse(ca.vertcat(*(item.element for item in known), *(after[k] for k in place)))
        for k, value in zip(place, _rebuilt(both, len(known), ca.vertsplit(instead)), strict=True):
            after[k] = value
    return ca.reshape(ca.vertcat(*after), *expression.shape)


def _may_hold(expression: SX, known: Sequence[Known]) -> bool:
    used = symbols_in([expression])
    return any(item.used and item.used <= used for item in known)


def _rebuilt(column: SX, count: int, instead: Sequence[SX]) -> list[SX]:
    """The elements of a column after the first ones, with these replaced wherever they appear."""
    function = ca.Function("driven", [], [ca.densify(column)], {"allow_free": True, **TO_READ})
    program, old = read(function), function.instructions_sx()
    (sources,) = program.sources
    changed = dict(zip(sources[:count], instead, strict=True))
    for place, node in enumerate(program.nodes):
        if place not in changed and not changed.keys().isdisjoint(node.operands):
            operands = [changed[k] if k in changed else old[program.nodes[k].line] for k in node.operands]
            changed[place] = _operation(node.code, operands)
    return [changed[k] if k in changed else old[program.nodes[k].line] for k in sources[count:]]


def _operation(code: int, operands: Sequence[SX]) -> SX:
    return ca.SX.binary(code, *operands) if len(operands) == 2 else ca.SX.unary(code, *operands)
