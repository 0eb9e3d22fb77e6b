r"""A loop on its clock as a flow with held inputs, and its matrices where it is linear.

On a clock the plant flows with held commands :math:`u_k`, and each controller state takes one Euler step of length T,

.. math:: \dot x_p = f(x_p, u_k), \qquad x_c^+ = x_c + T g_k,

with :math:`u_k = h(x(t_k))` and :math:`g_k = g(x(t_k))`. The straight line
:math:`x_c(t) = x_c(t_k) + (t - t_k)\, g_k` passes through all values of the controller's states. The run is therefore,
at every sampling instant and without an approximation, the flow of all states with the held input
:math:`v_k = (u_k, g_k)`:

.. math:: \dot x = F(x, v_k), \qquad v_k = k(x(t_k)).

With the held error :math:`e = v_k - k(x)`, which is zero after each sample, a linear loop is

.. math::

    \dot x = A x + E e, \qquad \dot e = -K (A x + E e), \qquad e^+ = 0,                               \tag{1}

A the matrix of the loop in continuous time. x is the difference of two motions on one path and one clock, in which
desired trajectories cancel. States that act neither on a held signal nor on another state of x are left out.

The plant may be nonlinear. By the mean value theorem (1) then holds with A and E that change with time, in the hull of
the slopes over all states: all angles that only sines and cosines read, and all other states up to `FAR`. k must be
linear, since the difference of its rates along two motions is no multiple of x otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, final

import casadi as ca
from flint import arb, arb_mat

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.common.errors import listed
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import ZERO, UndecidedError, ball, enclosed, precise
from dmframe.program import BY_NAME, EDGES, INPUT, JUMPS, KINKS, TO_READ, Program, read, sign_of

TURN: Final = 3.15
FAR: Final = 1e6
"""Bounds on the absolute value of an angle, up to whole turns, and of another state."""
TURNING: Final = frozenset(BY_NAME[name].code for name in ("sin", "cos"))

_NAMED: Final = 3
"""Number of signals that a reason lists."""


@final
@dataclass(frozen=True, eq=False)
class HeldLoop:
    r"""Enclosures of A, E and K of (1), with the labels of the states x and of the held signals v.

    Where x are only the moving coordinates of a loop, `rates` are the matrices of the rates of all of its states in
    (x, e), on which K acts: :math:`\dot e = -K (L x + F e)`.
    """

    states: tuple[str, ...]
    held: tuple[str, ...]
    A: arb_mat
    E: arb_mat
    K: arb_mat
    rates: tuple[arb_mat, arb_mat] | None = None

    @property
    def grown(self) -> tuple[arb_mat, arb_mat]:
        """C and D of the rate of the held error, C x + D e."""
        L, F = (self.A, self.E) if self.rates is None else self.rates
        return self.K * L * -1, self.K * F * -1


@final
@dataclass(frozen=True, eq=False)
class HeldSlopes:
    """A, E and K of (1) as expressions in the parameters of a loop and, of a nonlinear plant, in the states."""

    loop: ClosedLoop
    states: tuple[str, ...]
    held: tuple[str, ...]
    matrices: tuple[SX, SX, SX]

    @property
    def linear(self) -> bool:
        """True if the matrices do not depend on states."""
        return not ca.depends_on(stack(self.matrices), self.loop.state)

    @property
    def own(self) -> HeldLoop:
        """The matrices at the numbers of the loop, over all states."""
        return self.function([self.loop.p])([own_numbers(self.loop)])

    def function(self, columns: Sequence[SX]) -> Callable[[Sequence[Sequence[arb]]], HeldLoop]:
        """The matrices over all states, as a function of numbers for columns of symbols."""
        program = read(ca.Function("slopes", [*columns, self.loop.state], list(self.matrices), TO_READ))
        shapes, everywhere = (
            [matrix.shape for matrix in self.matrices],
            _everywhere(program, len(columns), self.loop.state.numel()),
        )

        @precise()
        def at(numbers: Sequence[Sequence[arb]]) -> HeldLoop:
            found = zip(shapes, program.dense(enclosed(program, [*numbers, everywhere]), ZERO), strict=True)
            A, E, K = (arb_mat(columns, rows, values).transpose() for (rows, columns), values in found)
            return HeldLoop(self.states, self.held, A, E, K)

        return at


@precise()
def _everywhere(program: Program, argument: int, size: int) -> list[arb]:
    """A ball for each element of an argument: a whole turn if only sines and cosines read it, else up to `FAR`."""
    turned = [True] * size
    places = {k: node.b for k, node in enumerate(program.nodes) if node.code == INPUT and node.a == argument}
    others = [node.operands for node in program.nodes if node.code not in TURNING]
    for place in places.keys() & {place for read_by in (*others, *program.sources) for place in read_by}:
        turned[places[place]] = False
    return [arb(0, TURN if each else FAR) for each in turned]


def held_loop(diagram: Diagram) -> HeldLoop:
    """A loop on a clock as (1), at the numbers of the diagram.

    Raises `UndecidedError` with the reason for a law that is not linear, or whose controller takes other steps.
    """
    return held_slopes(diagram).own


def own_numbers(loop: ClosedLoop) -> list[arb]:
    """The parameters of a loop as balls."""
    return [ball(float(value)) for value in loop.p_values]


def held_slopes(diagram: Diagram, uncertain: Collection[str] = ()) -> HeldSlopes:
    """The matrices of a loop on a clock; `uncertain` are labels of parameters that may differ from zero.

    Raises
    ------
    UndecidedError
        The law is not linear, its states take other steps, an operation switches, or a slope of the plant depends on a
        command or on time.
    """
    loop = diagram.loop
    if reason := next(other_steps(loop), ""):
        raise UndecidedError(reason)
    if loop.projections:
        raise UndecidedError(f"the law is not linear: {loop.projections[0].name} is projected onto a set")
    own, (leaves, commands) = stack(v.symbol for v in loop.flowing), loop.held_over_a_sample
    first = loop.state.numel() - own.numel()
    (signals,) = loop.acting([ca.vertcat(commands, stack(loop.rates_of(loop.controller)))])
    flow, signals = _without_zeros(loop, [loop.flow, signals], uncertain)
    _refuse_switches(loop, ca.vertcat(flow, signals))
    slopes = [ca.jacobian(flow, own), ca.jacobian(flow, leaves), ca.jacobian(signals, loop.state)]
    states, held = _labels(loop), [*commands_of(loop), *(f"d {label}/dt" for label in _labels(loop)[:first])]
    _refuse_nonlinear(loop, slopes, [states[first:], states[first:], held])
    F = ca.diagcat(ca.SX(first, first), slopes[0])
    E = ca.vertcat(
        ca.horzcat(ca.SX(first, leaves.numel()), ca.SX.eye(first)),
        ca.horzcat(slopes[1], ca.SX(own.numel(), first)),
    )
    A = F + E @ slopes[2]
    kept, some = _acting(A, slopes[2])
    if not some:
        raise UndecidedError("no held signal depends on a state")
    matrices = A[kept, kept], E[kept, some], slopes[2][some, kept]
    return HeldSlopes(loop, tuple(states[k] for k in kept), tuple(held[k] for k in some), matrices)


def other_steps(loop: ClosedLoop) -> Iterator[str]:
    """Reasons why the controller's states do not take plain Euler steps."""
    if reason := loop.discrete_time:
        yield f"the loop is not emulated: {reason}"
    for label in loop.second_order:
        yield f"the step of {label} has a term of second order"


