"""P-PI cascade servo and its inverse, compared with the PID servo and with SciPy on the textbook's arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

import dmframe as dm
from dmframe.certify import verify
from dmframe.diagram import Diagram
from dmframe_blocks.p_pi_inverse import PPiInverse
from dmframe_plants.arm2 import closed_form

K_P, K_V, K_I = 20.0, np.array([60.0, 30.0]), np.array([240.0, 120.0])
SERVO = "{type: p_pi_servo, k_p: 20, K_v: [60, 30], K_i: [240, 120]"
PID = "{type: pid_servo, K_D: [60, 30], K_P: [1440, 720], K_I: [4800, 2400]}"
KINEMATIC = "  command: {type: kinematic_command}\n"
INVERSE = (
    "  model: {type: regressor, friction: [viscous]}\n  dynamics: {type: dynamic_compensator, Gamma: 10}\n"
    "  inverse: {type: p_pi_inverse, K_c: 5, Lambda_f: 0.1, Lambda: 0.01, Lambda_r: 1, Lambda_c: 1, Lambda_z: 1,"
    " w_r: 24, w_c: 24, w_z: 80}\n"
)


def graph(folder: Path, servo: str, law: str = KINEMATIC, clock: str = "4 ms") -> dm.Graph:
    file = folder / "cascade.yaml"
    file.write_text(
        f"dmframe: 1\nrobot: arm2\nclock: {clock}\nduration: 1 s\nblocks:\n"
        "  path: {type: sinusoid, center: [0.6, 0.9], amplitude: 0.3, rate: 3}\n"
        f"  task: {{type: joint_tracking, alpha_bar: 2}}\n{law}  servo: {servo}\n"
        "  arm: {type: manipulator, viscous: [1, 0.5]}\n",
        encoding="utf-8",
    )
    return dm.load(str(file))


def test_with_all_of_the_feed_forward_the_cascade_is_a_pid_servo(tmp_path: Path) -> None:
    """K_D = K_v, K_P = K_v k_p + K_i, K_I = K_i k_p."""
    cascade, pid = (graph(tmp_path, servo).run()["arm.q"].values for servo in (SERVO + "}", PID))
    np.testing.assert_allclose(cascade, pid, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("f", "filtered", "lag"), [(1.0, 0.0, 0.0), (0.6, 0.002, 0.001), (0.0, 0.0, 0.003)])
def test_the_servo_moves_the_textbooks_arm_as_in_scipy(f: float, filtered: float, lag: float, tmp_path: Path) -> None:
    """The commands of a run, applied by an integrator and a model that share no equation with dmframe."""
    options = f", feed_forward: {f}"
    options += f", velocity_filter: {filtered} s" if filtered else ""
    options += f", torque_lag: {lag} s" if lag else ""
    run = graph(tmp_path, SERVO + options + "}").run()
    commands, q = run["command.dq_c"].values, run["arm.q"].values

    def rate(_: float, y: NDArray[np.float64], dq_c: NDArray[np.float64]) -> NDArray[np.float64]:
        q, dq, q_c, xi, v, u = y.reshape(6, 2)
        e_v = f * dq_c + K_P * (q_c - q) - (v if filtered else dq)
        demanded = K_V * e_v + K_I * xi
        torque = (u if lag else demanded) - np.array([1, 0.5]) * dq
        rest = closed_form.coriolis(q, dq) @ dq + closed_form.gravity_torque(q)
        ddq = np.linalg.solve(closed_form.mass_matrix(q), torque - rest)
        dv = (dq - v) / filtered if filtered else 0 * v
        du = (demanded - u) / lag if lag else 0 * u
        return np.concatenate([dq, ddq, dq_c, e_v, dv, du])

    gravity, zero = closed_form.gravity_torque(q[0]), np.zeros(2)
    state = np.concatenate([q[0], zero, q[0], gravity / K_I, zero, gravity])
    for k, dq_c in enumerate(commands[:100]):
        moved = scipy.integrate.solve_ivp(rate, (0, 0.004), state, "LSODA", args=(dq_c,), rtol=1e-10, atol=1e-12)
        state = moved.y[:, -1]
        np.testing.assert_allclose(state[:2], q[k + 1], rtol=0, atol=1e-6)


ANGLES = "the joint angles q stay bounded"


@pytest.mark.parametrize("f", [0.8, 1.0])
def test_the_inverse_is_proved_for_each_share(f: float, tmp_path: Path) -> None:
    """A joint path bounds the joint angles."""
    found = graph(tmp_path, SERVO + f", feed_forward: {f}}}", INVERSE).verify()
    assert found.proved
    assert {"z", "q_c", "xi", "q"} <= {item.signal for item in found.verdict.statements if item.says == "is bounded"}
    assert ANGLES not in {item.text for item in found.verdict.assumptions}
    assert "q - q_d" in {item.signal for item in found.verdict.statements if item.says == "goes to zero"}


@pytest.mark.parametrize("f", [0.9, 1.0])
def test_where_the_task_does_not_bound_the_joint_angles_this_is_assumed(f: float) -> None:
    found = dm.load("known_tracking_p_pi").set({"servo.feed_forward": f}).verify()
    assert found.proved
    bounded = {item.signal: item.assumes for item in found.verdict.statements if item.says == "is bounded"}
    assert {signal for signal, assumed in bounded.items() if assumed == (ANGLES,)} == {"z", "q_c", "xi", "q"}
    assert ANGLES in {item.text for item in found.verdict.assumptions}
    gone = {item.signal: item.assumes for item in found.verdict.statements if item.says == "goes to zero"}
    # du/dt, and so the bounded derivative that Barbalat's lemma needs, contains the estimates times q_r, q_c and z
    marked = {signal for signal, assumed in gone.items() if ANGLES in assumed}
    assert marked >= {"dq - dq_r", "sigma", "d(x - x_d)/dt"}
    assert gone.keys() - marked == {"q - q_r", "J_hat'(x - x_d)", "x - x_d"}


def test_nothing_is_proved_without_feed_forward_or_with_a_filter_or_a_lag(tmp_path: Path) -> None:
    for share in ("0", "[1, 0]"):
        found = graph(tmp_path, SERVO + f", feed_forward: {share}}}", INVERSE).verify()
        assert found.outcome == "not_applicable"
        assert found.verdict.reason.startswith("inverse: the servo has no velocity feed-forward at a joint")
    for option in ("velocity_filter: 1 ms", "torque_lag: 1 ms", "cycle: 1 ms"):
        lagging = graph(tmp_path, SERVO + f", {option}}}", INVERSE).verify()
        assert (lagging.outcome, lagging.proved) == ("not_applicable", False)
        assert "no theorem covers its velocity_filter, torque_lag or cycle" in lagging.verdict.reason


@pytest.mark.parametrize("row", ["w_f", "w", "w_r", "w_c", "w_z"])
def test_a_wrong_sign_in_any_row_of_the_adaptation_is_refuted(row: str, tmp_path: Path) -> None:
    class Wrong(PPiInverse):  # type: ignore[misc]
        """With a seeded fault, and without printed laws."""

        def direction(self, u: Any, x: Any, p: Any, sigma: Any) -> Any:
            """One sign changed."""
            own = super().direction(u, x, p, sigma)
            return {**own, row: -own[row]}

    sound = graph(tmp_path, SERVO + ", feed_forward: 0.8}", INVERSE)
    given = {key: value for key, value in sound.blocks["inverse"].model_dump().items() if value is not None}
    blocks = {**sound.blocks, "inverse": Wrong(**given)}
    verdict = verify(Diagram.build(blocks, sound.file.wires, sound.robot))
    assert verdict.outcome == "refuted"


def test_a_wrong_true_value_is_refuted(tmp_path: Path) -> None:
    """w_c differs from w_r: with (K_v k_p + K_i)/(K_v f) for both, the identity holds for f = 1 only."""

    class Wrong(PPiInverse):  # type: ignore[misc]
        """With a seeded fault, and without printed laws."""

        def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Any:
            """The same true value for two estimates."""
            own = super().certificate(u, x, p, truth)
            return replace(own, estimates={**own.estimates, "w_c": own.estimates["w_r"]})

    sound = graph(tmp_path, SERVO + ", feed_forward: 0.8}", INVERSE)
    given = {key: value for key, value in sound.blocks["inverse"].model_dump().items() if value is not None}
    blocks = {**sound.blocks, "inverse": Wrong(**given)}
    assert verify(Diagram.build(blocks, sound.file.wires, sound.robot)).outcome == "refuted"


def test_v_does_not_rise_in_continuous_time_and_the_error_falls(tmp_path: Path) -> None:
    run = graph(tmp_path, SERVO + ", feed_forward: 0.8}", INVERSE, clock="continuous").run(until="4 s")
    V = run["V"].values
    assert np.max(np.diff(V)) <= 1e-9 * V[0]
    assert V[-1] < V[0]
