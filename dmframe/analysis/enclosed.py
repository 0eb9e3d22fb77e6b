r"""Interval enclosure of the sampled loop, linearised at an equilibrium.

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
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.analysis.linear import Linear, at_speed
from dmframe.analysis.moves import SplitMoves, kept_value, split_moves
from dmframe.analysis.rounding import unrounded
from dmframe.analysis.set_point import counts, frozen
from dmframe.certify.true_values import estimates_of
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.exact.fixed import ONE, Fixed, UndecidedError, fixed_values
from dmframe.exact.matrix import Matrix, held
from dmframe.exact.rows import Row, combined, dense, picked, product, sparse, stored_rows
from dmframe.program import INPUT, Program, read

MOST_STATES: Final = 3000
"""Maximum number of states; larger loops would take minutes."""

FEW: Final = 250
"""Number of signals above which the memory is eliminated."""

_STEPS: Final = 40
_LONG: Final = 10**30
"""Range of sample counters, as a factor on their value at the set-point."""

_NEAR: Final = ONE >> 200
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
    """

    L: Sequence[Row]
    R: Sequence[Row]
    A: Matrix
    within: float


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
            raise UndecidedError(f"it has {len(linear.states)} states, and with more than {MOST_STATES} none is tried")
        self._p = [Fixed.around(float(value)) for value in (at_speed(self.loop) if moving else self.loop.p_values)]
        known = estimates_of(diagram)
        self._estimates = [label.partition("[")[0] in known for label in linear.states]
        self._rests = _inside(self.loop)
        counted = [counts(v) for v in self.loop.variables for _ in range(v.symbol.numel())]
        self._counts = [place for place, grows in enumerate(counted) if grows]
        exactly = [Fixed.around(float(value)) for value in linear.point]
        self._check_room([exactly, self._p, [Fixed.around(clock)]])  # before the check of projections
        self.split = split or split_moves(self.loop, linear.point, self._p, Fixed.around(clock))
        programs = (self.split.y, self.split.L, self.split.R, self.split.guards)
        self._timed = any(node.code == INPUT and node.a == 2 for program in programs for node in program.nodes)
        self._once: Enclosure | None = None
        self._last: tuple[float, Enclosure] | None = None

    @property
    def moving(self) -> int:
        """Number of moving directions; the others are equilibrium coordinates."""
        return self.split.count

    @property
    def kept(self) -> int:
        """Number of invariant sums of states, taken as zero."""
        return len(self.split.kept)

    def transition(self, period: float) -> Matrix:
        """Transition matrix over one period [s], in signals that vanish at the equilibrium, with a reduced memory."""
        here, T = self.at(period), Fixed.around(period)
        _, integral = held(here.A, T)
        first, steps = self.linear.controller, list[Row]()
        rows = [not v.sampled for v in self.loop.stepped for _ in range(v.symbol.numel())]
        for row, flows in enumerate(rows):
            steps.append({place: T * value for place, value in here.L[row].items()} if flows else here.L[row])
        flowing = {k: {first + j: value for j, value in row.items()} for k, row in enumerate(sparse(integral))}
        steps += [combined(row, here.L) for row in flowing.values()]
        moved = product(here.R, steps)
        for place, entries in enumerate(moved):
            one = entries.pop(place, Fixed(0, 0)) + Fixed(ONE, ONE)
            if one.lower or one.upper:
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
        if self.moving > FEW:  # usually the equilibrium is that of the own period, which is much faster to try
            with suppress(UndecidedError):
                return self._enclosed(self.linear.point, period)
        return self._enclosed(self.linear.on(period).point, period)

    def _enclosed(self, point: np.ndarray, period: float) -> Enclosure:
        split, T = self.split, [Fixed.around(period)]
        count, size = split.count, len(point)
        x = [Fixed.around(float(value)).middle for value in point]

        def box(reach: int, places: Sequence[int]) -> list[list[Fixed]]:
            ends = [Fixed(value, value) for value in x]
            for place in places:
                ends[place] = Fixed(x[place] - reach, x[place] + reach)
            for item in split.kept:
                (own, _), *_ = item
                ends[own] = -kept_value({term: factor for term, factor in item.items() if term[0] != own}, ends, T)
            return [ends, self._p, T]

        def slopes(inputs: Sequence[Sequence[Fixed]]) -> list[Row]:
            return stored_rows(split.R, fixed_values(split.R, inputs), count)

        def signals(inputs: Sequence[Sequence[Fixed]], rows: Sequence[int]) -> Matrix:
            (found,) = split.y.dense(fixed_values(split.y, inputs), Fixed(0, 0))
            return Matrix.of([[found[row]] for row in rows], 1)

        slope = slopes(box(0, ()))
        alone = self._alone(slope)
        for place in alone.values():  # the state is that signal, so it is zero
            x[place] = 0
        rows = [row for row in range(count) if row not in alone]
        free = [place for place in range(size) if place not in set(alone.values())]
        few = dense(picked([slope[row] for row in rows], free), len(free)).floats()
        chosen = _pivots(few, [self._estimates[place] for place in free])
        places = [free[k] for k in chosen]
        try:
            C = Matrix.exactly(np.linalg.inv(few[:, chosen]))
        except np.linalg.LinAlgError:
            raise UndecidedError("the signals that vanish at rest do not decide where it rests") from None
        for _ in range(_STEPS):
            step = C @ signals(box(0, ()), rows)
            for row, place in enumerate(places):
                x[place] -= step.middle[row, 0]
            if max((abs(value) for value in step.middle.ravel()), default=0) <= _NEAR:
                break
        error = C @ signals(box(0, ()), rows)
        reach = 2 * max((int(value) for value in (np.abs(error.middle) + error.radius).ravel()), default=0) + _NEAR
        inputs = box(reach, places)
        R = slopes(inputs)
        # Krawczyk's test: this box contains exactly one equilibrium with these estimates
        near = dense(product(sparse(C), picked([R[row] for row in rows], places)), len(places))
        left = Matrix.identity(len(places)) - near
        spread = ((np.abs(left.middle) + left.radius) @ np.full((len(places), 1), reach, dtype=object)) // ONE + 1
        if np.any(np.abs(error.middle) + error.radius + spread >= reach):
            raise UndecidedError("that the loop has an equilibrium at this point is not proved")
        still = signals(inputs, list(alone))
        if np.any(still.middle) or np.any(still.radius):
            raise UndecidedError("a signal that seemed to be a single state is not one")
        self._check(inputs)
        L = stored_rows(split.L, fixed_values(split.L, inputs), size)
        (commands,) = split.held.dense(fixed_values(split.held, inputs), Fixed(0, 0))
        first = self.linear.controller
        (found,) = split.slope.dense(fixed_values(split.slope, [inputs[0][first:], commands, self._p]), Fixed(0, 0))
        flowing = size - first
        A = Matrix.of([[found[i + flowing * j] for j in range(flowing)] for i in range(flowing)], flowing)
        own = {term[0] for item in split.kept for term in list(item)[:1]}
        moved = max(
            (abs(float(Fixed(a, a)) - float(b)) for k, (a, b) in enumerate(zip(x, point, strict=True)) if k not in own),
            default=0.0,
        )
        return Enclosure(L, R, A, moved + float(Fixed(reach, reach)))

    def _alone(self, slope: Sequence[Row]) -> dict[int, int]:
        """In a large loop: signals that are states, each with the state."""
        found = dict[int, int]()
        if self.moving > FEW:
            for row, entries in enumerate(slope):
                ((place, value), *others) = entries.items() if entries else ((0, Fixed(0, 0)),)
                if not others and value.lower == value.upper in (ONE, -ONE) and place not in found.values():
                    found[row] = place
        return found

    def _check(self, inputs: Sequence[Sequence[Fixed]]) -> None:
        """No comparison turns out another way nearby, nor later; and no state is put back into its set."""
        later = [list(column) for column in inputs]
        for place in self._counts:
            later[0][place] = Fixed(inputs[0][place].lower, inputs[0][place].upper * _LONG)
        (turns,) = self.split.guards.stored(fixed_values(self.split.guards, later))
        if any(value.lower <= 0 for value in turns):
            raise UndecidedError("it rests where a comparison turns")
        self._check_room(inputs)

    def _check_room(self, inputs: Sequence[Sequence[Fixed]]) -> None:
        """The tick puts no state back into its set."""
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


def without_store(rows: Sequence[Row]) -> list[Row]:
    """A transition without what it only stores: a smaller one with the same eigenvalues but for some at zero."""
    store = set(_store(rows))
    core = [place for place in range(len(rows)) if place not in store]
    order = {place: k for k, place in enumerate(core)}
    found: list[Row] = [{order[k]: value for k, value in rows[place].items() if k in order} for place in core]
    for reader, place in enumerate(core):
        read = {k: value for k, value in rows[place].items() if k in store}
        if not read:
            continue
        found[reader][len(found)] = Fixed(ONE, ONE)
        while read:  # what is read of the memory: of what it is given now, and of what it then holds
            later = combined(read, rows)
            found.append({order[k]: value for k, value in later.items() if k in order})
            read = {k: value for k, value in later.items() if k in store}
            if read:
                found[-1][len(found)] = Fixed(ONE, ONE)
    return found


def _store(rows: Sequence[Row]) -> list[int]:
    """Those that copy one other, and those that are copied, where none feeds itself in any number of steps."""
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
