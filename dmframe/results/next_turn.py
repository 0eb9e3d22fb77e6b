"""Bound on the error of the next turn of a repeated path, from the samples of a run or of a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.block.model import SYMBOLIC
from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.next_turn import Recorded, TurnBound, turn_bound
from dmframe.bounds.predicted import Prediction
from dmframe.certify.claim import Claim
from dmframe.certify.error_bound import ErrorBound, Share
from dmframe.common.errors import ValueFault
from dmframe.common.text import Text
from dmframe.common.units import plain, rounded_up
from dmframe.diagram.closed_loop import stack
from dmframe.results.at_instants import AtInstants
from dmframe.results.metrics import counted_rows, tracking_error
from dmframe.results.path_figure import last_lap
from dmframe.simulate import Recording
from dmframe.simulate.block_starts import once
from dmframe.simulate.instants import Instants

MOST: Final = 3_000
"""Largest number of linear programs, two for each sample of a turn, joint, and element of the error: 0.7 ms each."""
LARGEST: Final = 60_000
"""Largest number of operations in the map of a sample; differentiating more takes minutes."""
REGULAR: Final = 1e-6
"""Deviation of the times of a drive from whole periods, in periods, up to which they count as regular."""
PREDICTED, PARAMETERS, UNEXPLAINED = (
    "the error that the estimate itself predicts",
    "parameters that the last turn leaves open",
    "what the parameters leave unexplained in the next turn",
)


@final
@dataclass(frozen=True)
class NextTurn:
    """The bound on the next turn, and the limits on which it rests.

    Parameters
    ----------
    bound
        The bound as it is listed with others.
    found
        Its contributions and its limits.
    unit
        Unit of eta.
    """

    bound: ErrorBound
    found: TurnBound
    unit: str

    @property
    def summary(self) -> dict[str, Any]:
        """Data for ``run --json``."""
        return {
            "signal": self.bound.signal,
            "kind": self.bound.kind,
            "over_s": self.bound.over_s,
            "value": self.bound.value,
            "unit": self.bound.unit,
            "disturbance": list(self.bound.disturbance),
            "dominated_by": self.bound.dominated_by.of,
            "lowered_by": list(self.bound.dominated_by.lowered_by),
            "holds": self.bound.holds,
            "eta": list(self.found.eta),
            "eta_unit": self.unit,
            "eta_source": self.found.source,
            "eta_least": list(self.found.least),
        }

    def __str__(self) -> str:
        bound, found = self.bound, self.found
        eta, least = (", ".join(plain(x, self.unit) for x in each) for each in (found.eta, found.least))
        whence = {"observed": "the largest prediction errors of the last turn", "given": "as given"}[found.source]
        size, over = plain(rounded_up(bound.value), bound.unit), plain(bound.over_s, "s")
        return "\n".join(
            [
                f"next turn, from data: |{bound.signal.unicode}| ≤ {size} at the samples of the next {over}, if the "
                "estimate remains that of the end",
                f"  assumes constant parameters that leave at most ({eta}) of a sample unexplained, {whence}; "
                f"the last turn needs ({least})",
                "  of first order in prediction errors; largest contribution: " + bound.dominated_by.of.unicode,
            ]
        )


def next_turn(run: Recording, claim: Claim, eta: float | Sequence[float] | None = None) -> NextTurn:
    """The bound on the next turn of a run.

    Parameters
    ----------
    claim
        Certificate over samples of the diagram that ran.
    eta
        Upper limits of what a sample leaves unexplained, by joint; observed ones by default.

    Raises
    ------
    NoBoundError
        The reason why there is none.
    """
    with SYMBOLIC:
        return _Samples(run, claim).bound(eta)


@final
class _Samples:
    """Samples of a run of a law with one estimate."""

    def __init__(self, run: Recording, claim: Claim) -> None:
        self._run, self._claim = _sampled(run), claim
        found = [(part.block, item) for part in claim.parts for item in part.certificate.steps]
        if len(found) != 1:
            raise NoBoundError(f"expected a law with one estimate, found {len(found)}")
        self._block, self._item = found[0]
        error = tracking_error(self._run)
        if error is None:
            raise NoBoundError("the graph has no goal")
        self._signal, self._error = error.signal, error
        desired = np.asarray(self._run[error.desired])
        self._first = last_lap(self._run.time, desired)
        if not 0 < self._first < len(desired) - 1:
            raise NoBoundError("the run has no full turn of a repeated path")

    def bound(self, eta: float | Sequence[float] | None) -> NextTurn:
        """The bound, with eta for all joints or for each."""
        run, claim, item = self._run, self._claim, self._item
        assert run.clock is not None
        estimate, count = f"{self._block}.{item.estimate}", len(run.time) - 1 - self._first
        goal, rows = self._goal()
        programs = 2 * count * len(item.parts) * rows
        if programs > MOST:
            text = f"a turn of {count} samples and {len(item.parts)} joints needs {programs} linear programs"
            raise NoBoundError(f"{text}; at most {MOST} are solved")
        size = sum(map(ca.n_nodes, claim.sample.next.values()))
        if size > LARGEST:
            raise NoBoundError(f"the map of a sample has {size} operations; at most {LARGEST} are differentiated")
        key = "prediction", estimate, self._error.actual, run.clock, claim.loop.p_values.tobytes()
        prediction = once(claim.loop.derived, key, lambda: Prediction(claim, item, estimate, goal, run.clock or 0.0))
        recorded, s = self._recorded(prediction, estimate)
        q = run.states[prediction.measured]
        turn = prediction.turn(s, q[-1], q[-2], recorded.estimate, float(run.time[-1]), count)
        found = turn_bound(recorded, turn, None if eta is None else _limits(eta, len(item.parts)))
        shares = {PREDICTED: found.predicted, PARAMETERS: found.parameters, UNEXPLAINED: found.unexplained}
        largest = max(shares, key=lambda name: shares[name])
        share = Share(Text(largest), of_start=False)
        over = float(run.time[-1] - run.time[self._first])
        bound = ErrorBound(self._signal, "sup", over, found.value, self._error.unit, (), share, "data")
        return NextTurn(bound, found, self._command_unit())

    def _goal(self) -> tuple[SX, int]:
        """The counted elements of the error as an expression."""
        loop = self._claim.loop
        pair = next(
            pair for pair in loop.goals if (pair.actual, pair.desired) == (self._error.actual, self._error.desired)
        )
        signal = next(signal for signal in loop.outputs if signal.label == pair.actual)
        rows, *_ = counted_rows(self._claim.diagram, signal.shape, signal.unit)
        error = (pair.found - pair.wanted)[rows]
        return error, error.numel()

    def _recorded(self, prediction: Prediction, estimate: str) -> tuple[Recorded, np.ndarray]:
        """The samples of the last turn, and the states s at the last one."""
        claim, item, run = self._claim, self._item, self._run
        variables = {v.label: v.symbol for v in claim.loop.variables}
        states = stack(variables[label] for label in prediction.labels)
        h, y = item.rows[0]
        if not item.box:
            raise NoBoundError(
                "an estimate without a box admits any parameters in directions that a turn does not show"
            )
        columns = [states, h, y, *item.box]
        values = AtInstants(claim, run).of(stack(columns)).T
        s, rows, goals, lower, upper = np.split(values, np.cumsum([column.numel() for column in columns])[:-1], axis=1)
        last = slice(self._first, None)
        estimates = run.states[estimate]
        recorded = Recorded(
            rows[last], goals[last], estimates[last], estimates[-1], tuple(item.parts), lower[-1], upper[-1]
        )
        if not all(np.all(np.isfinite(each)) for each in (recorded.rows, recorded.goals, recorded.estimates)):
            raise NoBoundError("the run is not finite")
        return recorded, s[-1]

    def _command_unit(self) -> str:
        """Unit of the rows' values: that of the command."""
        commands = {leaf.name for leaf in self._claim.loop.commanded}
        units = {signal.unit for signal in self._claim.loop.outputs if signal.label in commands}
        return units.pop() if len(units) == 1 else ""


