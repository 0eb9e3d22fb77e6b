r"""Factorisation of a loop's change per sample through the fewest signals that vanish at an equilibrium.

Let g(x) be the change of each state (`set_point.moves`). At an equilibrium few signals vanish: velocities, errors,
unbalanced torques. An estimate without excitation changes only with these signals and is otherwise free. So
errors, the unbalanced torques; an estimate that nothing excites moves with them, and is otherwise free. So

.. math:: g(x) = \hat g(x, y(x)), \qquad \hat g(x, 0) = 0

with as few signals y as possible: a minimum cut in the graph of operations between the states and their changes. The
second identity follows from the operations, not from numbers: 0 times anything, and sums of zeros. At a point with y =
0

.. math:: \frac{\partial g}{\partial x} = L R, \qquad L = \frac{\partial \hat g}{\partial y}, \quad
    R = \frac{\partial y}{\partial x}

An invariant sum of states (changed by no sample, identically) is a constant, so one of its states is substituted. For
example, two integrals of one command, the servo's and its model's, differ by a constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, final

import casadi as ca
import numpy as np
from flint import arb

from dmframe.analysis.minimum_cut import ITSELF, LEAST, Cut, vanishing
from dmframe.analysis.set_point import at_set_point, counts, moves, undrawn
from dmframe.analysis.sums import Sum, conserved, scaled, sums_of
from dmframe.analysis.switches import chosen, distinct, numbers_of, values_of
from dmframe.block.certificate import SX
from dmframe.diagram import ClosedLoop
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import ZERO, UndecidedError, ball, enclosed, precise
from dmframe.exact.literal import literal
from dmframe.program import (
    EDGES,
    INPUT,
    JUMPS,
    KINKS,
    Node,
    Program,
    read,
    sign_of,
)


@final
@dataclass(frozen=True, repr=False, eq=False)
class SplitMoves:
    """`y` and both Jacobians of a loop's change, as programs of (x, p, T).

    Parameters
    ----------
    count
        Number of signals in y.
    y, L, R
        Programs; L and R store structural nonzeros column by column.
    guards
        Columns (x, p, T) -> values that are positive while all switches keep their piece.
    held
        (x, p, T) -> signals held over a sample.
    slope
        (continuous states, held signals, p) -> Jacobian of the plant's rates in the continuous states.
    kept
        Invariant sums of states that are zero: factors by state and power of T. The first state of each, with factor
        one, is not an input of y, L and R.
    """

    loop: ClosedLoop
    count: int
    y: Program
    L: Program
    R: Program
    guards: Program
    held: Program
    slope: Program
    kept: Sequence[Sum] = ()


@precise()
def split_moves(loop: ClosedLoop, point: np.ndarray, p: Sequence[arb], period: arb) -> SplitMoves:
    """Find the factorisation at a point near an equilibrium; it is an identity wherever the guards are positive.

    Raises `UndecidedError` at a switching point, or for an unknown operation.
    """
    expression = undrawn(loop, loop.on_path(loop.acting([moves(loop)])[0]))
    zeros = [k for k, value in enumerate(loop.p_values) if value == 0]
    if zeros:  # a zero term needs no proof
        expression = ca.substitute(expression, loop.p[zeros], ca.SX.zeros(len(zeros)))
    symbols = [loop.state, loop.p, loop.period]
    inputs = [[arb(float(value)) for value in point], list(p), [period]]

    def read_moves(value: SX) -> Program:
        return read(ca.Function("moves", symbols, [ca.cse(ca.densify(value))]))

    program = read_moves(expression)
    at = [*map(_floats, inputs)]
    pieces, guards = chosen(program, symbols, numbers_of(program, symbols, at))
    held, slope, more = _flow(loop, symbols, at)
    program, guards = read_moves(pieces), ca.vertcat(guards, more)
    _refuse_turns(loop, pieces, guards, inputs)
    kept = [item for item in _conserved(loop, program) if abs(float(kept_value(item, *inputs[::2]))) <= LEAST]
    if kept:
        pieces, guards = _without(kept, loop, pieces), _without(kept, loop, guards)
        for item in kept:
            (state, _), *_ = item
            pieces[state] = 0
            inputs[0][state] = -kept_value(dict(list(item.items())[1:]), *inputs[::2])
        program = read_moves(pieces)
    program = read_moves(_summed(loop, program, symbols, enclosed(program, inputs)))
    cut, sums = Cut(program, enclosed(program, inputs)).found()
    y = ca.SX.sym("y", len(cut))
    signals, rest = _rebuilt(program, symbols, cut, sums, y)
    at_zero = _rebuilt(program, symbols, cut, sums, ca.SX.zeros(len(cut)))[1]
    if not all(element.is_zero() for element in ca.vertsplit(ca.densify(at_zero))):
        raise UndecidedError("the rates do not vanish structurally with the signals that are zero at rest")
    L = ca.substitute(ca.jacobian(rest, y), y, ca.SX.zeros(len(cut)))
    R = ca.jacobian(signals, loop.state)

    def program_of(name: str, value: SX) -> Program:
        return read(ca.Function(name, symbols, [ca.cse(value)]))

    programs = {name: program_of(name, v) for name, v in (("y", signals), ("L", L), ("R", R), ("guards", guards))}
    return SplitMoves(loop, len(cut), kept=tuple(kept), held=held, slope=slope, **programs)


def _flow(loop: ClosedLoop, symbols: Sequence[SX], at: Sequence[Sequence[float]]) -> tuple[Program, Program, SX]:
    """Signals held over a sample, Jacobian of the plant's rates in the continuous states, and guards of the signals.

    Guards of the Jacobian are among those of the moves, which include its rates.
    """
    held = read(at_set_point(loop, "held", ca.densify(loop.held_over_a_sample[1])))
    values, guards = chosen(held, symbols, numbers_of(held, symbols, at))
    given = ca.Function("held", list(symbols), [values])(*at).full().ravel()
    x, (leaves, _) = stack(v.symbol for v in loop.flowing), loop.held_over_a_sample
    own, point = [x, leaves, loop.p], [at[0][len(at[0]) - x.numel() :], given, at[1]]
    flow = read(ca.Function("flow", own, [ca.densify(loop.on_path(loop.flow))]))
    rates = chosen(flow, own, numbers_of(flow, own, point))[0]
    slope = read(ca.Function("flow", own, [ca.cse(ca.densify(ca.jacobian(rates, x)))]))
    return read(ca.Function("held", list(symbols), [ca.cse(values)])), slope, guards


def _conserved(loop: ClosedLoop, program: Program) -> list[Sum]:
    """Invariant sums of states, with factors rational in T; `program` gives the change of each state.

    Continuous states are included if their rates read no continuous state; sampled states if they are not projected.
    """
    (places,) = program.stored(range(len(program.nodes)))
    sums, flowing = sums_of(program.nodes), stack(v.symbol for v in loop.flowing)
    put_back = [item.state for item in loop.projections]
    own, row = dict[int, Sum](), 0
    for v in loop.variables:
        (rate,) = loop.projected(loop.rates_of([v]), joined=False)
        free = not any(ca.depends_on(state, v.symbol) for state in put_back)
        steady = v not in loop.flowing or not ca.depends_on(loop.on_path(rate), flowing)
        for k in range(row, row + v.symbol.numel()):
            one = sums[places[k]]
            if free and steady and one is not None:
                own[k] = one if v.sampled else scaled(one, Fraction(1), 1) or {}
        row += v.symbol.numel()
    return conserved(own)


@precise()
def kept_value(item: Sum, x: Sequence[arb], T: Sequence[arb]) -> arb:
    """Value of a sum of states."""
    total = ZERO
    for (state, power), factor in item.items():
        term = ball(factor) * x[state]
        total = total + (term * T[0] if power else term)
    return total


def _without(kept: Sequence[Sum], loop: ClosedLoop, expression: SX) -> SX:
    """Expression with the first state of each sum substituted by its value for a zero sum."""
    T, first, meanings = loop.period, list[SX](), list[SX]()
    for item in kept:
        (own, *others) = item.items()
        first.append(loop.state[own[0][0]])
        parts = (-_number(factor) * loop.state[state] * (T if power else 1) for (state, power), factor in others)
        meanings.append(sum(parts, ca.SX(0)))
    return ca.substitute(expression, ca.vertcat(*first), ca.vertcat(*meanings))


def _summed(loop: ClosedLoop, program: Program, symbols: Sequence[SX], numbers: Sequence[Any]) -> SX:
    """Changes of the states; for a sampled state that cancels in its own change, a sum without that state."""
    zero, kinds = vanishing(program.nodes, numbers)
    (places,) = program.stored(range(len(program.nodes)))
    whole = [zero[k] and kinds[k] == ITSELF for k in range(len(zero))]
    for place in places:
        whole[place] = False
    sums, values, T = sums_of(program.nodes, whole), values_of(program, symbols), symbols[2]
    own = {node.b: k for k, node in reversed(list(enumerate(program.nodes))) if node.code == INPUT and not node.a}
    sampled = [v.sampled for v in loop.variables for _ in range(v.symbol.numel())]

    def summed(state: int, place: int) -> SX:
        one = sums[place]
        here = sampled[state] and zero[place] and one is not None and (place, 0) not in one
        if one is None or not here or (own.get(state, -1), 0) in one:
            return values[place]
        return sum((_number(factor) * T**power * values[k] for (k, power), factor in one.items()), ca.SX(0))

    return ca.vertcat(*(summed(state, place) for state, place in enumerate(places)))


def _refuse_turns(loop: ClosedLoop, pieces: SX, guards: SX, inputs: Sequence[Sequence[arb]]) -> None:
    """Raise `UndecidedError` at a switching point, at the end of a root's domain, and for a rate that reads a counter.

    At a switching point the slope is one-sided: that of |z| counts as zero at z = 0 and differs nearby. A counter never
    settles. Guards may have kinks: a continuous guard stays positive nearby.
    """
    counted = [v.symbol for v in loop.variables if counts(v)]
    if counted and ca.depends_on(pieces, stack(counted)):
        raise UndecidedError("it has no equilibrium: its rates depend on a counter that grows with each sample")
    for expression, turning in ((pieces, JUMPS | KINKS | EDGES), (guards, JUMPS)):
        program = read(ca.Function("turns", [loop.state, loop.p, loop.period], [expression]))
        if not program.codes & turning:
            continue
        numbers, moving = enclosed(program, inputs), list[bool]()
        for node in program.nodes:
            state = node.code == INPUT and node.a == 0
            moving.append(state or any(moving[place] for place in node.operands))
            ends = node.code in EDGES and distinct(float(numbers[node.a]), 0.0)
            if node.code in turning and moving[-1] and not ends:
                verb = "is at the edge of its domain" if node.code in EDGES else "switches"
                raise UndecidedError(f"its equilibrium is at a point where {sign_of(node.code)} {verb}")


def _rebuilt(
    program: Program, symbols: Sequence[SX], cut: Sequence[int], sums: Mapping[int, Sum], y: SX
) -> tuple[SX, SX]:
    """Values of the cut in the function's arguments; and the outputs as functions of `y`."""
    places, order = {place: k for k, place in enumerate(cut)}, iter(range(len(program.nodes)))

    def keep(_: Node, value: SX) -> SX:
        place = next(order)
        if place in places:
            return y[places[place]]
        if place in sums:
            one = sums[place].items()
            return sum(
                (_number(factor) * symbols[2] ** power * y[places[key]] for (key, power), factor in one), ca.SX(0)
            )
        return value

    own, (found,) = values_of(program, symbols), program.stored(values_of(program, symbols, keep))
    return ca.vertcat(ca.SX(0, 1), *(own[place] for place in cut)), ca.vertcat(ca.SX(0, 1), *found)


def _floats(numbers: Sequence[arb]) -> list[float]:
    return [float(number) for number in numbers]


def _number(value: Fraction) -> SX:
    """Fraction as a constant of an expression; `literal` must recover the same fraction."""
    if literal(float(value)) != value:
        raise UndecidedError(f"a factor of {value} is not a finite decimal")
    return ca.SX(float(value))
