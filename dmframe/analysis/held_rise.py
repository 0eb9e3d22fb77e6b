r"""States from which V of a certificate rises over every short sampling interval.

A certificate in continuous time states :math:`\dot V = -d(x)` along the loop, :math:`d \ge 0`. On a clock the run is
the flow with a held input v (`dmframe.analysis.held`), with :math:`\dot x = F(x, v)` and v = k(x) at the sample. From a
state with d(x) = 0 the first derivative of V is zero in both. Since d is not negative, it is smallest there, so that
the second derivative is zero in continuous time, unless an operation in d switches, which is refused. With the held
input it lacks the change of k:

.. math:: V(x(T)) - V(x(0)) = \tfrac12 \rho\, T^2 + O(T^3), \qquad
          \rho = -\frac{\partial V}{\partial x} \frac{\partial F}{\partial v} \frac{d k}{d t}                  \tag{1}

If :math:`\rho > 0`, V rises over every interval that is short enough: there is no period up to which this V falls. An
adaptation law has such states: it is at rest with another estimate, :math:`\sigma = 0` and
:math:`Y \tilde a \ne 0`. The plant moves at once, and the step of the estimate uses the old :math:`\sigma`.

The search takes a motion at rest on a path at rest and draws estimates inside their boxes. d(x) = 0 is shown
identically, the sign of :math:`\rho` in ball arithmetic. It does not concern a given period or another V.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.held import switches
from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim, total
from dmframe.certify.form import NotApplicableError
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import DmframeError
from dmframe.diagram import ClosedLoop
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.diagram.projection import Box
from dmframe.exact.balls import ZERO, ball, below, enclosed
from dmframe.program import TO_READ, read
from dmframe.simulate import start_state

Array = NDArray[np.float64]

VELOCITY: Final = "dq"
"""The state of a robot that is its joint velocity."""

DRAWS: Final = 8
"""Number of drawn estimates."""


@final
@dataclass(frozen=True)
class Rise:
    """A state from which V rises.

    Parameters
    ----------
    rho
        Lower end of (1), in units of V per s^2.
    because
        The held signal with the largest share: the rate of a state, or a command.
    state
        The state, by label.
    """

    rho: float
    because: str
    state: Mapping[str, list[float]]


def rise_of(claim: Claim, *, kappa: float = 1.0, seed: int = 0, start: Mapping[str, Any] | None = None) -> Rise | None:
    """A state from which V of a claim in continuous time rises over every short interval; None if none is found.

    Parameters
    ----------
    kappa
        Weight of the servo level in V; the rise is proved for every weight that is large enough for the claim.
    seed, start
        Of the drawn estimates, and of the run at whose start the other states are.
    """
    try:
        found = _Search(claim, start or {}).found(np.random.default_rng(seed))
        return None if found is None else replace(found, rho=kappa * found.rho)
    except (DmframeError, NotApplicableError):
        return None


@final
class _Search:
    def __init__(self, claim: Claim, start: Mapping[str, Any]) -> None:
        self._claim, self._loop = claim, claim.loop
        self._start = start_state(claim.diagram, start)
        self._names = [leaf.name for leaf in self._loop.commanded for _ in range(leaf.symbol.numel())]
        self._names += [f"d {v.label}/dt" for v in self._loop.controller for _ in range(v.symbol.numel())]

    def found(self, rng: np.random.Generator) -> Rise | None:
        """The first drawn state with a proved rise."""
        claim, loop = self._claim, self._loop
        if any(part.certificate.residual for part in claim.parts) or loop.discrete_time or loop.second_order:
            return None
        if not self._is_smooth(self._dissipation()):
            return None
        room = stack(ca.vec(ca.densify(item.set.room(item.state))) for item in loop.projections)
        expressions = self._at_rest([*self._shares(), room, self._dissipation(), loop.state])
        if not symbols_of(claim).vanishes("dissipation", ca.densify(expressions[3])):
            return None
        del expressions[3]
        program = read(ca.Function("rise", [loop.state, loop.p], expressions, TO_READ))
        numbers = [ball(float(value)) for value in loop.p_values]
        for _ in range(DRAWS):
            values = enclosed(program, [[ball(float(value)) for value in self._drawn(rng)], numbers])
            servo, task, inside, state = program.dense(values, ZERO)
            rho, rest = sum(servo, ZERO), sum(task, ZERO)
            if rho > 0 and rest >= 0 and all(value > 0 for value in inside):
                because = self._names[int(np.argmax([float(value) for value in servo]))]
                return Rise(below(rho), because, _by_label(loop, [float(value) for value in state]))
        return None

    def _shares(self) -> list[SX]:
        """The contributions of the held signals to rho: of the servo level with the weight 1, and of the task level."""
        claim, loop = self._claim, self._loop
        leaves, commands = loop.held_over_a_sample
        rates = stack(loop.rates_of(loop.controller))
        (signals,) = loop.joined([ca.vertcat(commands, rates)])
        change = ca.densify(claim.flow.unrecorded(self._inside(signals)))
        slope = ca.jacobian(stack(loop.rates_of(loop.flowing)), leaves)
        (slope,) = loop.joined([slope])
        first = rates.numel()
        shares = list[SX]()
        for level in (False, True):
            V = total([part.storage for part in claim.parts if part.cascade is level])
            gradient = ca.densify(ca.gradient(V, loop.state))
            held = ca.vertcat(slope.T @ gradient[first:], gradient[:first])
            shares.append(self._inside(ca.densify(-held * change)))
        return shares

    def _dissipation(self) -> SX:
        claim = self._claim
        return total([part.dissipation for part in claim.parts]) + claim.consumption

    def _is_smooth(self, expression: SX) -> bool:
        """True if no operation on a state or a signal switches: the least value of d then has no slope."""
        symbols, constants = ca.symvar(ca.densify(expression)), self._loop.constants
        moving, fixed = ([x for x in symbols if (x.element_hash() in constants) is kept] for kept in (False, True))
        return not any(switches(moving, fixed, expression))

    def _inside(self, expression: SX) -> SX:
        """The expression with inactive projections."""
        for item in self._loop.projections:
            expression = ca.substitute(expression, item.correction, ca.SX.zeros(item.correction.shape))
        return expression

    def _at_rest(self, expressions: list[SX]) -> list[SX]:
        """Expressions at states without dissipation: without velocities, on a path at rest that the robot is on."""
        claim, loop = self._claim, self._loop
        goals, outputs = {pair.desired: pair.found for pair in loop.followed}, {s.label for s in loop.outputs}
        meanings = list[tuple[SX, SX]]()
        every = (*loop.trajectories, *claim.diagram.resolver.trajectories.values())
        for leaf in {leaf.name: leaf for leaf in every}.values():
            if leaf.name in goals:
                (meaning,) = loop.joined([goals[leaf.name]])
            else:  # a derivative is zero, another reference has its first value
                own = leaf.expression if leaf.name in outputs else 0 * leaf.symbol
                (meaning,) = ca.substitute([own], [loop.time], [ca.SX(0)])
            meanings.append((leaf.symbol, meaning))
        meanings += [(v.symbol, ca.SX.zeros(*v.symbol.shape)) for v in loop.flowing if v.name == VELOCITY]
        vectors = [term.pieces[0] for part in claim.parts for term in part.certificate.dissipation]
        count, whole = len(expressions), [*expressions, *vectors]
        for symbol, meaning in meanings:
            whole = list(ca.substitute(whole, [symbol], [meaning]))
        for k in range(count, len(whole)):
            vector = ca.densify(whole[k])
            for symbol, meaning in self._without(vector):
                whole = list(ca.substitute(whole, [symbol], [meaning]))
        return whole[:count]

    def _without(self, vector: SX) -> Iterator[tuple[SX, SX]]:
        """A state and its value for which a vector is zero, if the vector is linear in one with a diagonal slope."""
        for variable in self._loop.variables:
            symbol = variable.symbol
            if symbol.shape != vector.shape or not ca.depends_on(vector, symbol):
                continue
            slope = ca.jacobian(vector, symbol)
            own = ca.densify(ca.diag(slope))
            if (slope - ca.diag(own)).is_zero() and symbols_in([own]) <= self._loop.constants:
                yield symbol, symbol - vector / own
                return

    def _drawn(self, rng: np.random.Generator) -> Array:
        """The start of a run with other estimates, inside their boxes, and without velocities."""
        state, ends = self._start.copy(), self._ends
        models = self._claim.diagram.models
        estimates = {f"{name}.{item.name}" for name, model in models.items() for item in model.estimates}
        for variable, rows in rows_of(self._loop.variables):
            if variable.name == VELOCITY:
                state[rows] = 0.0
            elif variable.label in estimates:
                own = state[rows]
                size = np.where(own == 0, 1.0, np.abs(own) / 2)
                if variable.label in ends:
                    low, high = ends[variable.label]
                    size = np.minimum(size, (high - low) / 4)
                    own = np.clip(own, low + 1.1 * size, high - 1.1 * size)
                state[rows] = [float(f"{value:.6g}") for value in own + size * rng.uniform(-1, 1, own.shape)]
        return state

    @cached_property
    def _ends(self) -> dict[str, tuple[Array, Array]]:
        """Lower and upper ends of the boxes, by the label of the state."""
        loop = self._loop
        boxes = [(item.name, item.set) for item in loop.projections if isinstance(item.set, Box)]
        found = {name: ca.Function("ends", [loop.p], list(box.ends))(loop.p_values) for name, box in boxes}
        return {name: (low.full().ravel(), high.full().ravel()) for name, (low, high) in found.items()}


def _by_label(loop: ClosedLoop, state: Sequence[float]) -> dict[str, list[float]]:
    return {variable.label: list(state[rows]) for variable, rows in rows_of(loop.variables)}


__all__ = ["Rise", "rise_of"]
