r"""The loop linearised at an equilibrium, as a flow with held inputs in its moving coordinates.

At an equilibrium the rates are :math:`\dot x = L y` with the few signals y = R x that vanish there
(`dmframe.analysis.moves`); estimates that nothing excites do not matter. With held commands u and rates of the
controller's states, which are :math:`G s` with some signals s of y, the held error e is that of (u, s), and

.. math::

    \dot x = L y + F e, \qquad \dot y = R L y + R F e, \qquad \dot e = -K \dot x, \qquad
    K = (\partial u / \partial x, R_s),

which is (1) of `dmframe.analysis.held` with A = R L and E = R F. A storage function of y then falls for all sampling
intervals of at most T, of the linearised loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import casadi as ca
from flint import arb, arb_mat

from dmframe.analysis.enclosed import EnclosedLoop
from dmframe.analysis.held import HeldLoop, commands_of, other_steps
from dmframe.analysis.held_storage import find_storage
from dmframe.analysis.linear import Linear, linearise
from dmframe.analysis.set_point import LARGE
from dmframe.analysis.switches import chosen, numbers_of, values_of
from dmframe.block.certificate import SX
from dmframe.common.errors import DisagreementError
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import ZERO, UndecidedError, enclosed, precise
from dmframe.exact.rows import dense
from dmframe.program import TO_READ, Program, read

_SOME: Final = 0.01
"""Period [s] at which a loop without a clock is enclosed; its equilibrium does not depend on it."""

_ROUNDING: Final = 1e-7
"""Tolerance of a spectral radius in floating point."""

MOST: Final = 24
"""Largest number of held signals: the search for W has the square of it."""


def linearised_interval(diagram: Diagram, clock: float | None, *, start: Mapping[str, Any] | None = None) -> float:
    """The interval T [s] of the loop linearised at its set-point, without the slope of Coulomb friction at rest.

    The slope damps in the plant. In a controller that compensates friction it does not, so that both are compared.

    Raises
    ------
    DmframeError
        No interval is proved, or with the slope the loop is unstable, in floating point, with equal intervals up to T.
    DisagreementError
        The linearised loop is unstable, in floating point, with equal intervals up to T.
    """
    if (size := diagram.loop.state.numel()) > LARGE:
        raise UndecidedError(f"it has {size} states; the search is limited to {LARGE}")
    linear = linearise(diagram, start=start, moving=True, clock=clock)
    found = find_storage(held_linearised(diagram, linear, clock or _SOME, moving=True)).interval
    if (period := _unstable(linear, found)) is not None:
        raise DisagreementError(
            f"the interval of the linearised loop is withdrawn: sampled every {period:g} s, it is unstable "
            "in floating point; this indicates a defect of dmframe or of a block, please report it"
        )
    if (period := _unstable(linearise(diagram, start=start, clock=clock), found)) is not None:
        raise UndecidedError(f"with the slope of Coulomb friction at rest it is unstable, sampled every {period:g} s")
    return found


def _unstable(linear: Linear, longest: float) -> float | None:
    """One of three periods up to the longest at which the sampled loop is unstable; None without one."""
    periods = (part * longest for part in (1.0, 0.5, 0.25))
    return next((period for period in periods if not linear.spectral_radius(period) <= 1 + _ROUNDING), None)


@precise()
def held_linearised(diagram: Diagram, linear: Linear, clock: float, *, moving: bool = False) -> HeldLoop:
    """The linearised loop in its moving coordinates.

    Raises
    ------
    DmframeError
        No equilibrium is proved, the controller takes other steps, or too many signals are held.
    """
    if reason := next(other_steps(diagram.loop), ""):
        raise UndecidedError(reason)
    own = EnclosedLoop(diagram, linear, clock, moving=moving)
    found, split, loop = own.at(clock), own.split, own.split.loop
    if split.kept:
        raise UndecidedError("an invariant sum of states is not in the linearisation of held signals")
    first, count, size = linear.controller, split.count, len(linear.states)
    L, R = dense(found.L, count), dense(found.R, size)
    some = sorted({column for row in found.L[:first] for column in row})
    leaves, _ = loop.held_over_a_sample
    if leaves.numel() + len(some) > MOST:
        raise UndecidedError(f"{leaves.numel() + len(some)} signals are held; the search is limited to {MOST}")
    symbols = [loop.state, loop.p, loop.period]
    held = ca.vertcat(ca.SX(0, 1), *split.held.stored(values_of(split.held, symbols))[0])
    by_state = _matrix(ca.jacobian(held, loop.state), symbols, found.box)
    commands = [value.mid() for value in split.held.dense(enclosed(split.held, found.box), ZERO)[0]]
    rates = _rates(own, [float(x.mid()) for x in found.box[0][first:]], [float(u) for u in commands])
    x = stack(v.symbol for v in loop.flowing)
    (given,) = split.held.dense(enclosed(split.held, found.box), ZERO)
    by_command = _matrix(ca.jacobian(rates, leaves), [x, leaves, loop.p], [found.box[0][first:], given, found.box[1]])
    F = arb_mat(size, leaves.numel() + len(some))
    for i in range(first):
        for k, column in enumerate(some):
            F[i, leaves.numel() + k] = L[i, column]
    for i in range(size - first):
        for k in range(leaves.numel()):
            F[first + i, k] = by_command[i, k]
    K = arb_mat([*by_state.tolist(), *(R.tolist()[column] for column in some)])
    names = tuple(f"y[{k}]" for k in range(count)), (*commands_of(loop), *(f"y[{k}]" for k in some))
    return HeldLoop(names[0], names[1], R * L, R * F, K, (L, F))


def _rates(own: EnclosedLoop, x: list[float], commands: list[float]) -> SX:
    """The plant's rates with every switch in its active piece."""
    loop = own.split.loop
    symbols = [stack(v.symbol for v in loop.flowing), loop.held_over_a_sample[0], loop.p]
    flow = read(ca.Function("flow", symbols, [ca.densify(loop.on_path(loop.flow))]))
    return chosen(flow, symbols, numbers_of(flow, symbols, [x, commands, own.numbers]))[0]


def _matrix(value: SX, symbols: list[SX], box: Sequence[Sequence[arb]]) -> arb_mat:
    program: Program = read(ca.Function("slopes", symbols, [ca.cse(value)], TO_READ))
    (found,) = program.dense(enclosed(program, box), ZERO)
    rows, columns = value.shape
    return arb_mat(columns, rows, found).transpose()


__all__ = ["MOST", "held_linearised", "linearised_interval"]
