"""Evaluate expressions of a certificate at the instants of a run; unrecorded sampled states are recomputed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.certify.claim import Claim
from dmframe.common.errors import ValueFault, listed
from dmframe.diagram import Variable
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.simulate import Recording
from dmframe.simulate.instants import DRAWN

CHUNK: Final = 2048
"""Instants evaluated in one call."""


@final
class AtInstants:
    """Run of a certificate, with the run's parameters and trajectories as functions of time.

    In discrete time, a sampled state that was not recorded, such as stored rows, is recomputed from its start by its
    map: 0.08 ms per sample of a UR10.
    """

    def __init__(self, claim: Claim, run: Recording) -> None:
        self.claim, self.run = claim, run

    @cached_property
    def whole(self) -> bool:
        """True for a simulation that recorded every sample."""
        instants, time = self.run.instants, self.run.time
        return instants is not None and bool(np.array_equal(time, instants.times(np.arange(time.size))))

    def of(
        self, column: SX, places: np.ndarray | None = None, more: Sequence[tuple[SX, np.ndarray]] = ()
    ) -> np.ndarray:
        """Values of a column of expressions, (rows, N), at every recorded instant or at those of `places`.

        `more` are further symbols with their values at these instants.

        Raises
        ------
        ValueFault
            The column needs a state that was not recorded and cannot be recomputed: a plant state, or any state of a
            run that is not a simulation or did not record every sample.
        """
        loop = self.claim.loop
        column = loop.on_path(column)
        lost = self._unrecorded(column)
        becomes = loop.on_path(stack(self._next(variable) for variable in lost))
        both = stack([becomes, column])
        read = [v for v in loop.variables if v not in lost and symbols_in([both]) & v.identities]
        given = stack([*(v.symbol for v in read), loop.time, loop.period, loop.drawn, *(x for x, _ in more)])
        moving = stack(variable.symbol for variable in lost)
        becomes, column = ca.substitute([becomes, column], [loop.p], [ca.SX(ca.DM(self.run.diagram.loop.p_values))])
        function = ca.Function("instants", [moving, given], ca.cse([becomes, ca.densify(column)]))
        rows = np.hstack([self._given(read, both, places), *(np.transpose(values) for _, values in more)])
        rows = np.ascontiguousarray(rows, dtype=float)
        return self._iterated(function, rows, self._start(lost)) if lost else _at_once(function, rows)

    def _unrecorded(self, column: SX) -> list[Variable]:
        """Unrecorded states on which the column depends, including those in their maps."""
        missing = [variable for variable in self.claim.loop.variables if variable.label not in self.run.states]
        found, used = list[Variable](), symbols_in([column])
        while more := [v for v in missing if v not in found and used & v.identities]:
            kept = [v.label for v in more if not v.sampled]
            if kept or not self.whole:
                labels = kept or [variable.label for variable in more]
                raise ValueFault(
                    f"V along a run: expected a run that records {listed(labels)}, on which V or its residual depends, "
                    "or a simulation that records every sample; found neither"
                )
            found += more
            used = symbols_in([self.claim.loop.on_path(stack(map(self._next, more)))])
        return found

    def _next(self, variable: Variable) -> SX:
        return self.claim.sample.next[variable.label]

    def _start(self, lost: list[Variable]) -> np.ndarray:
        """Initial values of these states."""
        parts = [self.run.start[rows] for variable, rows in rows_of(self.claim.loop.variables) if variable in lost]
        return np.concatenate([np.zeros(0), *parts])

    def _given(self, read: list[Variable], both: SX, places: np.ndarray | None) -> np.ndarray:
        """(N, columns) recorded states, time, period and random draws."""
        run, drawn = self.run, self.claim.loop.drawn
        count, numbers = run.time.size, np.zeros((run.time.size, drawn.numel()))
        if symbols_in([both]) & symbols_in([drawn]):
            if run.instants is None or not self.whole:
                raise ValueFault("V along a run: expected a simulation that records every sample and its random draws")
            numbers = run.instants.rows(0, count)[:, DRAWN:]
        period = np.full(count, run.clock or 0.0)
        columns = [*(run.states[variable.label] for variable in read), run.time[:, None], period[:, None], numbers]
        found = np.hstack(columns)
        return found if places is None else found[places]

    @staticmethod
    def _iterated(function: ca.Function, given: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Iterate a function of (recomputed states, inputs) -> (next states, values); returns the values."""
        values = np.empty((len(given), function.numel_out(1)))
        now, then = start.copy(), np.empty_like(start)
        buffer, evaluate = function.buffer()
        for k in range(len(given)):
            buffer.set_arg(0, now.data)
            buffer.set_arg(1, given[k].data)
            buffer.set_res(0, then.data)
            buffer.set_res(1, values[k].data)
            evaluate()
            now, then = then, now
        return np.ascontiguousarray(values.T)


def _at_once(function: ca.Function, given: np.ndarray) -> np.ndarray:
    """Values of a function without recomputed states. A memory buffer avoids the conversion of arrays."""
    values, mapped = np.empty((len(given), function.numel_out(1))), cache(function.map)
    for first in range(0, len(given), CHUNK):
        part = slice(first, min(first + CHUNK, len(given)))
        buffer, evaluate = mapped(part.stop - first).buffer()
        buffer.set_arg(1, given[part].data)
        buffer.set_res(1, values[part].data)
        evaluate()
    return np.ascontiguousarray(values.T)


__all__ = ["AtInstants"]
