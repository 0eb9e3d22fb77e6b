"""Bounded-gain forgetting of the kinematics: proofs, seeded faults, and its benefit in runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from dmframe.block.adaptation import Fit
from dmframe.block.certificate import SX, Certificate, InformationSquare
from dmframe.certify import Verdict, verify
from dmframe.common.errors import DmframeError
from dmframe.formula.docstring import check_docstring
from dmframe.graph.graph import Graph
from dmframe.report.terms import terms_of
from dmframe.results.along import along
from dmframe.simulate import Recording, simulate
from dmframe_blocks.adaptive_kinematics import AdaptiveKinematics

NAME = "observed_tracking_forgetting_pi"
TOOL = "geometry.adapt=tool"


def proof(*overrides: str, name: str = NAME) -> Verdict:
    return verify(Graph.read(name, overrides).diagram)


honest = cache(proof)  # of code without a fault


def run_of(seconds: float, *overrides: str) -> Recording:
    graph = Graph.read(NAME, overrides)
    return simulate(graph.diagram, seconds, clock=graph.file.clock, solver=graph.solver, start=graph.start)


def tool_error(run: Recording) -> np.ndarray:
    """Distance of the estimated tool from the true one at each sample [m]."""
    estimate = run["geometry.a_k_hat"]
    return np.asarray(np.linalg.norm(estimate - (estimate[0] - 0.03), axis=1))


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        (TOOL,),
        ("geometry.adapt=links",),
        ("geometry.R=[1, 2, 3]", "geometry.dead_zone=0.01"),
        ("geometry.forgetting=null",),
        ("geometry.forgetting=null", "geometry.leak=0.1", "geometry.a_k_hat_box=[-2, 2]"),
    ],
)
def test_forgetting_and_composite_adaptation_are_proved_with_every_part_of_the_kinematics(
    overrides: tuple[str],
) -> None:
    verdict = honest(*overrides)
    assert verdict.outcome == "proved", verdict.reason
    assert all(control.refuted for control in verdict.controls)
    robust = any("leak" in override or "dead_zone" in override for override in overrides)
    assert bool(verdict.bounds) == robust
    reports = "is bounded in the mean square, by the residual" if robust else "goes to zero"
    fitted = [
        item.says for item in verdict.statements if item.signal.startswith("f(q, ") and item.signal.endswith(" - x")
    ]
    assert reports in fitted


@pytest.mark.parametrize("name", ["theorem_1", "filtered_regulation_pid", "observed_regulation_pi"])
def test_it_goes_with_every_generator_that_adapts_the_kinematics(name: str) -> None:
    verdict = honest("geometry.R=5", "geometry.forgetting=0.2", TOOL, name=name)
    assert verdict.outcome == "proved", verdict.reason


def test_the_start_of_g_is_listed_as_an_assumption_and_v_does_not_bound_g_alone() -> None:
    verdict = honest()
    assert any(
        item.text.startswith("geometry: G of |a_k_hat - a_k|_G^2 starts at zero") for item in verdict.assumptions
    )
    assert [item.says for item in verdict.statements if item.signal == "a_k_hat - a_k"] == ["is bounded"]
    assert any(control.fault == "sign of d geometry.G_k/dt flipped" for control in verdict.controls)


def forgetting_faster_than_declared(right: Any) -> Any:
    def rates(self: Fit, state: str) -> dict[str, SX]:
        return {name: rate - 0.01 * self.state for name, rate in right(self, state).items()}

    return rates


def with_the_gain_of_the_gradient(right: Any) -> Any:
    return lambda self, gain, gradient: gain * gradient


def with_the_wrong_sign(right: Any) -> Any:
    return lambda self, gain, gradient: -right(self, gain, gradient)


@pytest.mark.parametrize(
    ("method", "fault"),
    [
        ("rates", forgetting_faster_than_declared),
        ("gained", with_the_gain_of_the_gradient),
        ("gained", with_the_wrong_sign),
    ],
)
def test_a_fault_in_the_law_is_refuted(method: str, fault: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fit, method, fault(getattr(Fit, method)))
    verdict = proof(TOOL)
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert "geometry" in verdict.refutation.blame


def test_a_memory_that_does_not_move_as_its_term_states_is_refuted_though_dv_dt_would_not_notice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """G' = 0 with G = 0 always: V and dV/dt are correct without it, and G >= 0 would hold for another reason."""
    right = AdaptiveKinematics.certificate

    def lying(self: Any, *signals: Any) -> Certificate:
        stated = right(self, *signals)
        term = InformationSquare(signals[0].q, ca.SX(0), ca.SX.zeros(3, 3), ca.SX.eye(3), ca.SX.ones(3), ca.SX(1))
        return Certificate(
            (*stated.storage, term),
            stated.dissipation,
            stated.supply,
            task=True,
            residual=stated.residual,
            truth=stated.truth,
            estimates=stated.estimates,
        )

    monkeypatch.setattr(AdaptiveKinematics, "certificate", lying)
    verdict = proof(TOOL)
    assert verdict.outcome == "refuted"
    assert verdict.reason.startswith("geometry: dG/dt of q is not what the block claims")


