"""Simulated robots that learn on a path, and then run a turn with a constant estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.block.model import SYMBOLIC
from dmframe.bounds.next_turn import turn_bound
from dmframe.bounds.polytope import least_residual
from dmframe.common.slices import slices
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.results import next_turn as results
from dmframe.results.at_instants import AtInstants
from dmframe.results.next_turn import NextTurn, next_turn
from dmframe.simulate import Recording
from dmframe.simulate.start import start_state
from dmframe.simulate.step import build_step

NOTHING: Mapping[str, Any] = {}
STILL = 1e200
"""A floor of the update steps with which they have no length."""


@dataclass(frozen=True, eq=False)
class Turn:
    """The run, the run with the turn after it, and the tracking errors of that turn, with a constant estimate."""

    recording: Recording
    whole: Recording
    errors: np.ndarray

    @property
    def largest(self) -> float:
        return float(np.max(np.linalg.norm(self.errors, axis=1)))


class Turns:
    """Robots of one graph with other true parameters, without another build of its functions.

    The floor nu of the estimator in `block` is a parameter of the graph.
    """

    def __init__(self, graph: dm.Graph, seconds: float, block: str = "inverse") -> None:
        self.graph, self.floor, self.seconds = graph, f"{block}.nu", seconds
        run = graph.until(4 * (graph.clock or 0.0)).run()
        self.claim, self._first = run.storage.claim, run.recording
        self.loop = self._first.diagram.loop
        with SYMBOLIC:
            goal = self.loop.goal
            assert goal is not None
            self._goal = goal
            shown = stack([goal.found, goal.wanted])
            self.step = build_step(self.loop, graph.clock, graph.solver, shown)
            self.start = start_state(self._first.diagram, graph.start)
        self._places, first = dict[str, slice](), 0
        for item in self.loop.parameters:
            self._places[item.label] = slice(first, first := first + item.symbol.numel())

    def of(self, factors: Mapping[str, Any], turn: float, later: Mapping[str, Any] = NOTHING) -> Turn:
        """A robot whose parameters are multiplied, and a turn of that many seconds after its run.

        `later` are factors for that turn only.
        """
        clock, p, x = self.graph.clock or 0.0, self.loop.p_values.copy(), self.start.copy()
        for label, factor in factors.items():
            p[self._places[label]] *= factor
        count, states, shown = round(self.seconds / clock), list[np.ndarray](), list[np.ndarray]()
        for k in range(count + round(turn / clock) + 1):
            if k == count + 1:
                p[self._places[self.floor]] = STILL
                for label, factor in later.items():
                    p[self._places[label]] *= factor
            states.append(x)
            x, seen = (item.full().ravel() for item in self.step.tick(x, self.step.instants.rows(k, k + 1)[0], p))
            shown.append(seen)
        whole = self._recording(np.array(states), np.array(shown))
        size, last = self._goal.found.numel(), slice(count + 1, None)
        run = self._recording(np.array(states[: last.start]), np.array(shown[: last.start]))
        return Turn(run, whole, np.array([seen[:size] - seen[size:] for seen in shown[last]]))

    def _recording(self, states: np.ndarray, shown: np.ndarray) -> Recording:
        columns = {v.label: states[:, rows] for v, rows in rows_of(self.loop.variables)}
        size, count = self._goal.found.numel(), len(states)
        return replace(
            self._first,
            time=self.step.instants.times(np.arange(count)),
            duration=(count - 1) * self.step.period,
            states={label: columns[label] for label in self._first.states},
            outputs={self._goal.actual: shown[:, :size], self._goal.desired: shown[:, size:]},
            start=self.start,
            instants=self.step.instants,
        )

    def prediction_errors(self, turn: Turn) -> np.ndarray:
        """(N, joints) y - h' theta of the samples of the turn, with its constant estimate."""
        part = next(part for part in self.claim.parts if part.certificate.steps)
        (item,) = part.certificate.steps
        h, y = item.rows[0]
        values = AtInstants(self.claim, turn.whole).of(stack([h, y])).T[-len(turn.errors) :]
        products = values[:, : h.numel()] * turn.whole.states[f"{part.block}.{item.estimate}"][-1]
        joints = [products[:, rows].sum(axis=1) for rows in slices(item.parts)]
        return np.asarray(values[:, h.numel() :] - np.stack(joints, axis=1))

    def bound(self, turn: Turn, eta: Any = None) -> NextTurn:
        return next_turn(turn.recording, self.claim, eta)

    def premise(self, turn: Turn) -> np.ndarray:
        """(joints,) least eta over the observed one, with which one theta explains both turns.

        The rows of the second turn are the predicted ones. At most 1: the premise of the bound holds.
        """
        seen = list[Any]()
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(results, "turn_bound", lambda *given: seen.append(given) or turn_bound(*given))
            self.bound(turn)
        recorded, predicted, _ = seen[0]
        errors, needed = self.prediction_errors(turn), list[float]()
        count = min(len(errors), len(predicted.rows))
        for j, part in enumerate(recorded.joints):
            estimate = recorded.estimate[part]
            lower, upper = recorded.lower[part] - estimate, recorded.upper[part] - estimate
            rows = np.vstack([recorded.rows[:, part], predicted.rows[:count, part]])
            left = np.concatenate([recorded.errors(recorded.estimate)[:, j], errors[:count, j]])
            scale = np.minimum((upper - lower) / 2, 1)
            needed.append(least_residual(rows * scale, left, lower / scale, upper / scale))
        return np.asarray(needed) / recorded.observed
