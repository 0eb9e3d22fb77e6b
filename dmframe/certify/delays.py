"""Whether a configured delay of a block is that of the plant: commands and measurements are traced through memories.

The command that a block uses for a sample is traced back, sample by sample, through the block's sampled states to its
output; the command that the plant applies, through the plant's sampled states to its input; and the measurement, to the
position. No block is identified by name. The cost is small, since few columns are traced.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.sampled import Acted
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim, Part
from dmframe.common.errors import listed
from dmframe.common.text import Text
from dmframe.diagram.closed_loop import ClosedLoop, Variable, stack
from dmframe.diagram.pieces import rows_of

MOST: Final = 10
"""Number of samples up to which a memory is traced; a hold has no end."""

POINTS: Final = 3
NEAR: Final = 1e-9
"""Relative difference of two values of one expression; other commands differ at random points."""

SOURCE: Final = "the means over a sample"


@final
@dataclass(frozen=True)
class Late:
    """Numbers of samples by which a signal may be delayed, and the blocks whose memories delay it.

    `copied`: the result is the signal itself, element by element.
    """

    by: tuple[int, ...]
    through: tuple[str, ...]
    copied: bool

    @property
    def text(self) -> str:
        """``1 (line)``."""
        more = "and more" if len(self.by) == MOST else ""
        counted = (
            f"{self.by[0]} to {self.by[-1]} {more}".strip() if len(self.by) > 2 else listed(list(map(str, self.by)))
        )
        return f"{counted} ({listed(list(self.through))})" if self.through else counted


def delay_conditions(claim: Claim, part: Part) -> Iterator[Checked]:
    """For each command in rows, whether it is the applied one; no condition if this is not decided."""
    for item in part.certificate.acted:
        used, command, measured = _used_delay(claim, item), _of_command(claim, item), _of_position(claim, item)
        if used is None or command is None or measured is None:
            continue
        text = Text(
            f"{part.block}: its rows use a delay of {used} samples, and the plant delays commands by "
            f"{command.text} and measurements by {measured.text}"
        )
        wrong = max(abs(used - there - back) for there in command.by for back in measured.by)
        if not (wrong or (command.copied and measured.copied)):
            continue  # another signal with the same delay: the applied command is assumed
        expression = "delay in the rows = delay of commands + delay of measurements"
        yield Checked(text, expression, 0.0 - wrong, not wrong, SOURCE, strict=False, margin=ca.SX(0, 1))


def decided_delays(claim: Claim, part: Part) -> bool:
    """True if no assumption about a block's delays remains."""
    return bool(part.certificate.acted) and len(list(delay_conditions(claim, part))) == len(part.certificate.acted)


def _used_delay(claim: Claim, item: Acted) -> int | None:
    """Age in samples of the command that the block uses, relative to the previous sample."""
    loop = claim.loop
    own, column = _memories(loop, loop.controller), ca.vertsplit(item.held)
    traced = 0
    while traced < MOST and all(row.is_symbolic() and row.element_hash() in own for row in column):
        column, traced = [own[row.element_hash()][0] for row in column], traced + 1
    (given,) = loop.joined([ca.vertcat(*column)])
    commands = [leaf.expression for leaf in loop.commanded if leaf.symbol.shape == given.shape]
    same = traced and any(_same(given, loop.joined([command])[0], loop.p, loop.p_values) for command in commands)
    return traced - 1 if same else None


def _of_command(claim: Claim, item: Acted) -> Late | None:
    """Delay in samples from the command to the value that the plant applies."""
    return _late(claim, item.command, [leaf.symbol for leaf in claim.loop.commanded])


def _of_position(claim: Claim, item: Acted) -> Late | None:
    """Delay in samples from the position to its measurement."""
    if not all(row.is_symbolic() for row in ca.vertsplit(ca.SX(item.position))):
        return None
    return _late(claim, item.seen, [item.position])


def _late(claim: Claim, expression: SX, signals: Sequence[SX]) -> Late | None:
    """Delay in samples of a column relative to one of the signals; None if it depends on none of them."""
    loop = claim.loop
    found = _followed(loop, ca.SX(expression), symbols_in(signals))
    elements = [ca.vertsplit(ca.vec(ca.SX(signal))) for signal in signals]
    for place, row in enumerate(ca.vertsplit(ca.SX(expression))):
        own = [each[place] for each in elements if len(each) == expression.numel()]
        if found is None or not _copied(loop, row, own):
            return found
    return None if found is None else replace(found, copied=True)


