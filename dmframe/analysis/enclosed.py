r"""Enclosure of the sampled loop in ball arithmetic, linearised at an equilibrium.

The plant evolves between samples with held commands, so near the equilibrium, with H the integral of its transition,

.. math:: F - 1 = \mathrm{diag}(T, 1, H)\, \frac{\partial g}{\partial x} = D L R,

T for continuous-time controller states, 1 for sampled ones, H for plant states; L and R as in
`dmframe.analysis.moves`. Hence F has the eigenvalue one as many times as it has more states than y signals, and else
the eigenvalues of 1 + R D L: in the signals y, which the states follow, the loop is that smaller matrix.

Signals that only store others form a memory (delay line) with a structurally nilpotent matrix N. The other signals read
it through a few sums E y, whose later values depend on the current ones, so E N^j y, j = 0, 1, ..., replace the
memory, with the same eigenvalues except some at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

import casadi as ca
import numpy as np
from flint import arb, arb_mat

from dmframe.analysis.linear import Linear, at_speed
from dmframe.analysis.moves import SplitMoves, kept_value, split_moves
from dmframe.analysis.rounding import unrounded
from dmframe.analysis.set_point import counts, frozen
from dmframe.certify.true_values import estimates_of
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.exact.ball_matrix import exactly, identity, middles, transition
from dmframe.exact.balls import ONE, ZERO, UndecidedError, above, ball, below, enclosed, precise
from dmframe.exact.ranges import ranges
from dmframe.exact.rational import Interval
from dmframe.exact.rows import Row, combined, dense, picked, product, sparse, stored_rows
from dmframe.program import INPUT, Program, read

MOST_STATES: Final = 3000
"""Maximum number of states; larger loops would take minutes."""

FEW: Final = 250
"""Number of signals above which the memory is eliminated."""

_STEPS: Final = 40
_LONG: Final = 10**30
"""Range of sample counters, as a factor on their value at the set-point."""

_NEAR: Final = arb((1, -200))
"""Tolerance of Newton's method."""


@final
@dataclass(frozen=True)
class Enclosure:
    """Enclosure of the linearised loop at a proved equilibrium.

    Parameters
    ----------
    L, R, A
        Factors of the moves, and Jacobian of the plant.
    within
        Bound on the distance of the equilibrium from the given point, in the units of the states.
    box
        Balls of the states at the equilibrium, of the parameters, and the period.
    """

    L: Sequence[Row]
    R: Sequence[Row]
    A: arb_mat
    within: float
    box: Sequence[Sequence[arb]]


