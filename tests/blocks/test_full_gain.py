"""Adaptation gains that are full matrices: proofs, refutations and runs."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from faulty import verdict_with
from jsonschema import Draft202012Validator

import dmframe as dm
from dmframe.block import linalg
from dmframe.certify import Verdict, verify
from dmframe.common.errors import DmframeError
from dmframe.config.schema import json_schema
from dmframe.diagram.projection import Ball, Box
from dmframe.diagram.values import with_values
from dmframe.graph.graph import Graph
from dmframe.report.linear import LinearView
from dmframe.robot.pseudo_inertia import natural_gain
from dmframe.simulate import simulate, simulate_many


def full(n: int, seed: int = 0) -> str:
    """A matrix as in a graph file; above 22 rows in blocks of 2, since the time of a proof grows with elements."""
    root = np.random.default_rng(seed).normal(size=(n, n))
    if n > 22:
        root *= np.kron(np.eye(n // 2), np.ones((2, 2)))
    return str(np.round(root @ root.T / n + np.eye(n), 6).tolist())


def proof(name: str, *overrides: str) -> Verdict:
    return verify(Graph.read(name, overrides).diagram)


UNBOXED = "dynamics.a_d_hat_box=null"
"""A full gain excludes a box, and `arm2_joint` has one."""

SMALL = "pendulum"
"""One joint suffices for a changed law: the time of a proof grows with the elements of the gain, 66 instead of 253."""

ADAPTING = {
    SMALL: {"dynamics.Gamma": 11},
    "arm2_joint": {"dynamics.Gamma": 22},
    "observed_tracking_pi": {"geometry.Gamma_k": 12},
    "torque_direct_pid": {"adaptation.Gamma": 24},
    "torque_indirect_pi": {"adaptation.Gamma": 24},
    "torque_indirect_filtered_pi": {"adaptation.Gamma": 24},
    "known_tracking_composite_pi": {"dynamics.Gamma": 36},
    "observed_tracking_forgetting_pi": {"geometry.Gamma_k": 3},
}


def with_full(name: str) -> list[str]:
    ((label, size),) = ADAPTING[name].items()
    none = [f"{block}.a_d_hat_box=null" for block in ("adaptation", "dynamics") if label.startswith(block)]
    tool = ["geometry.adapt=tool"] if size == 3 else []
    return [f"{label}={full(size)}", *none, *tool]


@pytest.mark.parametrize("name", [name for name in ADAPTING if name != SMALL])
def test_each_adapting_block_is_proved_with_a_full_gain(name: str) -> None:
    verdict = proof(name, *with_full(name))
    assert verdict.outcome == "proved", verdict.reason
    assert all(control.refuted for control in verdict.controls)
    weights = [
        item for item in verdict.conditions if item.name.startswith(f"{with_full(name)[0].partition('.')[0]}: weight")
    ]
    assert weights
    assert all(item.how == "exact" for item in weights)


def test_it_is_proved_for_all_symmetric_matrices_at_once() -> None:
    diagram = Graph.read("arm2_joint", with_full("arm2_joint")).diagram
    (gain,) = (item for item in diagram.loop.parameters if item.label == "dynamics.Gamma")
    assert gain.symbol.numel() == 22 * 23 // 2


FAULTS: dict[str, Any] = {
    "only the diagonal drives": lambda gain, vector: ca.diag(gain) * vector,
    "the inverse drives": lambda gain, vector: linalg.solve_spd(gain, vector),
    "one row too large": lambda gain, vector: gain @ vector + ca.vertcat(gain[1, 2] * ca.sum1(vector), 0 * vector[1:]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_law_that_is_not_the_gain_times_the_gradient_is_refuted(fault: str) -> None:
    verdict = verdict_with(Graph.read(SMALL, with_full(SMALL)), "dynamics", times=FAULTS[fault])
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("dynamics",)


def test_a_storage_in_the_metric_of_the_gain_itself_is_refuted() -> None:
    graph = Graph.read(SMALL, with_full(SMALL))
    assert verdict_with(graph, "dynamics", metric=lambda gain: gain).outcome == "refuted"


def test_a_copy_without_a_fault_is_proved() -> None:
    graph = Graph.read(SMALL, with_full(SMALL))
    assert verdict_with(graph, "dynamics", times=linalg.times, metric=linalg.metric).outcome == "proved"


def test_the_weight_of_v_is_decided_by_its_exact_pivots() -> None:
    """A gain whose symbols have values that the reader would refuse."""
    graph = Graph.read(SMALL, with_full(SMALL))
    diagram = graph.diagram
    (gain,) = (item for item in diagram.loop.parameters if item.label == "dynamics.Gamma")
    gain.value[0] = -1.0
    verdict = verify(diagram)
    assert verdict.outcome == "not_applicable"
    assert [item.holds for item in verdict.conditions if item.name.startswith("dynamics: weight")] == [False]


@pytest.mark.parametrize("option", ["leak", "error_leak", "dead_zone"])
def test_the_robust_laws_work_in_the_metric_of_a_full_gain(option: str) -> None:
    verdict = proof(SMALL, *with_full(SMALL), f"dynamics.{option}=0.1")
    assert verdict.outcome == "proved", verdict.reason
    assert [bound.block for bound in verdict.bounds] == ["dynamics"]


def test_the_bound_of_a_leak_is_the_error_of_the_start_in_the_metric_of_v() -> None:
    overrides = with_full(SMALL)
    diagram = Graph.read(SMALL, overrides).diagram
    verdict = proof(SMALL, *overrides, "dynamics.leak=0.1")
    true = np.concatenate([np.array(diagram.robot.inertia, dtype=float).ravel(), [0.3]])
    metric = np.linalg.inv(diagram.models["dynamics"].values["Gamma"])
    assert [bound.value for bound in verdict.bounds] == pytest.approx([0.1 / 2 * true @ metric @ true])


def test_a_box_is_refused_and_a_ball_is_proved() -> None:
    with pytest.raises(DmframeError, match="a_d_hat_box cannot be combined with a full matrix Gamma: the projection"):
        _ = Graph.read(SMALL, [*with_full(SMALL), "dynamics.a_d_hat_box=[-9, 9]"]).diagram
    verdict = proof(SMALL, *with_full(SMALL), "dynamics.a_d_hat_ball=[0, 10]")
    assert verdict.outcome == "proved", verdict.reason
    assert {
        "dynamics.a_d_hat: true value inside the ball",
        "dynamics.a_d_hat: projected in the metric of V",
        "dynamics.a_d_hat: law of the ball",
    } <= {item.name for item in verdict.conditions}


def test_a_ball_that_is_normal_in_another_metric_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    import dmframe.diagram.resolve as resolve

    monkeypatch.setattr(resolve, "Ball", lambda c, r, gain: Ball(c, r, ca.diag(gain)))
    verdict = proof(SMALL, *with_full(SMALL), "dynamics.a_d_hat_ball=[0, 10]")
    assert verdict.outcome == "not_applicable"
    assert "projected in the metric of V" in verdict.reason


def column(values: Any) -> Any:
    return ca.SX(ca.DM(np.asarray(values, dtype=float)))


def numbers(expression: Any) -> np.ndarray:
    return np.array(ca.DM(ca.evalf(ca.densify(expression)))).ravel()


def test_on_the_rim_of_an_ellipsoid_no_correction_raises_the_storage_of_a_full_gain() -> None:
    rng = np.random.default_rng(4)
    raised = 0
    for _ in range(40):
        root, radius, center = rng.normal(size=(3, 3)), rng.uniform(0.5, 2, 3), rng.normal(size=3)
        gain = root @ root.T + 0.1 * np.eye(3)
        rim, inside = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        state, truth = center + radius * rim * (1 + 1e-12), center + radius * inside * rng.uniform(0, 1)
        nominal = rng.normal(size=3)
        ball = Ball(column(center), column(radius), column(gain))
        correction = numbers(ball.law(column(state), column(nominal)))
        assert (state - truth) @ np.linalg.solve(gain, correction) <= 1e-9
        assert (state - center) / radius**2 @ (nominal + correction) <= 1e-9
        wrong = numbers(Ball(column(center), column(radius), column(np.ones(3))).law(column(state), column(nominal)))
        raised += (state - truth) @ np.linalg.solve(gain, wrong) > 1e-6
    assert raised  # the normal of the coordinates would be wrong


def test_a_box_is_normal_in_the_metric_of_a_diagonal_alone() -> None:
    box = Box(column([0, 0]), column([1, 1]))
    assert not numbers(box.askew(column([[1, 0], [0, 3]]))).any()
    assert numbers(box.askew(column([[1, 0.5], [0.5, 3]]))).any()


def run_of(*overrides: str, engine: Any = "auto", values: dict[str, Any] | None = None) -> np.ndarray:
    graph = Graph.read("arm2_joint", [*overrides, UNBOXED])
    diagram = with_values(graph.diagram, values) if values else graph.diagram
    run = simulate(diagram, 1.0, clock=graph.file.clock, start=graph.start, engine=engine)
    assert run.divergence is None
    found: np.ndarray = run["dynamics.a_d_hat"][-1]
    return found


def test_a_diagonal_matrix_runs_like_its_diagonal() -> None:
    diagonal = np.linspace(1, 9, 22)
    np.testing.assert_allclose(
        run_of(f"dynamics.Gamma={np.diag(diagonal).tolist()}"), run_of(f"dynamics.Gamma={diagonal.tolist()}"), rtol=1e-9
    )


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_other_numbers_need_no_other_diagram(engine: Any) -> None:
    other = np.array(json.loads(full(22, 5)))
    expected = run_of(f"dynamics.Gamma={other.tolist()}", engine=engine)
    found = run_of(*with_full("arm2_joint"), values={"dynamics.Gamma": other}, engine=engine)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    scalar = run_of(*with_full("arm2_joint"), values={"dynamics.Gamma": 7.0}, engine=engine)
    np.testing.assert_allclose(scalar, run_of("dynamics.Gamma=7", engine=engine), rtol=1e-9)


def test_a_batch_takes_matrices_and_priors() -> None:
    graph = Graph.read("arm2_joint", ["dynamics.Gamma={inverse_of: model}", UNBOXED])
    priors = [{"inverse_of": "model", "scale": scale} for scale in (1.0, 3.0)]
    runs = simulate_many(
        graph.diagram, [{"dynamics.Gamma": prior} for prior in priors], 1.0, clock=graph.file.clock, start=graph.start
    )
    for run, scale in zip(runs, (1, 3), strict=True):
        assert not isinstance(run, DmframeError)
        expected = run_of(f"dynamics.Gamma={{inverse_of: model, scale: {scale}}}")
        np.testing.assert_allclose(run["dynamics.a_d_hat"][-1], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("overrides", "value", "text"),
    [
        ([], np.eye(22), "values.dynamics.Gamma: expected a diagonal, as in the diagram; a full matrix requires"),
        (
            [f"dynamics.Gamma={np.eye(22).tolist()}"],
            np.eye(22) + 0.01,
            "values.dynamics.Gamma: expected the zeros of the diagram's matrix; other zeros require another",
        ),
        ([], np.eye(3), "dynamics.Gamma: expected [22, 22] numbers, found [3, 3]"),
    ],
)
def test_values_that_would_take_another_diagram_are_refused(overrides: list[str], value: Any, text: str) -> None:
    with pytest.raises(DmframeError) as fault:
        with_values(Graph.read("arm2_joint", [*overrides, UNBOXED]).diagram, {"dynamics.Gamma": value})
    assert text in str(fault.value)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("[[1, 2], [3, 4]]", "blocks.dynamics.Gamma: expected a symmetric matrix, found 3 at [1, 0] and 2 at [0, 1]"),
        ("[[2, 1], [1, 2]]", "dynamics.Gamma: expected p = 22 (bound by model), found 2"),
        ("{inverse_of: modle}", "dynamics.Gamma.inverse_of: unknown block; did you mean model?"),
        (
            "{inverse_of: servo}",
            "inverse_of: expected a block that models its parameters, found servo; the graph has model",
        ),
    ],
)
def test_a_value_that_is_not_a_gain_is_refused_with_its_place(value: str, text: str) -> None:
    with pytest.raises(DmframeError) as fault:
        _ = Graph.read("arm2_joint", [f"dynamics.Gamma={value}"]).diagram
    assert str(fault.value).startswith("--set dynamics.Gamma=")
    assert text in str(fault.value)


def test_the_schema_contains_the_forms_of_a_gain() -> None:
    schema = json_schema()
    gain = Draft202012Validator(schema["$defs"]["block_dynamic_compensator"]["properties"]["Gamma"])
    for value in (2, "2", [1, 2], [[2, 1], [1, 2]], {"inverse_of": "model"}, {"inverse_of": "model", "scale": 0.1}):
        assert gain.is_valid(value), value
    for value in (True, [], {"scale": 1}, {"inverse_of": "model", "scal": 1}, [[[1]]]):
        assert not gain.is_valid(value), value


def test_the_report_of_a_full_gain_prints_its_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
    gain = json.loads(full(11))
    dm.load(SMALL).set({"dynamics.Gamma": gain, "duration": 0.1}).verify().report(tmp_path / "report.md")
    assert "| 11 x 11, diagonal from" in (tmp_path / "report.md").read_text()


# The prior of a model.


def prior_of(*overrides: str) -> np.ndarray:
    diagram = Graph.read(
        "arm2_joint", ["dynamics.Gamma={inverse_of: model, scale: 2, others: 3}", UNBOXED, *overrides]
    ).diagram
    found: np.ndarray = diagram.models["dynamics"].values["Gamma"]
    return found


def test_a_prior_has_a_block_a_link_and_one_number_for_each_friction() -> None:
    found = prior_of("model.friction=[viscous, coulomb]", "model.bias=true")
    expected = np.zeros((26, 26))
    for k, row in enumerate(Graph.read("arm2_joint").robot.inertia):
        expected[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = 2 * np.array(natural_gain(row), dtype=float)
    expected[20:, 20:] = 2 * 9 * np.eye(6)
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_the_separate_gravity_varies_like_the_masses_and_by_itself() -> None:
    found = prior_of("model.gravity=apart")
    assert found.shape == (30, 30)
    for k in range(2):
        link = found[10 * k : 10 * k + 4, 10 * k : 10 * k + 4]
        heavy = slice(20 + 4 * k, 24 + 4 * k)
        np.testing.assert_array_equal(found[heavy, heavy], link)
        assert not found[heavy, :20].any()


def test_a_prior_is_exact_before_it_is_rounded_once() -> None:
    row = Graph.read("arm2_joint").robot.inertia[0]
    assert all(isinstance(value, Fraction) for line in natural_gain(row) for value in line)
    assert prior_of()[0, 0] == float(2 * row[0] * row[0])


def test_a_prior_is_proved() -> None:
    verdict = proof("arm2_joint", "dynamics.Gamma={inverse_of: model, scale: 0.1, others: 20}", UNBOXED)
    assert verdict.outcome == "proved", verdict.reason


def learnt(*overrides: str) -> tuple[float, float]:
    """The tracking error of the last eighth, and the relative error of the estimated torques at other poses."""
    graph = Graph.read("arm2_joint", ["model.nominal=0.7", UNBOXED, *overrides])
    diagram = graph.diagram
    run = simulate(diagram, 20.0, clock=graph.file.clock, start=graph.start)
    assert run.divergence is None
    error = np.linalg.norm(run["arm.q"] - run["path.q_d"], axis=1)[-len(run.time) // 8 :]
    q, dq, ddq = (ca.SX.sym(name, 2) for name in ("q", "dq", "ddq"))
    symbolic = diagram.models["model"].robot
    function = ca.Function("Y", [q, dq, ddq, diagram.loop.p], [symbolic.regressor(q, dq, dq, ddq)])
    rng = np.random.default_rng(0)
    points = [(rng.uniform(-np.pi, np.pi, 2), rng.normal(size=2), 2 * rng.normal(size=2)) for _ in range(200)]
    Y = np.vstack([function(*point, diagram.loop.p_values).full() for point in points])
    true = np.array(diagram.robot.inertia, dtype=float).ravel()
    wrong = Y @ (run["dynamics.a_d_hat"][-1][:20] - true)
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(wrong**2) / np.mean((Y @ true) ** 2)))


def test_with_a_prior_what_is_estimated_on_one_path_is_less_wrong_on_others() -> None:
    """From a model that is 30 % too light; each prior also tracks better than the scalar gain in the same row."""
    for scale, scalar in ((1, 10), (10, 300)):
        error, elsewhere = learnt(f"dynamics.Gamma={{inverse_of: model, scale: {scale}}}")
        scalar_error, scalar_elsewhere = learnt(f"dynamics.Gamma={scalar}")
        assert error < scalar_error
        assert elsewhere < 0.3 * scalar_elsewhere
    assert learnt("dynamics.Gamma={inverse_of: model}")[1] < 0.25 < 0.3 < 0.8 < learnt("dynamics.Gamma=10")[1]
