"""Robust laws and balls in whole graphs: proofs, refutations, and their benefit in runs."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest

from dmframe.block.adaptation import Adaptation
from dmframe.block.certificate import SX
from dmframe.certify import Verdict, verify
from dmframe.cli import main
from dmframe.common.errors import DmframeError
from dmframe.graph.graph import Graph
from dmframe.report.linear import LinearView
from dmframe.report.verification import Verification
from dmframe.simulate import Recording, simulate

LAWS = {
    "arm2_joint": ("dynamics", "inverse"),
    "joint_tracking_pid": ("dynamics", "inverse"),
    "theorem_1": ("geometry", "dynamics", "inverse"),
    "theorem_3": ("geometry",),
    "torque_direct_pid": ("inverse",),
    "torque_indirect_pi": ("inverse",),
}
UNBOXED = "dynamics.a_d_hat_box=null"  # a ball instead of a box
OPTIONS = ("leak", "error_leak", "dead_zone")


def proof(name: str | Path, *overrides: str) -> Verdict:
    return verify(Graph.read(name, overrides).diagram)


@pytest.mark.parametrize(
    ("name", "option"),
    [(name, option) for name in LAWS for option in OPTIONS if name != "theorem_1"] + [("theorem_1", "leak")],
)
def test_each_law_of_each_adapting_block_is_proved_up_to_a_bounded_residual(name: str, option: str) -> None:
    verdict = proof(name, *(f"{block}.{option}=0.02" for block in LAWS[name]))
    assert verdict.outcome == "proved", verdict.reason
    assert "plus a residual" in verdict.reason
    assert verdict.headline.startswith(
        f"proved, up to a {'bounded residual' if option == 'leak' else 'residual that grows'}"
    )
    assert {bound.block for bound in verdict.bounds} == set(LAWS[name])
    assert all(control.refuted for control in verdict.controls)
    assert any("bounded residual" in control.fault for control in verdict.controls)
    assert not any(item.says in ("goes to zero", "is square-integrable") for item in verdict.statements)


def test_without_a_robust_law_there_is_no_residual() -> None:
    verdict = proof("arm2_joint")
    assert verdict.bounds == ()
    assert verdict.residual_bound == 0
    assert any(item.says == "goes to zero" for item in verdict.statements)


@pytest.mark.parametrize("option", ["leak", "error_leak"])
def test_a_leak_of_the_wrong_sign_is_refuted(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right = Adaptation.rate

    def wrong(self: Adaptation, gradient: SX, value: SX, nominal: SX, error: SX) -> SX:
        return 2 * gradient - right(self, gradient, value, nominal, error)

    monkeypatch.setattr(Adaptation, "rate", wrong)
    verdict = proof("arm2_joint", f"dynamics.{option}=0.1")
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("dynamics",)


def test_a_residual_that_is_left_out_of_the_claim_is_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Adaptation.idle
    monkeypatch.setattr(Adaptation, "idle", lambda self, error, effect: right(self, error, 0 * effect))
    assert proof("arm2_joint", "inverse.dead_zone=0.1").outcome == "refuted"


def test_the_bound_of_a_leak_is_the_error_of_the_start(tmp_path: Path) -> None:
    verdict = proof("arm2_joint", "inverse.leak=0.3")
    K_star, K_ratio = np.array([60, 30]), np.array([4, 4])
    w = 0.3 / 2 * np.sum((K_star / 0.01) * (1 / K_star) ** 2)
    w_I = 0.3 / 2 * np.sum((K_star / 1) * (K_ratio - 2) ** 2)
    assert [bound.value for bound in verdict.bounds] == pytest.approx([w, w_I])
    assert verdict.kappa is not None
    assert verdict.residual_bound == pytest.approx(float(verdict.kappa.chosen) * (w + w_I))


def test_a_dead_zone_at_the_source_of_the_prediction_error_leaves_no_residual() -> None:
    verdict = proof("torque_indirect_pi", "adaptation.dead_zone=0.5")
    assert (verdict.outcome, verdict.bounds) == ("proved", ())
    assert ("Y_d a_d_hat - tau_d", "goes into its dead zone") in [
        (item.signal, item.says) for item in verdict.statements
    ]


@pytest.mark.parametrize("option", ["error_leak", "dead_zone"])
def test_a_filtered_prediction_error_takes_each_law_too(option: str) -> None:
    verdict = proof("torque_indirect_filtered_pi", f"adaptation.a_d_hat={START}", f"adaptation.{option}=0.02")
    assert verdict.outcome == "proved", verdict.reason
    assert {bound.block for bound in verdict.bounds} == {"adaptation"}
    assert all(control.refuted for control in verdict.controls)


START = "[6, 1.2, 0, 0, 0.01, 0, 0.36, 0, 0, 0.36, 3.5, 0.6, 0, 0, 0.004, 0, 0.15, 0, 0, 0.15, 1, 1, 0, 0]"


def test_what_leaks_everywhere_is_ultimately_bounded() -> None:
    leaks = (f"adaptation.a_d_hat={START}", "adaptation.leak=0.1", "inverse.leak=0.2")
    verdict = proof("torque_indirect_pi", *leaks)
    assert verdict.outcome == "proved", verdict.reason
    assert {item.says for item in verdict.statements} == {"is ultimately bounded"}
    assert {item.signal for item in verdict.statements} == {"a_d_hat - a_d", "w - 1/K_star", "w_I - K_I/K_P"}
    assert any(bound.constant for bound in verdict.bounds)  # the offset of the servo's integrator


def test_where_only_a_part_of_v_leaks_no_ultimate_bound_is_stated() -> None:
    verdict = proof("arm2_joint", "dynamics.leak=0.1", "inverse.leak=0.1")
    reports = {(item.signal, item.says) for item in verdict.statements}
    assert ("w - 1/K_star", "is bounded") in reports  # its box
    assert ("sigma", "is bounded in the mean square, by the residual") in reports
    assert not any(text == "is ultimately bounded" for _, text in reports)


def test_a_residual_that_nothing_bounds_is_no_proof() -> None:
    verdict = proof("torque_indirect_pi", "adaptation.leak=0.1")  # the nominal torque changes with the pose
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("the identity holds, but nothing bounds the residual: adaptation: ")


def test_the_json_and_the_page_give_the_bound(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def printed(*more: str) -> str:
        command = ["dmframe", "verify", "arm2_joint", "--set", "dynamics.leak=0.1", "--set", "inverse.error_leak=0.1"]
        monkeypatch.setattr("sys.argv", [*command, *more])
        with contextlib.suppress(SystemExit):
            main()
        return capsys.readouterr().out

    data = json.loads(printed("--json"))
    assert data["verdict"] == "proved"
    assert data["residual_bound"] is None
    assert [(row["block"], row["times"], row["weight"]) for row in data["bounded_by"]] == [
        ("dynamics", "", "kappa"),
        ("inverse", "|sigma|", "kappa"),
        ("inverse", "|sigma|", "kappa"),
    ]
    assert {term["kind"] for term in data["dissipation"]} == {"square", "norm_square", "lemma"}
    page = printed()
    assert "V̇ may exceed minus the dissipation by" in page
    assert "≤ κ·0.0258" in page


@pytest.mark.parametrize(
    ("ball", "outcome"),
    [("[0, 10]", "proved"), ("[0, 3]", "not_applicable"), ("[0, 1e-3]", "not_applicable")],
)
def test_a_ball_is_proved_if_it_holds_the_true_value(ball: str, outcome: str) -> None:
    verdict = proof("arm2_joint", f"dynamics.a_d_hat_ball={ball}", UNBOXED)
    assert verdict.outcome == outcome
    checked = {item.name: item for item in verdict.conditions}
    inside = checked["dynamics.a_d_hat: true value inside the ball"]
    assert inside.how == "exact"
    assert inside.holds == (outcome == "proved")


def test_the_room_in_a_ball_is_that_of_the_true_parameters() -> None:
    diagram = Graph.read("arm2_joint", ["dynamics.a_d_hat_ball=[0, 10]", UNBOXED]).diagram
    true = np.concatenate([np.array(diagram.robot.inertia, dtype=float).ravel(), [1, 0.5]])
    verdict = verify(diagram)
    (found,) = (item.value for item in verdict.conditions if item.name.endswith("true value inside the ball"))
    assert found == pytest.approx(1 - true @ true / 100)


def test_the_translations_of_the_kinematics_are_kept_in_a_ball_too() -> None:
    assert proof("theorem_1", "geometry.a_k_hat_ball=[0, 1.5]").outcome == "proved"


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (
            ["dynamics.a_d_hat_ball=[0, 3]", "dynamics.a_d_hat_box=[-1, 3]"],
            "dynamics: expected one of a_d_hat_box and a_d_hat_ball, found both; a_d_hat_box: null removes the box",
        ),
        (["dynamics.a_d_hat_ball=[0, -3]"], "dynamics.a_d_hat_ball: expected a radius > 0, found [0, -3]"),
        (["dynamics.a_d_hat_ball=3"], "dynamics.a_d_hat_ball: expected a ball [centre, radius], found 3"),
        (["dynamics.leak=-1"], "dynamics.leak: expected a number > 0, found -1"),
    ],
)
def test_wrong_use_is_refused(overrides: list[str], text: str) -> None:
    with pytest.raises(DmframeError) as fault:
        _ = Graph.read("arm2_joint", overrides).diagram
    assert text in str(fault.value)


def test_a_start_outside_its_ball_is_refused() -> None:
    graph = Graph.read("arm2_joint", ["dynamics.a_d_hat_ball=[0, 2]", "dynamics.a_d_hat=1", UNBOXED])
    with pytest.raises(DmframeError, match=r"expected a start inside a_d_hat_ball, found 2\.345 radii away"):
        simulate(graph.diagram, 0.1, clock=graph.file.clock)


SENSOR = """
import casadi as ca
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Real
from dmframe.block.port import Access, Input, Output, Side, TIME