def _followed(loop: ClosedLoop, expression: SX, wanted: set[int]) -> Late | None:
    """Samples at which one of the wanted symbols appears in an expression, traced through memories of the plant."""
    memories, found, through = _memories(loop, loop.plant), list[int](), dict[str, None]()
    here = _leaves(loop, expression)
    for lag in range(MOST):
        if any(symbol.element_hash() in wanted for symbol in here):
            found.append(lag)
        held = [memories[symbol.element_hash()] for symbol in here if symbol.element_hash() in memories]
        if not held:
            break
        through |= dict.fromkeys(block for _, block in held)
        here = _leaves(loop, ca.vertcat(*(then for then, _ in held)))
    return Late(tuple(found), tuple(through), copied=False) if found else None


def _leaves(loop: ClosedLoop, expression: SX) -> list[SX]:
    """Symbols of an expression at the graph's numbers: a factor of 0 removes the previous sample."""
    return list(ca.symvar(ca.substitute(expression, loop.p, ca.DM(loop.p_values))))


def _copied(loop: ClosedLoop, row: SX, own: Sequence[SX]) -> bool:
    """True for an element that equals its own signal, present or earlier, except for noise and rounding."""
    memories, others = _memories(loop, loop.plant), symbols_in([*own, loop.drawn, loop.time, loop.period])
    here, passed = _leaves(loop, row), dict[int, SX]()
    while here:
        if any(symbol.element_hash() not in others | memories.keys() for symbol in here):
            return False  # another joint's signal, or a state that moves between samples
        new = {x.element_hash(): x for x in here if x.element_hash() in memories.keys() - passed.keys()}
        passed |= new
        here = _leaves(loop, ca.vertcat(ca.SX(0, 1), *(memories[key][0] for key in new)))
    return _kept(loop, [row, *(memories[key][0] for key in passed)], [*own, *passed.values()])


def _kept(loop: ClosedLoop, kept: Sequence[SX], signals: Sequence[SX]) -> bool:
    """True if a constant signal is passed unchanged, for a small one or one large compared with the rounding."""
    drawn, value = loop.drawn, ca.SX.sym("value")
    own = ca.substitute(stack(kept), loop.p, ca.DM(loop.p_values))
    same = ca.substitute(own, stack(signals), value * ca.SX.ones(len(signals)))
    function = ca.Function("kept", [value, drawn, loop.time, loop.period], [same])
    rng = np.random.default_rng(0)
    for size, near in ((1.0, NEAR), (1e6, 1e-6)):
        given = size * rng.uniform(0.1, 0.5, POINTS)
        rows = [function(x, rng.uniform(0, 1, drawn.numel()), 1.0, 0.1).full() for x in given]
        if all(np.all(np.abs(row - x) <= near * abs(x)) for row, x in zip(rows, given, strict=True)):
            return True
    return False


def _memories(loop: ClosedLoop, states: Sequence[Variable]) -> Mapping[int, tuple[SX, str]]:
    """Next value of each element of sampled states, and its block, by the identity of the element's symbol."""
    found, wanted = dict[int, tuple[SX, str]](), {state.label for state in states if state.sampled}
    for variable, rows in rows_of(loop.stepped):
        if variable.label in wanted:
            elements, then = ca.vertsplit(ca.vec(variable.symbol)), ca.vertsplit(loop.advanced[rows])
            found |= {x.element_hash(): (row, variable.block) for x, row in zip(elements, then, strict=True)}
    return found


def _same(one: SX, other: SX, parameters: SX, values: np.ndarray) -> bool:
    """True if two expressions are equal at random points with the graph's parameters; a command may copy another."""
    known = symbols_in([parameters])
    leaves = stack(leaf for leaf in ca.symvar(one - other) if leaf.element_hash() not in known)
    function, rng = ca.Function("same", [leaves, parameters], [one, other]), np.random.default_rng(0)
    for _ in range(POINTS):
        first, second = (found.full() for found in function(rng.uniform(0.1, 0.5, leaves.numel()), values))
        if not np.all(np.abs(first - second) <= NEAR * np.maximum(np.abs(first), np.abs(second))):
            return False
    return True
