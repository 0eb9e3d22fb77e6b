"""Limits with an extended state observer: quadratic program of the barrier function, its invariant, and a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy

import dmframe as dm
from dmframe.block import Equations
from dmframe_blocks.extended_state_observer import ExtendedStateObserver
from dmframe_blocks.safe_reference import SafeReference

NAME, T, SECONDS = "ur10_safe_eso", 0.008, 16.0
LOWER, UPPER = np.array([1.3, -2, 0]), np.array([1.75, 0, 2])
APPROACH, BANDWIDTH, MARGIN, D = 3.0, 15.0, 0.005, 0.11


def command(q: float, wish: float, d_hat: float) -> float:
    """The two blocks in series, with almost sharp limits."""
    options = {"lower": -1.0, "upper": 2.0, "speed": 1.5, "approach": APPROACH, "rounding": 1e-4}
    safe, observer = SafeReference(**options), ExtendedStateObserver(bandwidth=[BANDWIDTH])
    dq_r = float(np.ravel(safe.evaluate({"q": [q, 0], "dq_wish": [wish, 0]}, robot="arm2").outputs["dq_r"])[0])
    states = {"q_hat": [q], "d_hat": [d_hat]}
    return float(np.ravel(observer.evaluate({"q": [q], "dq_r": [dq_r]}, states).outputs["dq_c"])[0])


def programmed(q: float, wish: float, d_hat: float) -> float:
    """The command nearest to the observer's with which no distance h = 2 - q, q + 1 decreases faster than allowed."""
    barriers = [
        {"type": "ineq", "fun": lambda u: -(u[0] + d_hat) + APPROACH * (2 - q)},
        {"type": "ineq", "fun": lambda u: (u[0] + d_hat) + APPROACH * (q + 1)},
        {"type": "ineq", "fun": lambda u: 1.5 - (u[0] + d_hat)},
        {"type": "ineq", "fun": lambda u: 1.5 + (u[0] + d_hat)},
    ]
    found = scipy.optimize.minimize(lambda u: (u[0] - (wish - d_hat)) ** 2, [0.0], method="SLSQP", constraints=barriers)
    assert found.success
    return float(found.x[0])


@pytest.mark.parametrize("q", [-0.95, 0.4, 1.9])
@pytest.mark.parametrize("wish", [-3.0, -0.2, 0.7, 4.0])
def test_both_blocks_are_the_quadratic_program_with_the_estimate_in_its_constraints(q: float, wish: float) -> None:
    for d_hat in (0.3, -0.5):
        assert command(q, wish, d_hat) == pytest.approx(programmed(q, wish, d_hat), abs=1e-3)


@pytest.mark.parametrize(("a", "omega"), [(3.0, 15.0), (3.0, 3.0), (8.0, 2.0)])
def test_a_disturbance_that_changes_by_no_more_than_d_costs_2_d_over_approach_and_bandwidth(
    a: float, omega: float
) -> None:
    """From d' to d - d_hat, and to the distance, while the barrier is active: no response changes its sign."""
    error = scipy.signal.TransferFunction([1, 2 * omega], np.poly([-omega, -omega]))
    room = scipy.signal.TransferFunction([1, 2 * omega], np.poly([-omega, -omega, -a]))
    times = np.linspace(0, 40 / min(a, omega), 20_001)
    for system, most in ((error, 2 / omega), (room, 2 / (a * omega))):
        _, response = scipy.signal.impulse(system, T=times)
        assert np.min(response) > -1e-9
        assert np.trapezoid(response, times) == pytest.approx(most, rel=1e-3)
    block, rows = ExtendedStateObserver(bandwidth=[omega]), []
    for q_err, d_err in np.eye(2):
        found = block.evaluate({"q": [q_err], "dq_r": [0.0]}, {"q_hat": [0.0], "d_hat": [-d_err]})
        q_hat_rate, d_hat_rate = (float(np.ravel(found.rates[name])[0]) for name in ("q_hat", "d_hat"))
        dq = float(np.ravel(found.outputs["dq_c"])[0])  # and d = 0
        rows.append([dq - q_hat_rate, -d_hat_rate])
    for s in (0, 1j, 7 + 3j):  # the first of both follows from the block's rates
        of_block = np.linalg.solve(s * np.eye(2) - np.array(rows).T, [0, 1])[1]
        assert of_block == pytest.approx((s + 2 * omega) / (s + omega) ** 2)


