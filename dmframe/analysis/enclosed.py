r"""The loop from sample to sample, linearised where it rests and enclosed: every rounding is counted.

The plant flows between two samples, its commands held, so that near its rest, with H the integral of its transition,

.. math:: F - 1 = \mathrm{diag}(T, 1, H)\, \frac{\partial g}{\partial x} = D L R,

T for the controller's states in continuous time, 1 for sampled ones, H for what flows; L and R as in
`dmframe.analysis.moves`. Hence F has the eigenvalue one as many times as it has more states than y signals, and else
the eigenvalues of 1 + R D L: in the signals y, which the states follow, the loop is that smaller matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.analysis.linear import Linear, at_speed
from dmframe.analysis.moves import SplitMoves, split_moves
from dmframe.analysis.set_point import frozen
from dmframe.certify.true_values import estimates_of
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.exact.fixed import ONE, Fixed, UndecidedError, fixed_values
from dmframe.exact.matrix import Matrix, held
from dmframe.program import Program, read

MOST_STATES: Final = 250
"""Of a loop with more states nothing is tried: it would take minutes."""

_STEPS: Final = 40
_NEAR: Final = ONE >> 200
"""Where Newton's steps end."""


@final
@dataclass(frozen=True)
class Enclosure:
    """The loop at an equilibrium that exists: numbers between which everything lies.

    Parameters
    ----------
    L, R, A
        Of the moves, and the plant's own slope.
    within
        How far from the told point the equilibrium lies at most, in the units of the states.
    """

    L: Matrix
    R: Matrix
    A: Matrix
    within: float