def _limits(eta: float | Sequence[float], joints: int) -> list[float]:
    """The limits by joint. Raises `ValueFault` for another number of them, or one that is not above zero."""
    found = [eta] * joints if isinstance(eta, int | float) else list(eta)
    if len(found) != joints or not all(math.isfinite(x) and x > 0 for x in found):
        raise ValueFault(f"eta: expected one number above zero, or one for each of {joints} joints, found {eta}")
    return found


def _sampled(run: Recording) -> Recording:
    """The run, or a drive with regular samples as if it were one; others are refused."""
    if run.clock is None:
        raise NoBoundError("the graph has no clock")
    if run.divergence is not None or len(run.time) < 2:
        raise NoBoundError("the run diverged" if run.divergence is not None else "the run has no samples")
    instants = run.instants or Instants.of(run.diagram.loop, run.clock)
    times = instants.times(np.arange(len(run.time)))
    if instants.jitter:
        raise NoBoundError("samples are not one period apart: they have a jitter")
    if np.max(np.abs(run.time - times)) > REGULAR * run.clock:
        raise NoBoundError("samples are missing, or are not one period apart")
    if not run.start.size:
        raise NoBoundError("one of several samples was kept, or the initial states were not")
    measured = {v.label: run.outputs[v.label] for v in run.diagram.loop.flowing if v.label in run.outputs}
    return replace(run, time=times, instants=instants, states={**measured, **run.states})