def run_of(reality: str = "none", **changes: Any) -> dm.Run:
    graph = dm.load(NAME).set(changes)
    return (graph if reality == "none" else graph.reality(reality)).run(until=SECONDS, progress=False, judge=False)


def faults(run: dm.Run) -> list[str]:
    """Violations of the barrier function in a run: limits, the constraint on each command, or its consequences."""
    q, d_hat = run.data["arm.q"].values, run.data["inverse.d_hat"].values
    dq_c = run.data["inverse.dq_c"].values
    found = []
    if np.min(np.minimum(q - LOWER, UPPER - q)) < 0:
        found.append("limits")
    for room, sign in ((UPPER - MARGIN - q, 1), (q - LOWER - MARGIN, -1)):
        if np.any(sign * (dq_c + d_hat) > APPROACH * room + 1e-9):
            found.append("constraint")
        # d - d_hat over each sample, from two positions and the command; and its possible effect until then
        missed = np.diff(q, axis=0) / T - (dq_c + d_hat)[:-1]
        kept = [room[0]]
        for error in missed:
            kept.append((1 - APPROACH * T) * kept[-1] - T * sign * error)
        if np.any(room < np.array(kept) - 1e-9) or np.any(np.array(kept)[250:] < -np.max(abs(missed[125:])) / APPROACH):
            found.append("tube")
    return sorted(set(found))


@pytest.mark.parametrize("reality", ["none", "ur"])
def test_on_a_run_limits_and_constraint_are_kept_and_the_margin_is_that_of_what_is_assumed(reality: str) -> None:
    run = run_of(reality)
    if reality == "none":  # here the controller reads another q than the true one
        assert faults(run) == []
    q, dq, later = run.data["arm.q"].values, run.data["arm.dq"].values, run.time > 2
    assert np.min(np.minimum(q - LOWER, UPPER - q)) == pytest.approx(5.4e-3, abs=1e-4)
    assert np.max(UPPER[0] - q[later, 0]) > 0.3  # the robot moves
    d = dq - run.data["inverse.dq_c"].values
    assert 0.05 < np.max(abs(np.diff(d[later], axis=0))) / T < D
    assert 2 * D / (APPROACH * BANDWIDTH) <= MARGIN


def test_without_the_filter_the_same_law_goes_far_beyond_a_limit() -> None:
    run = run_of(**{"blocks.safe": None, "wires": {}})
    q = run.data["arm.q"].values
    assert np.min(np.minimum(q - LOWER, UPPER - q)) == pytest.approx(-0.110, abs=1e-3)


def test_a_barrier_with_the_wrong_sign_and_one_without_the_estimate_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    honest, observed = SafeReference.equations, ExtendedStateObserver.equations

    def pushing(self: SafeReference, u: Any, x: Any, p: Any) -> Any:
        outputs = honest(self, u, x, p).outputs
        return Equations(outputs={**outputs, "dq_r": 2 * u.dq_wish - outputs["dq_r"]})

    with monkeypatch.context() as patched:
        patched.setattr(SafeReference, "equations", pushing)
        assert faults(run_of()) == ["constraint", "limits", "tube"]

    def forgetting(self: ExtendedStateObserver, u: Any, x: Any, p: Any) -> Any:
        return Equations(outputs={"dq_c": u.dq_r}, rates=observed(self, u, x, p).rates)

    with monkeypatch.context() as patched:
        patched.setattr(ExtendedStateObserver, "equations", forgetting)
        assert "constraint" in faults(run_of())
    assert faults(run_of()) == []


def test_a_verdict_gives_the_reason_nothing_is_proved_and_what_would_follow_from_an_assumption() -> None:
    verdict = dm.verify(NAME).verdict
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("inverse: an extended_state_observer has no certificate: ")
    assert "2 D/(approach bandwidth)" in verdict.reason
    assert verdict.statements == ()