@final
class EnclosedLoop:
    """Linearised loop whose transition matrix can be enclosed for every period.

    `split` may come from the same loop with other parameters: it is an identity whose guards are checked again.

    Raises `UndecidedError` for a loop that is too large, at rest at a switching point, or with operations without
    enclosures.
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
        self.linear, self.loop = linear, unrounded(frozen(diagram)).loop
        if len(linear.states) > MOST_STATES:
            raise UndecidedError(f"it has {len(linear.states)} states; the proof is limited to {MOST_STATES}")
        self._p = [ball(float(value)) for value in (at_speed(self.loop) if moving else self.loop.p_values)]
        known = estimates_of(diagram)
        self._estimates = [label.partition("[")[0] in known for label in linear.states]
        self._rests = _inside(self.loop)
        counted = [counts(v) for v in self.loop.variables for _ in range(v.symbol.numel())]
        self._counts = [place for place, grows in enumerate(counted) if grows]
        point = [ball(float(value)) for value in linear.point]
        self._check_room([point, self._p, [ball(clock)]])  # before the check of projections
        self.split = split or split_moves(self.loop, linear.point, self._p, ball(clock))
        programs = (self.split.y, self.split.L, self.split.R, self.split.guards)
        self._timed = any(node.code == INPUT and node.a == 2 for program in programs for node in program.nodes)
        self._once: Enclosure | None = None
        self._last: tuple[float, Enclosure] | None = None

    @property
    def numbers(self) -> list[float]:
        """The parameters in floating point."""
        return [float(value) for value in self._p]

    @property
    def moving(self) -> int:
        """Number of moving directions; the others are equilibrium coordinates."""
        return self.split.count

    @property
    def kept(self) -> int:
        """Number of invariant sums of states, taken as zero."""
        return len(self.split.kept)

    @precise()
    def transition(self, period: float) -> arb_mat:
        """Transition matrix over one period [s], in signals that vanish at the equilibrium, with a reduced memory."""
        here, T = self.at(period), ball(period)
        _, integral = transition(here.A, T)
        first, steps = self.linear.controller, list[Row]()
        rows = [not v.sampled for v in self.loop.stepped for _ in range(v.symbol.numel())]
        for row, flows in enumerate(rows):
            steps.append({place: T * value for place, value in here.L[row].items()} if flows else here.L[row])
        flowing = {k: {first + j: value for j, value in row.items()} for k, row in enumerate(sparse(integral))}
        steps += [combined(row, here.L) for row in flowing.values()]
        moved = product(here.R, steps)
        for place, entries in enumerate(moved):
            one = entries.pop(place, ZERO) + ONE
            if not one.is_zero():
                entries[place] = one
        if self.moving > FEW:
            moved = without_store(moved)
        return dense(moved, len(moved))

    def at(self, period: float) -> Enclosure:
        """Equilibrium for that period [s]; computed once if the equations do not depend on the period."""
        if self.linear.clock is not None or self._timed:
            if self._last is None or self._last[0] != period:
                self._last = period, self._on(period)
            return self._last[1]
        if self._once is None:
            self._once = self._enclosed(self.linear.point, period)
        return self._once

    def _on(self, period: float) -> Enclosure:
        if self.moving > FEW:  # the equilibrium is usually that of the graph's own period; trying it first is faster
            with suppress(UndecidedError):
                return self._enclosed(self.linear.point, period)
        return self._enclosed(self.linear.on(period).point, period)

    @precise()
    def _enclosed(self, point: np.ndarray, period: float) -> Enclosure:
        split, T = self.split, [ball(period)]
        count, size = split.count, len(point)
        x = [ball(float(value)).mid() for value in point]

        def box(reach: arb, places: Sequence[int]) -> list[list[arb]]:
            ends = list(x)
            for place in places:
                ends[place] = x[place] + reach
            for item in split.kept:
                (own, _), *_ = item
                ends[own] = -kept_value({term: factor for term, factor in item.items() if term[0] != own}, ends, T)
            return [ends, self._p, T]

        def slopes(inputs: Sequence[Sequence[arb]]) -> list[Row]:
            return stored_rows(split.R, enclosed(split.R, inputs), count)

        def signals(inputs: Sequence[Sequence[arb]], rows: Sequence[int]) -> arb_mat:
            (found,) = split.y.dense(enclosed(split.y, inputs), ZERO)
            return arb_mat(len(rows), 1, [found[row] for row in rows])

        slope = slopes(box(ZERO, ()))
        alone = self._alone(slope)
        for place in alone.values():  # the state is that signal, so it is zero
            x[place] = ZERO
        rows = [row for row in range(count) if row not in alone]
        free = [place for place in range(size) if place not in set(alone.values())]
        few = middles(dense(picked([slope[row] for row in rows], free), len(free)))
        chosen = _pivots(few, [self._estimates[place] for place in free])
        places = [free[k] for k in chosen]
        try:
            C = exactly(np.linalg.inv(few[:, chosen]))
        except np.linalg.LinAlgError:
            raise UndecidedError("the signals that vanish at rest do not determine the equilibrium") from None
        for _ in range(_STEPS):
            steps = (C * signals(box(ZERO, ()), rows)).mid().entries()
            for step, place in zip(steps, places, strict=True):
                x[place] = (x[place] - step).mid()
            if all(abs(step) <= _NEAR for step in steps):
                break
        error = C * signals(box(ZERO, ()), rows)
        reach = arb(0, 2 * max((value.abs_upper() for value in error.entries()), default=ZERO) + _NEAR)
        inputs = box(reach, places)
        R = slopes(inputs)
        # Krawczyk's test: this box contains exactly one equilibrium with these estimates
        near = dense(product(sparse(C), picked([R[row] for row in rows], places)), len(places))
        moved = (identity(len(places)) - near) * arb_mat(len(places), 1, [reach] * len(places)) - error
        if not (reach.is_finite() and all(reach.contains_interior(value) for value in moved.entries())):
            raise UndecidedError("the existence of an equilibrium at this point is not proved")
        if not all(value.is_zero() for value in signals(inputs, list(alone)).entries()):
            raise UndecidedError("a signal that seemed to be a single state is not one")
        self._check(inputs)
        L = stored_rows(split.L, enclosed(split.L, inputs), size)
        (commands,) = split.held.dense(enclosed(split.held, inputs), ZERO)
        first = self.linear.controller
        (found,) = split.slope.dense(enclosed(split.slope, [inputs[0][first:], commands, self._p]), ZERO)
        flowing = size - first
        A = arb_mat(flowing, flowing, found).transpose()
        own = {term[0] for item in split.kept for term in list(item)[:1]}
        away = [(a - float(b)).abs_upper() for k, (a, b) in enumerate(zip(x, point, strict=True)) if k not in own]
        return Enclosure(L, R, A, above(max(away, default=ZERO) + reach), inputs)

    def _alone(self, slope: Sequence[Row]) -> dict[int, int]:
        """Signals of a large loop that equal a state, each with that state."""
        found = dict[int, int]()
        if self.moving > FEW:
            for row, entries in enumerate(slope):
                ((place, value), *others) = entries.items() if entries else ((0, ZERO),)
                if not others and abs(value) == 1 and place not in found.values():
                    found[row] = place
        return found

    def _check(self, inputs: Sequence[Sequence[arb]]) -> None:
        """Check that no comparison changes nearby or later, and that no projection is active."""
        if not self._counts:
            (turns,) = self.split.guards.stored(enclosed(self.split.guards, inputs))
            decided = all(turn > 0 for turn in turns)
        else:  # balls have no wide range with a sharp end
            later = [[Interval(Fraction(below(x)), Fraction(above(x))) for x in column] for column in inputs]
            for place in self._counts:
                later[0][place] = Interval(later[0][place].lower, later[0][place].upper * _LONG)
            decided = all(turn.lower > 0 for turn in ranges(self.split.guards, later))
        if not decided:
            raise UndecidedError("its equilibrium is at a switching point of a comparison")
        self._check_room(inputs)

    def _check_room(self, inputs: Sequence[Sequence[arb]]) -> None:
        """Check that no projection is active at the equilibrium."""
        for name, program in self._rests:
            (room,) = program.stored(enclosed(program, inputs))
            if not all(value > 0 for value in room):
                raise UndecidedError(f"{name} is at the boundary of its set at the equilibrium")


def _inside(loop: ClosedLoop) -> list[tuple[str, Program]]:
    """Name of each projected state, with a column of values that are positive inside its set."""
    symbols = [loop.state, loop.p, loop.period]
    return [
        (item.name, read(ca.Function("room", symbols, [ca.vec(ca.densify(item.set.room(item.state)))])))
        for item in loop.projections
    ]


def _pivots(R: np.ndarray, estimates: Sequence[bool]) -> list[int]:
    """Indices of states that determine the signals, estimates only where no other state does."""
    from scipy.linalg import qr

    size = R.shape[0]
    even = R / np.maximum(np.max(np.abs(R), axis=1, initial=0.0), 1e-300)[:, None]
    even = even / np.maximum(np.max(np.abs(even), axis=0, initial=0.0), 1e-300)
    weights = np.where(estimates, 1e-7, 1.0)
    _, _, order = qr(even * weights, mode="economic", pivoting=True)
    return [int(place) for place in order[:size]]


def without_store(rows: Sequence[Row]) -> list[Row]:
    """Transition without its memory: a smaller matrix with the same eigenvalues except some at zero."""
    store = set(_store(rows))
    core = [place for place in range(len(rows)) if place not in store]
    order = {place: k for k, place in enumerate(core)}
    found: list[Row] = [{order[k]: value for k, value in rows[place].items() if k in order} for place in core]
    for reader, place in enumerate(core):
        read = {k: value for k, value in rows[place].items() if k in store}
        if not read:
            continue
        found[reader][len(found)] = ONE
        while read:  # the part of the memory that is read: of its inputs, then of its stored values
            later = combined(read, rows)
            found.append({order[k]: value for k, value in later.items() if k in order})
            read = {k: value for k, value in later.items() if k in store}
            if read:
                found[-1][len(found)] = ONE
    return found


def _store(rows: Sequence[Row]) -> list[int]:
    """Rows that copy one other, and those that are copied, without feedback in any number of steps."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    copies = [place for place, row in enumerate(rows) if len(row) <= 1 and place not in row]
    sources = {k for place in copies for k in rows[place] if k not in rows[k]}
    store = sorted(sources.union(copies))
    if not store:
        return []
    order = {place: k for k, place in enumerate(store)}
    pairs = [(order[place], order[k]) for place in store for k in rows[place] if k in order]
    ends = tuple(zip(*pairs, strict=True)) if pairs else ((), ())
    graph = csr_array((np.ones(len(pairs), dtype=np.int8), ends), shape=(len(store), len(store)))
    _, groups = connected_components(graph, connection="strong")
    alone = np.bincount(groups)[groups] == 1
    return [place for place, single in zip(store, alone, strict=True) if single]


__all__ = ["MOST_STATES", "EnclosedLoop", "Enclosure", "SplitMoves", "without_store"]