@final
class EnclosedLoop:
    """A linearised loop of which the transition can be enclosed on every clock.

    `split` is that of the same loop with other numbers: it is an identity, and its guards are looked at again.

    Raises `UndecidedError` for a loop that is too large, rests at a place where its equations turn, or has operations
    of which no enclosure is known.
    """

    def __init__(
        self,
        diagram: Diagram,
        linear: Linear,
        clock: float,
        *,
        moving: bool = False,
        split: SplitMoves | None = None,
    ) -> None:
        self.linear, self.loop = linear, frozen(diagram).loop
        if len(linear.states) > MOST_STATES:
            raise UndecidedError(f"it has {len(linear.states)} states, and with more than {MOST_STATES} none is tried")
        self._p = [Fixed.around(float(value)) for value in (at_speed(self.loop) if moving else self.loop.p_values)]
        known = estimates_of(diagram)
        self._estimates = [label.partition("[")[0] in known for label in linear.states]
        self.split = split or split_moves(self.loop, linear.point, self._p, Fixed.around(clock))
        self._rests = _inside(self.loop)
        self._once: Enclosure | None = None

    @property
    def moving(self) -> int:
        """How many directions move; in all others the loop rests anywhere."""
        return self.split.count

    def transition(self, period: float) -> Matrix:
        """The loop over one tick of that period [s], in the signals that vanish at rest."""
        here, T = self.at(period), Fixed.around(period)
        _, integral = held(here.A, T)
        first, parts = self.linear.controller, list[Matrix]()
        rows = [v.next is None for v in self.loop.stepped for _ in range(v.symbol.numel())]
        for row, flows in enumerate(rows):
            part = here.L[row : row + 1]
            parts.append(part.times(T) if flows else part)
        parts.append(integral @ here.L[first:])
        stacked = Matrix(np.vstack([m.middle for m in parts]), np.vstack([m.radius for m in parts]))
        return Matrix.identity(self.moving) + here.R @ stacked

    def at(self, period: float) -> Enclosure:
        """Where the loop rests on a clock of that period [s]; once for all where its equations do not read it."""
        if self.linear.clock is not None:
            return self._enclosed(self.linear.on(period).point, period)
        if self._once is None:
            self._once = self._enclosed(self.linear.point, period)
        return self._once

    def _enclosed(self, point: np.ndarray, period: float) -> Enclosure:
        split, T = self.split, [Fixed.around(period)]
        count, size = split.count, len(point)
        x = [Fixed.around(float(value)).middle for value in point]

        def box(reach: int, places: Sequence[int]) -> list[list[Fixed]]:
            ends = [Fixed(value, value) for value in x]
            for place in places:
                ends[place] = Fixed(x[place] - reach, x[place] + reach)
            return [ends, self._p, T]

        def matrix(program: Program, inputs: Sequence[Sequence[Fixed]], rows: int, columns: int) -> Matrix:
            (found,) = program.dense(fixed_values(program, inputs), Fixed(0, 0))
            return Matrix.of([[found[i + rows * j] for j in range(columns)] for i in range(rows)], columns)

        slope = matrix(split.R, box(0, ()), count, size).floats()
        places = _pivots(slope, self._estimates)
        try:
            C = Matrix.exactly(np.linalg.inv(slope[:, places]))
        except np.linalg.LinAlgError:
            raise UndecidedError("the signals that vanish at rest do not decide where it rests") from None
        for _ in range(_STEPS):
            step = C @ matrix(split.y, box(0, ()), count, 1)
            for row, place in enumerate(places):
                x[place] -= step.middle[row, 0]
            if max((abs(value) for value in step.middle.ravel()), default=0) <= _NEAR:
                break
        error = C @ matrix(split.y, box(0, ()), count, 1)
        reach = 2 * max((int(value) for value in (np.abs(error.middle) + error.radius).ravel()), default=0) + _NEAR
        inputs = box(reach, places)
        R = matrix(split.R, inputs, count, size)
        # Krawczyk's test: what lies in here is an equilibrium, and the only one with these estimates
        left = Matrix.identity(count) - C @ R[:, places]
        spread = ((np.abs(left.middle) + left.radius) @ np.full((count, 1), reach, dtype=object)) // ONE + 1
        if np.any(np.abs(error.middle) + error.radius + spread >= reach):
            raise UndecidedError("that the loop has an equilibrium at this point is not proved")
        self._check(inputs)
        L = matrix(split.L, inputs, size, count)
        given, flow = split.flow
        (commands,) = given.dense(fixed_values(given, inputs), Fixed(0, 0))
        first = self.linear.controller
        A = matrix(flow, [inputs[0][first:], commands, self._p], size - first, size - first)
        moved = max((abs(float(Fixed(a, a)) - float(b)) for a, b in zip(x, point, strict=True)), default=0.0)
        return Enclosure(L, R, A, moved + float(Fixed(reach, reach)))

    def _check(self, inputs: Sequence[Sequence[Fixed]]) -> None:
        """No comparison turns out another way nearby, and the tick puts no state back into its set."""
        (turns,) = self.split.guards.stored(fixed_values(self.split.guards, inputs))
        if any(value.lower <= 0 for value in turns):
            raise UndecidedError("it rests where a comparison turns")
        for name, program in self._rests:
            (room,) = program.stored(fixed_values(program, inputs))
            if any(value.lower <= 0 for value in room):
                raise UndecidedError(f"{name} rests at an end of its set")


def _inside(loop: ClosedLoop) -> list[tuple[str, Program]]:
    """Of each state with a set, a column that is above zero inside it."""
    symbols = [loop.state, loop.p, loop.period]
    return [
        (item.name, read(ca.Function("room", symbols, [ca.vec(ca.densify(item.set.room(item.state)))])))
        for item in loop.projections
    ]


def _pivots(R: np.ndarray, estimates: Sequence[bool]) -> list[int]:
    """As many states as there are signals, which these decide: no estimates where others will do."""
    from scipy.linalg import qr

    size = R.shape[0]
    even = R / np.maximum(np.max(np.abs(R), axis=1, initial=0.0), 1e-300)[:, None]
    even = even / np.maximum(np.max(np.abs(even), axis=0, initial=0.0), 1e-300)
    weights = np.where(estimates, 1e-7, 1.0)
    _, _, order = qr(even * weights, mode="economic", pivoting=True)
    return [int(place) for place in order[:size]]


__all__ = ["MOST_STATES", "EnclosedLoop", "Enclosure", "SplitMoves"]
