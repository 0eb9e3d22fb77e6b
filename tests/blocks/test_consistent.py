"""Physically consistent estimates: the law, its step in discrete time, runs, and the proof."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from faulty import verdict_with

import dmframe as dm
from dmframe.certify import claim_of
from dmframe.results.along import along
from dmframe.robot.pseudo_inertia import dual, natural_gain, parameters_of, pseudo_inertia
from dmframe_blocks._bodies import moved, natural, weight

BODY = [3, 0.4, -0.3, 0.5, 0.9, 0.02, 1.0, -0.03, 0.01, 0.8]
"""Parameters of a body with a margin to all constraints."""


def matrix(a: object) -> np.ndarray:
    return np.array(pseudo_inertia(list(a)), dtype=float)  # type: ignore[call-overload]


def least(rows: np.ndarray, links: int) -> float:
    """The least eigenvalue of all pseudo-inertias of a run's estimates."""
    bodies = [matrix(row[10 * k : 10 * k + 10]) for row in rows for k in range(links)]
    return float(np.min(np.linalg.eigvalsh(np.array(bodies))))


def law(a: np.ndarray, g: np.ndarray, c: float, Gamma: float) -> tuple[np.ndarray, np.ndarray]:
    found = moved(ca.SX(a), ca.SX(g), 1, ca.SX(c), ca.SX(Gamma))
    rate, second = (ca.DM(ca.evalf(item)).full().ravel() for item in found)
    return rate, second


def test_the_dual_pairs_with_parameters_as_the_trace_does_and_the_matrix_has_its_parameters() -> None:
    rng = np.random.default_rng(0)
    g, a = rng.normal(size=10), rng.normal(size=10)
    Q = np.array(dual(list(g)), dtype=float)
    np.testing.assert_allclose(Q, Q.T)
    np.testing.assert_allclose(np.trace(Q @ matrix(a)), g @ a)
    np.testing.assert_allclose(list(parameters_of(matrix(a).tolist())), a)


def test_the_law_is_the_gradient_in_the_metric_of_the_estimate_itself() -> None:
    rng = np.random.default_rng(1)
    g, c, Gamma = rng.normal(size=12), 0.7, 5.0
    gain = np.array(natural_gain([Fraction(str(value)) for value in BODY]), dtype=float)
    rate, _ = law(np.array([*BODY, 1.0, 2.0]), g, c, Gamma)
    np.testing.assert_allclose(rate, [*(-c * gain @ g[:10]), *(-Gamma * g[10:])], rtol=1e-12)