class WrongSensor(AbstractBlock):
    side = Side.PLANT
    inputs = (TIME, Input("dq", "n", "rad/s"))
    outputs = (Output("dq_m", "n", "rad/s", Access.MEASURED),)
    size: float = Real(unit="rad/s")

    def equations(self, u, x, p):
        return Equations(outputs={"dq_m": u.dq + p.size * (1 + ca.sin(31 * u.t))})
"""
NEARLY_STILL = """
dmframe: 1
robot: arm2
clock: 4 ms
duration: 120 s
blocks:
  path:     {type: sinusoid, center: [45 deg, 60 deg], amplitude: 0.1 deg, rate: [0.9 rad/s, 1.4 rad/s]}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 10}
  inverse:  {type: pi_inverse, Lambda: 0.0001, Lambda_I: 1, w_I: 2, w_box: [0, 0.1], w_I_box: [0.5, 20]}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5]}
  sensor:   {type: sensor.py:WrongSensor, size: 0.05 rad/s}
wires: {inverse.dq: sensor.dq_m, model.dq: sensor.dq_m}
"""


def size_of_estimate(folder: Path, *overrides: str) -> np.ndarray:
    """|a_d_hat| at a third, two thirds and the end of a run with wrongly measured velocities."""
    (folder / "sensor.py").write_text(SENSOR)
    (folder / "graph.yaml").write_text(NEARLY_STILL)
    graph = Graph.read(folder / "graph.yaml", overrides)
    run: Recording = simulate(graph.diagram, 120.0, clock=graph.file.clock, start=graph.start)
    assert run.divergence is None
    size = np.linalg.norm(run["dynamics.a_d_hat"], axis=1)
    return size[[size.size // 3, 2 * size.size // 3, -1]]


def test_with_a_wrong_sensor_the_gradient_drifts_on_and_on(tmp_path: Path) -> None:
    first, second, last = size_of_estimate(tmp_path)
    assert first > 40
    assert second > first + 5
    assert last > second + 5


def test_with_a_wrong_sensor_a_leak_holds_the_estimate_back(tmp_path: Path) -> None:
    first, second, last = size_of_estimate(tmp_path, "dynamics.leak=0.5")
    assert max(first, second, last) < 15
    assert size_of_estimate(tmp_path, "dynamics.error_leak=1")[-1] < 40


def test_with_a_wrong_sensor_a_dead_zone_wider_than_its_fault_stops_all_adaptation(tmp_path: Path) -> None:
    sizes = size_of_estimate(tmp_path, "dynamics.dead_zone=0.12", "inverse.dead_zone=0.12")
    np.testing.assert_array_equal(sizes, 0)


def test_with_a_wrong_sensor_a_ball_and_a_box_stop_the_drift_at_their_rim(tmp_path: Path) -> None:
    in_ball = size_of_estimate(tmp_path, "dynamics.a_d_hat_ball=[0, 10]")
    assert np.all(in_ball <= 10 * (1 + 1e-12))
    assert in_ball[-1] > 9
    in_box = size_of_estimate(tmp_path, "dynamics.a_d_hat_box=[-1, 7]")
    assert np.all(in_box <= 7 * np.sqrt(22))
    assert in_box[-1] < 20


def test_in_continuous_time_a_ball_holds_its_estimate_on_the_rim() -> None:
    overrides = ["clock=continuous", "dynamics.a_d_hat_ball=[0, 0.5]", "dynamics.Gamma=300", UNBOXED]
    graph = Graph.read("arm2_joint", overrides)
    run = simulate(graph.diagram, 10.0, clock=None, solver=graph.solver, start=graph.start)
    size = np.linalg.norm(run["dynamics.a_d_hat"], axis=1)
    assert run.divergence is None
    assert size.max() == pytest.approx(0.5, abs=1e-9)


def test_a_report_states_that_the_proof_has_a_residual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
    overrides = [
        "dynamics.leak=0.1",
        "inverse.dead_zone=0.1",
        "inverse.error_leak=1",
        "dynamics.a_d_hat_ball=[0, 10]",
        UNBOXED,
    ]
    graph = Graph.read("arm2_joint", [*overrides, "duration=1"])
    found = Verification(graph, graph.verdict())
    for name in ("report.md", "report.html"):
        found.report(tmp_path / name)
    text = (tmp_path / "report.md").read_text()
    assert "proved, up to a residual that grows with a signal, but not the stability of the whole loop" in text
    assert "The stability of the whole loop is not proved" in text
    assert "this control loop is stable" not in text
    assert "goes to zero" not in text
    assert "Residual, positive or of either sign:" in text
    assert "$a_{d}$" in text  # the estimate starts at zero
    assert "0 plus or minus 10" in text
    assert "Residual, positive" in (tmp_path / "report.html").read_text()
