"""Bound on the next turn from data: linear programs against SciPy, and turns of simulated robots."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import linprog

import dmframe as dm
from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.frozen import with_constant
from dmframe.bounds.next_turn import Recorded, turn_bound
from dmframe.bounds.polytope import Polytope, least_residual
from dmframe.bounds.predicted import Turn as PredictedTurn
from dmframe.common.errors import ValueFault
from dmframe.results import next_turn as results
from tests.framework.bounds.turns import Turn, Turns

TURN = 3.16
OTHER = {"servo.K_D": 1.2, "servo.K_P": [1.1, 1.3], "arm.coulomb": 0.5, "arm.viscous": 1.4}
ARM = {
    "robot": "arm2",
    "clock": "40 ms",
    "duration": "16 s",
    "start": {"q": [-0.15312, 1.32528]},
    "blocks": {
        "path": {"type": "circle", "center": [0.6, 0.2], "radius": 0.1, "rate": "2 rad/s"},
        "task": {"type": "sampled_tracking", "Lambda": 5},
        "inverse": {"type": "sampled_inverse", "w_0": 0.02, "replay": 5},
        "servo": {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]},
        "arm": {"type": "manipulator", "viscous": [1, 0.5], "coulomb": [0.5, 0.2]},
    },
}


@cache
def graph() -> dm.Graph:
    return dm.load({"dmframe": 1, **ARM})


def polytope(rng: np.random.Generator, n: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Inequalities |a'z - b| <= 0.1 about a point of the box of half-width 1."""
    a, inside = rng.normal(size=(rows, n)), rng.uniform(-0.9, 0.9, n)
    left = a @ inside + rng.uniform(-0.09, 0.09, rows)
    return np.vstack([a, -a]), np.concatenate([left + 0.1, 0.1 - left])


@pytest.mark.parametrize("seed", range(4))
def test_the_top_of_a_polytope_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 3 + 4 * seed
    A, b = polytope(rng, n, 40)
    own = Polytope(A, b, -np.ones(n), np.ones(n))
    for p in np.cumsum(rng.normal(size=(12, n)), axis=0):
        found = -linprog(-p, A_ub=A, b_ub=b, bounds=(-1, 1), method="highs-ipm").fun
        assert abs(own.top(p) - found) <= 1e-6 * np.sum(np.abs(p))
    assert own.pivots > 0