def _without_zeros(loop: ClosedLoop, expressions: Sequence[SX], uncertain: Collection[str]) -> list[SX]:
    """Expressions without the parameters that are zero and not uncertain."""
    labels = [p.label for p in loop.parameters for _ in range(p.symbol.numel())]
    zeros = [k for k, value in enumerate(loop.p_values) if value == 0 and labels[k] not in uncertain]
    if not zeros:
        return list(expressions)
    return list(ca.substitute(list(expressions), [loop.p[zeros]], [ca.SX.zeros(len(zeros))]))


def _labels(loop: ClosedLoop) -> list[str]:
    return _elements([(v.label, v.symbol.numel()) for v in loop.variables])


def commands_of(loop: ClosedLoop) -> list[str]:
    """Labels of the elements of the commands."""
    return _elements([(leaf.name, leaf.symbol.numel()) for leaf in loop.commanded])


def _elements(items: Sequence[tuple[str, int]]) -> list[str]:
    return [f"{label}[{row}]" if size > 1 else label for label, size in items for row in range(size)]


def _refuse_switches(loop: ClosedLoop, moves: SX) -> None:
    """Raise `UndecidedError` for an operation of states whose slope jumps: a slope then does not bound a change."""
    leaves, _ = loop.held_over_a_sample
    columns = [ca.vertcat(loop.state, leaves), loop.p, loop.w, loop.period]
    program = read(ca.Function("moves", columns, [moves], TO_READ))
    moving = list[bool]()
    for node in program.nodes:
        own = node.code == INPUT and node.a == 0
        moving.append(own or (node.code != INPUT and any(moving[place] for place in node.operands)))
        if moving[-1] and node.code in JUMPS | KINKS | EDGES:
            raise UndecidedError(f"the loop is not smooth: {sign_of(node.code)} of a state or a command switches")


def _refuse_nonlinear(loop: ClosedLoop, slopes: Sequence[SX], names: Sequence[Sequence[str]]) -> None:
    """Raise `UndecidedError` for a slope of a held signal that depends on a state, and any that depends on time."""
    states = symbols_in([loop.state])
    for slope, rows in zip(slopes, names, strict=True):
        held = slope is slopes[2]
        for row, name in enumerate(rows):
            if moving := symbols_in([slope[row, :]]) - loop.constants - (set() if held else states):
                of = [v.label for v in loop.variables if symbols_in([v.symbol]) & moving]
                of += [
                    leaf.name for leaf in (*loop.trajectories, *loop.commanded) if symbols_in([leaf.symbol]) & moving
                ]
                of += ["t"] if symbols_in([loop.time]) & moving else []
                if held:
                    raise UndecidedError(f"the law is not linear: the slope of {name} depends on {listed(of[:_NAMED])}")
                text = f"the slope of d {name}/dt depends on {listed(of[:_NAMED])}"
                raise UndecidedError(f"the plant's slopes are not bounded: {text}")


def _acting(A: SX, K: SX) -> tuple[list[int], list[int]]:
    """States that act on a held signal, directly or through others; and the held signals that depend on them."""
    reads, held = A.sparsity(), K.sparsity()
    pairs = set(zip(*reads.get_triplet(), strict=True))
    by_signal = set(zip(*held.get_triplet(), strict=True))
    kept = {column for _, column in by_signal}
    while more := {column for row, column in pairs if row in kept} - kept:
        kept |= more
    return sorted(kept), sorted({row for row, _ in by_signal})


__all__ = ["HeldLoop", "HeldSlopes", "commands_of", "held_loop", "held_slopes", "other_steps", "own_numbers"]