@pytest.mark.parametrize("T", [0.001, 0.1, 3.0])
def test_a_step_on_a_clock_is_a_congruence_that_leaves_no_body_behind(T: float) -> None:
    rng = np.random.default_rng(2)
    g, c, a = 5 * rng.normal(size=10), 0.7, np.array(BODY)
    rate, second = law(a, g, c, 1.0)
    P, Q = matrix(a), np.array(dual(list(g)), dtype=float)
    A = np.eye(4) - c * T / 2 * P @ Q
    stepped = matrix(a + T * rate + T**2 * second)
    np.testing.assert_allclose(stepped, A @ P @ A.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(stepped)[0] > 0
    if T == 3.0:
        assert np.linalg.eigvalsh(matrix(a + T * rate))[0] < 0  # a step without projection would leave it


def test_the_least_eigenvalue_stays_above_zero_where_the_gradients_does_not() -> None:
    graph = dm.load("ur10_consistent")
    run = graph.run()  # all of it
    estimates = run.data["dynamics.a_d_hat"].values
    assert least(estimates[::5], 3) > 0.005
    np.testing.assert_allclose(matrix(estimates[0, :10]), matrix(estimates[0, :10]).T)
    gradient = graph.set({"blocks.dynamics": {"type": "dynamic_compensator", "Gamma": 100}}).run(until=40)
    assert least(gradient.data["dynamics.a_d_hat"].values[::5], 3) < -1
    error = np.linalg.norm(run.data["arm.x"].values - run.data["path.x_d"].values, axis=1)
    assert np.sqrt(np.mean(error[-1000:] ** 2)) < 2e-3


def test_it_is_proved_and_v_falls_along_a_run_in_continuous_time() -> None:
    graph = dm.load("ur10_consistent")
    found = graph.verify()
    assert found.proved
    assert len(found.verdict.controls) == sum(control.refuted for control in found.verdict.controls) == 29
    kept = [item.signal for item in found.verdict.statements if item.says.startswith("stays in a compact set")]
    assert kept == ["P_hat_1", "P_hat_2", "P_hat_3"]
    continuous = graph.set({"clock": "continuous"})
    run = continuous.run(until=1)
    assert found.verdict.kappa is not None
    V = along(claim_of(continuous.diagram), run.recording, float(found.verdict.kappa.chosen))
    by_name = {term.of: term.values for term in V.terms}
    assert V.largest_increase < 1e-9 * V.V[0]
    P = matrix(run.data["dynamics.a_d_hat"].values[-1, 10:20])
    true = matrix(continuous.diagram.robot.inertia[1])
    ratios = np.linalg.eigvals(np.linalg.solve(P, true)).real
    divergence = float(found.verdict.kappa.chosen) * np.sum(ratios - 1 - np.log(ratios))  # c is 1
    np.testing.assert_allclose(by_name["P_hat_2"][-1], divergence, rtol=1e-9)


def test_the_torque_form_no_longer_assumes_that_the_estimated_mass_matrix_has_an_inverse() -> None:
    def assumed(name: str) -> list[str]:
        found = dm.load(name).verify()
        assert found.proved
        return [item.text for item in found.assumptions if "M_hat" in item.text]

    assert len(assumed("torque_direct_pi")) == 2
    assert assumed("torque_consistent_pi") == []


def test_with_a_residual_it_is_assumed_again() -> None:
    graph = dm.load("torque_consistent_pi").set({"inverse.leak": 0.1})
    texts = [item.text for item in graph.verify().assumptions]
    assert any("M_hat stays positive definite" in text for text in texts)
    assert any("stays positive definite, although V may rise" in text for text in texts)


def part(rows: np.ndarray, nominal: np.ndarray) -> float:
    """The least eigenvalue of P0^-1 P over all estimated links of a run."""
    found = [
        np.linalg.eigvals(np.linalg.solve(matrix(body), np.array([matrix(row) for row in rows[:, own]]))).real.min()
        for k, body in enumerate(nominal.reshape(-1, 10))
        for own in [slice(10 * k, 10 * k + 10)]
    ]
    return float(min(found))


def half_of_the_model(graph: dm.Graph) -> np.ndarray:
    return 0.5 * np.array(graph.diagram.robot.inertia, dtype=float).ravel()


def test_with_a_floor_the_law_is_the_gradient_in_the_metric_of_the_nominal_body() -> None:
    rng = np.random.default_rng(3)
    g, c, Gamma = rng.normal(size=12), 0.7, 5.0
    gain = np.array(natural_gain([Fraction(str(value)) for value in BODY]), dtype=float)
    nominal = ca.SX([*BODY, 0.0, 0.0])
    rate = ca.DM(ca.evalf(natural(ca.SX(g), nominal, 1, ca.SX(c), ca.SX(Gamma)))).full().ravel()
    np.testing.assert_allclose(rate, [*(-c * gain @ g[:10]), *(-Gamma * g[10:])], rtol=1e-12)
    metric = ca.DM(ca.evalf(ca.densify(weight(nominal, 1, ca.SX(c), ca.SX(Gamma))))).full()
    expected = np.zeros((12, 12))
    expected[:10, :10], expected[10, 10], expected[11, 11] = np.linalg.inv(gain) / c, 1 / Gamma, 1 / Gamma
    np.testing.assert_allclose(metric, expected, rtol=1e-8, atol=1e-10)


def test_with_a_floor_no_estimated_body_is_ever_less_of_its_nominal_one() -> None:
    graph = dm.load("ur10_consistent").set({"dynamics.floor": 0.01})
    run = graph.run(judge=False)  # all of it
    estimates = run.data["dynamics.a_d_hat"].values[::5]
    assert part(estimates, half_of_the_model(graph)) == pytest.approx(0.01, abs=1e-12)  # reached, but not crossed
    assert least(estimates, 3) > 0.005
    error = np.linalg.norm(run.data["arm.x"].values - run.data["path.x_d"].values, axis=1)
    assert np.sqrt(np.mean(error[-len(error) // 8 :] ** 2)) < 0.35e-3


def test_with_a_floor_v_falls_along_the_edge_in_continuous_time() -> None:
    graph = dm.load("ur10_consistent").set({"dynamics.floor": 0.9, "dynamics.c": 100, "clock": "continuous"})
    run = graph.run(until=0.3, engine="interpreted", judge=False)
    estimates = run.data["dynamics.a_d_hat"].values
    assert part(estimates, half_of_the_model(graph)) == pytest.approx(0.9, abs=1e-12)
    V = along(claim_of(graph.diagram), run.recording, 1.0)
    assert V.largest_increase < 1e-9 * V.V[0]


def test_with_a_floor_the_interpreter_runs_what_the_compiled_engine_runs() -> None:
    graph = dm.load("ur10_consistent").set({"dynamics.floor": 0.9, "dynamics.c": 20})
    compiled, interpreted = (
        graph.run(until=0.24, engine=engine, judge=False) for engine in ("compiled", "interpreted")
    )
    expected = compiled.data["dynamics.a_d_hat"].values
    np.testing.assert_allclose(interpreted.data["dynamics.a_d_hat"].values, expected, rtol=1e-12, atol=1e-12)


def test_with_a_floor_the_torque_form_assumes_nothing_of_m_hat_even_with_a_residual() -> None:
    found = dm.load("torque_consistent_pi").set({"adaptation.floor": 0.1, "inverse.leak": 0.1}).verify()
    assert found.proved
    assert not [item.text for item in found.assumptions if "M_hat" in item.text]
    # if V can increase, a box or a ball would bound the estimates; a cone is unbounded
    assert "adaptation.a_d_hat" in found.verdict.states.open
    reported = {(item.signal, item.says) for item in found.verdict.statements}
    assert ("a_d_hat", "consists of bodies, each not less than its fraction of the nominal one") in reported
    assert ("a_d_hat - a_d", "is bounded") not in reported


FLOOR_FAULTS = {
    "moves in another metric": {"natural": lambda g, nominal, n, c, Gamma: natural(g, 2 * nominal, n, c, Gamma)},
    "stores at another body": {"weight": lambda nominal, n, c, Gamma: weight(2 * nominal, n, c, Gamma)},
    "stores friction by the bodies' gain": {"weight": lambda nominal, n, c, Gamma: weight(nominal, n, c, c)},
}


@pytest.mark.parametrize("fault", FLOOR_FAULTS)
def test_with_a_floor_a_law_and_a_storage_that_are_no_pair_are_refuted(fault: str) -> None:
    dynamics = {"type": "consistent_compensator", "c": 2, "Gamma": 5, "floor": 0.3}
    graph = dm.load("pendulum").set({"model.nominal": 0.5, "blocks.dynamics": dynamics})
    verdict = verdict_with(graph, "dynamics", **FLOOR_FAULTS[fault])
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("dynamics",)