def test_any_multipliers_give_an_upper_end(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    A, b = polytope(rng, 5, 30)
    own = Polytope(A, b, -np.ones(5), np.ones(5))
    p = rng.normal(size=5)
    least = own.top(p)
    monkeypatch.setattr(Polytope, "_walked", lambda self, p: rng.uniform(size=len(self._b)) * 0.1)
    assert all(own.top(p) >= least for _ in range(20))
    monkeypatch.setattr(Polytope, "_walked", lambda self, p: None)  # the walk did not end: HiGHS
    assert own.top(p) == pytest.approx(least, rel=1e-6)


def test_an_empty_polytope_is_refused_and_the_least_residual_shows_it() -> None:
    A, b = np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([0.5, -0.5])
    ends = -np.ones(2), np.ones(2)
    assert least_residual(A, b, *ends) == pytest.approx(0.5)
    with pytest.raises(NoBoundError, match="empty"):
        Polytope(np.vstack([A, -A]), np.concatenate([b + 0.4, 0.4 - b]), *ends)
    Polytope(np.vstack([A, -A]), np.concatenate([b + 0.6, 0.6 - b]), *ends)


def test_a_constant_estimate_replaces_its_next_value_wherever_it_is_used() -> None:
    x, theta, other = ca.SX.sym("x", 2), ca.SX.sym("theta", 2), ca.SX.sym("other")
    after = ca.fmin(ca.fmax(theta + x * other, -1), 1)
    again = ca.fmin(ca.fmax(theta + other * x, -1), 1)  # built a second time
    law = ca.vertcat(ca.dot(after, x) / (1 + again[0] * again[0]), ca.sin(other), theta[1] + after[1])
    constant = with_constant([x, theta, other], after, theta, law)
    expected = ca.vertcat(ca.dot(theta, x) / (1 + theta[0] * theta[0]), ca.sin(other), 2 * theta[1])
    both = ca.Function("both", [x, theta, other], [constant, expected])
    found, wanted = both([0.3, -0.7], [0.2, 0.4], 5.0)
    np.testing.assert_allclose(found, wanted, rtol=1e-15)


@cache
def turns() -> Turns:
    return Turns(graph(), 10.0)


@cache
def turned() -> Turn:
    return turns().of({}, TURN)


@cache
def predicted() -> tuple[Recorded, PredictedTurn]:
    """What the bound of `turned` is computed from."""
    seen = list[Any]()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(results, "turn_bound", lambda *given: seen.append(given) or turn_bound(*given))
        turns().bound(turned())
    recorded, turn, _ = seen[0]
    return recorded, turn


def test_no_turn_with_a_constant_estimate_exceeds_the_bound() -> None:
    bound = turns().bound(turned())
    assert bound.bound.over_s == pytest.approx(TURN, abs=0.03)
    assert turned().largest < bound.bound.value < 6 * turned().largest
    other = turns().of(OTHER, TURN)
    assert other.largest < turns().bound(other).bound.value


def test_the_premise_of_the_bound_is_nearly_met_and_fails_with_the_bound_if_friction_changes() -> None:
    """One parameter explains both turns up to little more than the observed eta, unless the robot is another one."""
    assert np.max(turns().premise(turned())) < 1.2
    other = turns().of({}, TURN, later={"arm.coulomb": 5, "servo.K_P": 0.5})
    assert np.max(turns().premise(other)) > 3
    assert other.largest > turns().bound(other).bound.value


def test_the_error_of_a_simulated_turn_is_the_predicted_one_moved_by_its_prediction_errors() -> None:
    """Up to products of them; the prediction knows the controller and its estimate, not the plant."""
    _, turn = predicted()
    errors = turns().prediction_errors(turned())
    count = min(len(errors), len(turn.errors))
    moved = np.einsum("kmij,ij->km", turn.gains[:count, :, :count], errors[:count])
    off = np.max(np.abs(turned().errors[:count] - turn.errors[:count] - moved))
    assert off < 0.1 * turned().largest
    assert np.max(np.abs(turned().errors[:count] - turn.errors[:count])) > 0.5 * turned().largest


def test_contributions_that_are_left_out_are_detected() -> None:
    """Without the gains, or with those of one sample only, the simulated turn exceeds the bound."""
    recorded, turn = predicted()
    whole = turn_bound(recorded, turn).value
    alone = replace(turn, gains=np.zeros_like(turn.gains))
    assert turn_bound(recorded, alone).value < turned().largest < whole
    first = np.zeros_like(turn.gains)
    for k in range(len(first)):
        first[k, :, k] = turn.gains[k, :, k]  # the prediction error of the present sample only
    assert turn_bound(recorded, replace(turn, gains=first)).value < turned().largest


def test_a_larger_eta_gives_a_larger_bound_and_one_that_is_too_small_is_refused() -> None:
    recorded, turn = predicted()
    assert recorded.observed == pytest.approx(turns().bound(turned()).found.eta)
    bounds = [turn_bound(recorded, turn, factor * recorded.observed).value for factor in (0.8, 1, 2)]
    assert bounds == sorted(bounds)
    least = np.array(turns().bound(turned()).found.least)
    with pytest.raises(NoBoundError, match="the smallest limit is"):
        turn_bound(recorded, turn, 0.9 * least)
    with pytest.raises(NoBoundError, match="grows without limit"):
        turn_bound(recorded, replace(turn, gains=np.full_like(turn.gains, np.inf)))
    with pytest.raises(ValueFault, match="expected one number above zero, or one for each of 2 joints"):
        turns().bound(turned(), eta=[1e-3, 1e-3, 1e-3])
    assert turns().bound(turned(), eta=0.01).found.source == "given"


def test_a_run_and_a_drive_of_the_same_samples_print_the_same_bound() -> None:
    run, drive = graph().until(8).run(), graph().until(8).drive("sim")
    (data,), (same,) = run.bounds, drive.bounds
    assert same["value"] == pytest.approx(data["value"], rel=1e-6)
    assert (data["signal"], data["kind"], data["unit"], data["holds"]) == ("x - x_d", "sup", "m", "data")
    assert data["eta"] == pytest.approx(same["eta"], rel=1e-6)
    assert data["eta_source"] == "observed"
    assert data["over_s"] == pytest.approx(TURN, abs=0.03)
    assert run.summary["bounds"] == [data]
    (text,) = run.bounded
    assert "next turn, from data: |x − x_d| ≤ " in text
    assert "assumes constant parameters that leave at most (" in text
    assert text in str(run)
    assert text in str(drive)


@pytest.mark.parametrize(
    ("changed", "seconds", "reason"),
    [
        ({}, 3, "the run has no full turn of a repeated path"),
        ({"log": {"every": 2}}, 8, "samples are missing, or are not one period apart"),
        ({"jitter": "1 ms"}, 8, "samples are not one period apart: they have a jitter"),
        ({"reality": {"encoder": {"step": 1e-5}}}, 8, "its rows do not vary with the positions"),
        ({"inverse.settling": 100}, 8, "its rows do not vary with the positions"),
    ],
    ids=["short", "decimated", "jitter", "rounded", "constant"],
)
def test_a_run_without_a_bound_has_the_reason(changed: dict[str, Any], seconds: float, reason: str) -> None:
    run = (graph().set(changed) if changed else graph()).until(seconds).run()
    assert (run.bounds, run.bounded) == ([], [])
    (text,) = run.bounds_missing
    assert text.startswith(reason)


def test_a_law_without_update_steps_has_neither_a_bound_nor_a_reason() -> None:
    run = dm.load("arm2_joint").until(0.1).run()
    assert (run.bounds, run.bounds_missing) == ([], [])
