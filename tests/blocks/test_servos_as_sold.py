"""Servos with a robot model, load-dependent friction and a sampled cascade: compared with SciPy on a textbook arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

import dmframe as dm
from dmframe_plants.arm2 import closed_form

Array = NDArray[np.float64]
T, B = 0.004, np.array([1.0, 0.5])
K_P, K_V, K_I = 20.0, np.array([240.0, 60.0]), np.array([2400.0, 600.0])
CASCADE = "{type: p_pi_servo, k_p: 20, K_v: [240, 60], K_i: [2400, 600]"
K_D, K_Q, K_S = np.array([60.0, 30.0]), np.array([144.0, 72.0]), np.array([48.0, 24.0])
PID = "{type: pid_servo, K_D: [60, 30], K_P: [144, 72], K_I: [48, 24]}"


def graph(folder: Path, servo: str, more: str = "", solver: str = "") -> dm.Graph:
    file = folder / "sold.yaml"
    file.write_text(
        f"dmframe: 1\nrobot: arm2\nclock: {T} s\nduration: 1 s\n{solver}blocks:\n"
        "  path: {type: sinusoid, center: [0.6, 0.9], amplitude: 0.3, rate: 3}\n"
        "  task: {type: joint_tracking, alpha_bar: 2}\n  command: {type: kinematic_command}\n"
        f"  servo: {servo}\n{more}  arm: {{type: manipulator, viscous: [1, 0.5]}}\n",
        encoding="utf-8",
    )
    return dm.load(str(file))


def accelerated(q: Array, dq: Array, torque: Array) -> Array:
    rest = closed_form.coriolis(q, dq) @ dq + closed_form.gravity_torque(q) + B * dq
    return np.linalg.solve(closed_form.mass_matrix(q), torque - rest)


def followed(rate: Callable[..., Array], state: Array, commands: Array, samples: int = 100) -> Array:
    """The joint angles at the samples, by an integrator with held commands."""
    found = [state[:2]]
    for dq_c in commands[:samples]:
        state = scipy.integrate.solve_ivp(rate, (0, T), state, "LSODA", args=(dq_c,), rtol=1e-10, atol=1e-12).y[:, -1]
        found.append(state[:2])
    return np.array(found)


@pytest.mark.parametrize(("share", "off"), [(0.8, (0.0, 0.0)), (1.0, (0.2, -0.3))])
def test_a_servo_with_a_share_of_a_models_torque_moves_as_in_scipy(
    share: float, off: tuple[float, float], tmp_path: Path
) -> None:
    """Initially the integrator compensates the gravity that the model leaves; the links are heavier or lighter."""
    block = f"  model: {{type: model_compensation, share: {share}, off: {list(off)}, smoothing: 6 ms}}\n"
    run = graph(tmp_path, PID, block).run()
    commands, q = run["command.dq_c"].values, run["arm.q"].values
    own, (first, second) = closed_form.ARM2, (1 + off[0], 1 + off[1])
    model = replace(own, m_1=own.m_1 * first, I_1=own.I_1 * first, m_2=own.m_2 * second, I_2=own.I_2 * second)

    def rate(_: float, y: Array, dq_c: Array) -> Array:
        q, dq, q_c, i, dq_t = y.reshape(5, 2)
        ddq_t = (dq_c - dq_t) / 0.006
        known = closed_form.mass_matrix(q, model) @ ddq_t + closed_form.coriolis(q, dq, model) @ dq_t
        known += closed_form.gravity_torque(q, model)
        torque = -K_D * (dq - dq_c) - K_Q * (q - q_c) - K_S * i + share * known
        return np.concatenate([dq, accelerated(q, dq, torque), dq_c, q - q_c, ddq_t])

    left = closed_form.gravity_torque(q[0]) - share * closed_form.gravity_torque(q[0], model)
    zero = np.zeros(2)
    expected = followed(rate, np.concatenate([q[0], zero, q[0], -left / K_S, zero]), commands)
    np.testing.assert_allclose(q[:101], expected, rtol=0, atol=1e-6)


def test_a_model_reduces_the_error_by_its_share(tmp_path: Path) -> None:
    errors = []
    for share in (0, 0.5, 1):
        error = graph(tmp_path, PID, f"  model: {{type: model_compensation, share: {share}}}\n").run().error
        assert error is not None
        errors.append(error.rms_final)
    none, half, whole = errors
    assert half < 0.6 * none
    assert whole < 0.2 * none


def test_nothing_is_proved_of_a_servo_with_a_model() -> None:
    data = dm.load("arm2_joint").data
    feed = {"feed": {"type": "model_compensation", "share": 0.5}}
    found = dm.load({**data, "blocks": {**data["blocks"], **feed}}, name="feed").verify()
    assert found.outcome == "not_applicable"
    assert "no theorem covers a servo with a model of the robot" in found.verdict.reason


def test_friction_grows_with_the_motors_torque_as_in_scipy(tmp_path: Path) -> None:
    run = graph(tmp_path, PID, "  gears: {type: stribeck_friction, per_torque: [0.2, 0.1]}\n").run()
    commands, q = run["command.dq_c"].values, run["arm.q"].values

    def rate(_: float, y: Array, dq_c: Array, per_torque: Any = (0.2, 0.1)) -> Array:
        q, dq, q_c, i = y.reshape(4, 2)
        motor = -K_D * (dq - dq_c) - K_Q * (q - q_c) - K_S * i
        torque = motor - np.array(per_torque) * np.abs(motor) * np.tanh(dq / 0.005)
        return np.concatenate([dq, accelerated(q, dq, torque), dq_c, q - q_c])

    zero = np.zeros(2)
    start = np.concatenate([q[0], zero, q[0], -closed_form.gravity_torque(q[0]) / K_S])
    np.testing.assert_allclose(q[:101], followed(rate, start, commands), rtol=0, atol=1e-5)
    smooth = followed(lambda *given: rate(*given, per_torque=(0.0, 0.0)), start, commands)
    assert np.max(np.abs(q[:101] - smooth)) > 1e-3


def sampled(commands: Array, q: Array, cycle: float, samples: int = 150) -> Array:
    """The cascade as programmed by manufacturers: per cycle one reading, one update, and a held torque."""
    found, dq, q_c, xi = [q], np.zeros(2), q, closed_form.gravity_torque(q) / K_I

    def rate(_: float, y: Array, torque: Array) -> Array:
        return np.concatenate([y[2:], accelerated(y[:2], y[2:], torque)])

    for dq_c in commands[:samples]:
        for _ in range(round(T / cycle)):
            e_v = dq_c + K_P * (q_c - q) - dq
            held = K_V * e_v + K_I * xi
            moved = scipy.integrate.solve_ivp(
                rate, (0, cycle), np.concatenate([q, dq]), "DOP853", args=(held,), rtol=1e-9, atol=1e-12
            ).y[:, -1]
            q, dq, q_c, xi = moved[:2], moved[2:], q_c + cycle * dq_c, xi + cycle * e_v
        found.append(q)
    return np.array(found)


def test_a_cycle_is_approximately_the_cascade_that_holds_its_torque(tmp_path: Path) -> None:
    """p_pi_servo is continuous: the test bounds its difference from the sampled servo with this `cycle`."""
    left = {}
    for option in ("", ", cycle: 1 ms", ", torque_lag: 0.5 ms"):
        run = graph(tmp_path, f"{CASCADE}{option}}}", solver="solver: {method: rk4, step: 0.2 ms}\n").run()
        q = run["arm.q"].values[:151]
        apart = np.abs(q - sampled(run["command.dq_c"].values, q[0], 1e-3))
        left[option] = np.max(apart), np.max(apart[75:])
    whole, late = left[""]
    assert whole == pytest.approx(350e-6, rel=0.05)
    assert left[", cycle: 1 ms"][0] < whole / 5
    assert left[", cycle: 1 ms"][1] < late / 20
    assert left[", torque_lag: 0.5 ms"][0] > whole  # the command has a direct effect