def test_negative_weights_of_what_is_gathered_fail_their_conditions(monkeypatch: pytest.MonkeyPatch) -> None:
    right = AdaptiveKinematics.fits
    assert not check_docstring(AdaptiveKinematics)  # read before the fault is seeded, which reading would report

    def unlearning(self: Any, *signals: Any) -> dict[str, Fit]:
        return {name: replace(fit, by=-fit.by) for name, fit in right(self, *signals).items()}

    monkeypatch.setattr(AdaptiveKinematics, "fits", unlearning)
    verdict = proof(TOOL)
    assert verdict.outcome == "not_applicable"
    assert "weight of the rate of G for |a_k_hat - tool(a_k)|_G^2 in V >= 0" in verdict.reason


def test_v_falls_along_a_run_in_continuous_time() -> None:
    graph = Graph.read(NAME, ["clock=continuous", "solver={output: 20 ms}", TOOL])
    diagram = graph.diagram
    run = simulate(diagram, 5.0, clock=None, solver=graph.solver, start=graph.start)
    verdict = verify(diagram)
    assert verdict.claim is not None
    V = along(verdict.claim, run, float(verdict.kappa.chosen) if verdict.kappa else 1.0).V
    assert np.all(np.diff(V) <= 1e-9 * V[0])
    learnt = 0.5 * 3 * 0.03**2 / 2  # of the tool, 1/2 |a_k_hat - a_k|^2 / Gamma_k at the start
    assert V[0] - V[-1] > 0.9 * learnt


def test_what_is_gathered_is_the_integral_of_what_was_seen() -> None:
    run = run_of(6.0, TOOL, "geometry.R=2", "geometry.forgetting=0.5")
    G = run["geometry.G_k"].reshape(len(run.time), 3, 3)
    # the tool's W_k is a rotation: W' R W = 2, whatever the pose, and G' = 2 - G/2 sampled by Euler
    steps = np.arange(len(run.time))
    expected = 4 * (1 - (1 - 0.5 * 0.008) ** steps)
    np.testing.assert_allclose(G, expected[:, None, None] * np.eye(3), atol=1e-9)


def test_the_tool_is_estimated_at_the_rate_of_the_fit_and_not_of_the_gradient() -> None:
    fitted, gradient = run_of(30.0, TOOL), run_of(30.0, TOOL, "geometry.R=null", "geometry.forgetting=null")
    assert tool_error(fitted)[-1] < 1e-3 * tool_error(fitted)[0]
    assert tool_error(gradient)[-1] > 0.3 * tool_error(gradient)[0]


def test_forgetting_follows_closer_than_the_gradient_and_than_the_composite_law() -> None:
    final = []
    for overrides in ([], ["geometry.forgetting=null"], ["geometry.R=null", "geometry.forgetting=null"]):
        run = run_of(60.0, *overrides)
        assert run.divergence is None
        error = np.linalg.norm(run["arm.x"] - run["path.x_d"], axis=1)
        final.append(np.sqrt(np.mean(error[-error.size // 10 :] ** 2)))
    assert final[0] < 0.7 * min(final[1:])


def test_for_one_estimate_it_is_the_textbooks_bounded_gain_forgetting() -> None:
    """d(1/P)/dt = -lambda/P + W' W with lambda = lambda_0 (1 - P/k_0) [SlotineLi1991]_ section 8.7.5."""
    k_0, rate, W = 3.0, 0.4, 0.7
    state = ca.SX.sym("G")
    fit = Fit(ca.SX(0), ca.SX(W), ca.SX(1), ca.SX(rate), state)
    (moves,) = fit.rates("G").values()
    gain = ca.Function("P", [state], [fit.gained(ca.SX(k_0), ca.SX(1)), moves])

    def textbook(t: float, P: np.ndarray) -> np.ndarray:
        return np.asarray(rate * (1 - P / k_0) * P - P * W * W * P)

    def ours(t: float, G: np.ndarray) -> np.ndarray:
        return np.asarray(gain(G)[1]).ravel()

    times = np.linspace(0, 20, 9)
    P = scipy.integrate.solve_ivp(textbook, (0, 20), [k_0], t_eval=times, rtol=1e-10, atol=1e-12).y[0]
    G = scipy.integrate.solve_ivp(ours, (0, 20), [0.0], t_eval=times, rtol=1e-10, atol=1e-12).y[0]
    np.testing.assert_allclose([float(gain(g)[0]) for g in G], P, rtol=1e-8)
    assert P.max() <= k_0


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (["geometry.R=null"], "forgetting requires R, the weight of the prediction error"),
        (["geometry.leak=0.1"], "leak cannot be combined with forgetting"),
        (["geometry.a_k_hat_box=[-2, 2]"], "a_k_hat_box cannot be combined with forgetting"),
        (["geometry.forgetting=-1"], "forgetting: expected"),
        (["geometry.R=[1, 2]"], "R"),
    ],
)
def test_options_that_contradict_each_other_are_refused(overrides: list[str], text: str) -> None:
    with pytest.raises(DmframeError, match=text):
        _ = Graph.read(NAME, overrides).diagram


def test_a_report_calls_the_metric_by_its_name() -> None:
    verdict = honest(TOOL)
    assert verdict.claim is not None
    terms = terms_of(verdict.claim)
    assert r"\tfrac12 |\hat{a}_{k} - \operatorname{tool}(a_{k})|^2_{W_{2}\, G}" in terms.V[0].right
    (row,) = (row for row in terms.dissipation if row.kind == "gathered")
    assert (row.weight, row.value) == (r"\tfrac{1}{2} \, \mathrm{forgetting}", "0.1")
