"""A robot with joint position commands: its error in discrete time, and no change in continuous time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import scipy

from dmframe.catalogue import graphs
from dmframe.certify import verify
from dmframe.common.errors import AccessError
from dmframe.graph.graph import Graph
from dmframe.results.metrics import tracking_error
from dmframe.simulate import Recording, simulate

POSITION = "  command:  {type: position_command}\n  interface: {type: position_interface}\n"
SERVOS: Mapping[str, tuple[str, str]] = {
    "pi": (
        "{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1, w_I_box: [0.2, 10]}",
        "{type: pi_servo, K_P: [6, 3], K_I: [24, 12]}",
    ),
    "pid": (
        "{type: pid_inverse, K_c: 0.8, Lambda: 0.01, Lambda_P: 1, Lambda_I: 1, w_P: 2, w_I: 0.7,"
        " w_P_box: [1, 3], w_I_box: [0.5, 2]}",
        "{type: pid_servo, K_D: [8, 4], K_P: [18, 9], K_I: [6, 3]}",
    ),
}


def graph(folder: Path, servo: str, position: str, clock: str = "continuous") -> Path:
    inverse, law = SERVOS[servo]
    file = folder / f"{servo}_{bool(position)}.yaml"
    file.write_text(
        f"dmframe: 1\nrobot: arm2\nclock: {clock}\nduration: 1\nblocks:\n"
        "  path: {type: sinusoid, center: [0.6, 0.9], amplitude: 0.3, rate: 2}\n"
        "  task: {type: joint_tracking, alpha_bar: 2}\n  model: {type: regressor, friction: [viscous]}\n"
        f"  dynamics: {{type: dynamic_compensator, Gamma: 0.5}}\n  inverse: {inverse}\n{position}  servo: {law}\n"
        "  arm: {type: manipulator, viscous: 1}\n",
        encoding="utf-8",
    )
    return file


def run(file: Path | str, duration: float) -> Recording:
    loaded = Graph.read(str(file))
    return simulate(loaded.diagram, duration, clock=loaded.file.clock, solver=loaded.solver, start=loaded.start)


@pytest.mark.parametrize("servo", SERVOS)
def test_in_continuous_time_both_commands_are_proved_and_move_alike(servo: str, tmp_path: Path) -> None:
    position, velocity = (graph(tmp_path, servo, text) for text in (POSITION, ""))
    assert verify(Graph.read(position).diagram, trials=1).outcome == "proved"
    np.testing.assert_allclose(run(position, 1.0)["arm.q"], run(velocity, 1.0)["arm.q"], rtol=0, atol=1e-12)


GAINS = {"pi": (6.0, 24.0), "pid": (20.0, 60.0, 20.0)}


@pytest.mark.parametrize("servo", SERVOS)
@pytest.mark.parametrize("position", [True, False])
def test_on_a_clock_the_servo_works_with_the_position_of_the_last_sample(
    servo: str, position: bool, tmp_path: Path
) -> None:
    names = {"pi": ("K_P", "K_I"), "pid": ("K_D", "K_P", "K_I")}[servo]
    gains = ", ".join(f"{name}: {gain}" for name, gain in zip(names, GAINS[servo], strict=True))
    file = tmp_path / "pendulum.yaml"
    file.write_text(
        "dmframe: 1\nrobot: pendulum\nclock: 50 ms\nduration: 1\nblocks:\n"
        "  path: {type: sinusoid, center: [0.6], amplitude: 0.3, rate: 2}\n"
        "  task: {type: joint_tracking, alpha_bar: 2}\n"
        f"  inverse: {{type: kinematic_command}}\n{POSITION if position else ''}"
        f"  servo: {{type: {servo}_servo, {gains}}}\n"
        "  arm: {type: manipulator, viscous: 0.3}\n",
        encoding="utf-8",
    )
    done = run(file, 1.0)
    np.testing.assert_allclose(done["arm.q"][:, 0], by_hand(servo, position), rtol=0, atol=1e-8)


def by_hand(servo: str, position: bool) -> np.ndarray:
    """The pendulum with the kinematic controller, in SciPy with textbook equations; q at every sample."""
    period, inertia, weight, B = 0.05, 0.06 + 2 * 0.3**2, 2 * 9.81 * 0.3, 0.3
    K_I = GAINS[servo][-1]

    def rate(t: float, state: np.ndarray, dq_c: float, q_held: float) -> list[float]:
        q, dq, q_c, i = state  # i: integral of q - q_c or, for held positions, of q - q_held
        target = q_held if position else q_c
        if servo == "pi":
            K_P, _ = GAINS["pi"]
            u, di = -K_P * (dq - dq_c) - K_I * (q - target + i), 0.0  # i: the constant that compensates gravity
        else:
            K_D, K_P, _ = GAINS["pid"]
            u, di = -K_D * (dq - dq_c) - K_P * (q - target) - K_I * i, q - target
        return [dq, (u - B * dq - weight * np.sin(q)) / inertia, dq_c, di]

    state = np.array([0.6, 0.0, 0.6, -weight * np.sin(0.6) / K_I])
    path = [state[0]]
    for k in range(20):
        t = k * period
        q_d, dq_d = 0.6 + 0.3 * np.sin(2 * t), 0.6 * np.cos(2 * t)
        dq_c = dq_d - 2 * (state[0] - q_d)
        held = (dq_c, state[2])
        state = scipy.integrate.solve_ivp(rate, (t, t + period), state, args=held, rtol=1e-11, atol=1e-12).y[:, -1]
        path.append(state[0])
    return np.array(path)


def test_the_staircase_costs_the_kinematic_controller_what_was_measured_once(tmp_path: Path) -> None:
    before, servo, after = graphs()["ur10_fast_kinematic"].read_text(encoding="utf-8").partition("  servo:")
    file = tmp_path / "position.yaml"
    assert servo
    file.write_text(f"{before}{POSITION}{servo}{after}", encoding="utf-8")
    found = {}
    for name in (file, "ur10_fast_kinematic"):
        error = tracking_error(run(name, 50.3))
        assert error is not None
        found[str(name)] = 1e3 * float(error.rms_final or np.nan)
    position, velocity = found.values()
    assert velocity == pytest.approx(9.38, rel=0.02)
    assert position == pytest.approx(10.27, rel=0.02)


def test_a_torque_is_still_not_a_command(tmp_path: Path) -> None:
    file = graph(tmp_path, "pid", POSITION)
    file.write_text(file.read_text(encoding="utf-8") + "wires: {interface.q_t: task.dq_r}\n", encoding="utf-8")
    with pytest.raises(AccessError) as caught:
        _ = Graph.read(file).diagram
    assert "task.dq_r cannot be commanded: interface.q_t takes only joint velocities and positions" in str(caught.value)
