"""A hidden robot's servo, identified from positions and commands only."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import dmframe as dm
from dmframe.identification.drawn import thetas
from dmframe.identification.found import Identified
from dmframe.identification.identify import chain_of
from dmframe.identification.log import Log
from dmframe.identification.model import model_of
from dmframe.identification.roots import second, with_friction
from dmframe.identification.twin import schedule, twins_of
from dmframe.identification.unknowns import Unknowns
from tests.framework.identify.plants import QUANTUM, START, Hidden, record, steps, write

K_P, K_I = np.array([5.0, 7.0, 9.0]), np.array([4.0, 8.0, 6.0])


def inside(found: Identified, name: str, true: np.ndarray) -> bool:
    _, limits = found.servo[name]
    return bool(np.all((limits[:, 0] <= true) & (true <= limits[:, 1])))


def test_a_pid_servo_its_gains_and_its_delay_are_found_within_half_a_percent(tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", *record(Hidden(K_P, K_P, K_I)))
    found = dm.identify(file, "ur10_slow", out=tmp_path / "out")
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(K_P, rel=0.005)
    assert found.servo["k_I"][0] == pytest.approx(K_I, rel=0.02)
    assert found.delay[0] == pytest.approx(1, abs=0.02)
    assert found.delay[1][0] <= 1 <= found.delay[1][1]
    summary = found.summary
    keys = "servo delay friction limits torques bodies residual floor indistinguishable verdict"
    assert set(summary) == set(keys.split())
    check_twin(found, tmp_path / "out")
    check_draws(found)


def check_draws(found: Identified) -> None:
    """Twins drawn from the covariance of the fit have nearly its residual."""
    unknowns, theta = found.fit.unknowns, found.fit.theta[:, None]
    delay = found.delay[0] * unknowns.log.period
    plan = schedule(unknowns.log, delay)
    numbers = unknowns.numbers(np.hstack([theta, thetas(found, 7)]), delay)
    q = twins_of(unknowns.model).positions(plan, numbers)
    rms = np.sqrt(np.mean((unknowns.log.q[:, :, None] - q) ** 2, axis=0))
    assert np.all(rms[:, 1:] < 1.1 * rms[:, :1])
    assert np.all(rms[:, 1:] > rms[:, :1])


def check_twin(found: Identified, out: Path) -> None:
    """The written robot has the identified base parameters, and the written graph runs with the intervals."""
    graph = dm.load(out / "twin.yaml")
    value = {leaf.label: np.asarray(leaf.value) for leaf in graph.diagram.loop.parameters}
    beta = model_of(graph.diagram.robot)
    rotors = beta.grouping[:, beta.base.parameters.places("rotor")] @ value["arm.rotor"]
    assert beta.base.kept == found.fit.unknowns.model.base.kept
    assert beta.nominal + rotors == pytest.approx(found.number("beta")[0], abs=1e-5)
    assert 1 / value["servo.K_D"] == pytest.approx(found.servo["w"][0])
    assert {"servo.K_D", "arm.viscous", "arm.rotor"} <= set(graph.intervals())
    low, high = np.array(YAML().load(out / "twin.yaml")["uncertain"]["servo.K_D"], dtype=float)
    assert np.all((low < value["servo.K_D"]) & (value["servo.K_D"] < high))
    assert np.all(high < 1.05 * low)  # at the scale of the torques of the graph's robot
    assert graph.run("0.5 s", progress=False).recording.divergence is None
    assert json.loads((out / "identified.json").read_text())["record"]["sha256"]


def test_a_pi_servo_is_found(tmp_path: Path) -> None:
    found = dm.identify(write(tmp_path / "log.csv", *record(Hidden(K_P, K_P, 0 * K_P), delay=0)), "ur10_slow")
    assert found.kind == "pi"
    assert found.servo["k_I"][0] == pytest.approx(K_P, rel=0.005)


def test_a_cascade_with_half_the_feed_forward_is_found(tmp_path: Path) -> None:
    p, i, f = np.array([8.0, 10.0, 9.0]), np.array([4.0, 3.0, 5.0]), 0.6
    found = dm.identify(
        write(tmp_path / "log.csv", *record(Hidden(p + f * i, p + i, p * i, f), seconds=9.5, delay=2)), "ur10_slow"
    )
    assert found.kind == "p_pi"
    assert found.servo["f"][0] == pytest.approx([f] * 3, abs=0.05)
    assert found.delay[0] == pytest.approx(2, abs=0.1)


def test_a_cascade_without_feed_forward_is_found_although_its_integrator_turns_with_the_joint(tmp_path: Path) -> None:
    p, i = np.array([17.0, 8.0, 9.0]), np.array([8.0, 6.0, 5.0])
    found = dm.identify(write(tmp_path / "log.csv", *record(Hidden(p, p + i, p * i, 0.0), seconds=16.0)), "ur10_slow")
    assert found.kind == "p_pi"
    assert found.servo["k_p"][0] == pytest.approx(p, rel=0.01)
    assert found.servo["f"][0] == pytest.approx([0] * 3, abs=0.01)
    assert found.delay[0] == pytest.approx(1, abs=0.05)


def test_a_twin_moves_as_a_hidden_robot_whose_friction_grows_with_the_torque() -> None:
    hidden = Hidden(K_P, K_P, K_I, per_torque=0.1)
    t, q, u = record(hidden, seconds=3.0)
    log, model = Log(t, q, u[:-1], np.zeros(3)), model_of(chain_of("ur10_slow"))
    rotors = model.grouping[:, model.base.parameters.places("rotor")] @ np.full(3, hidden.rotor)
    number = {"f": hidden.f, "a": hidden.a, "b": hidden.b, "c": hidden.c, "w": hidden.w, "v_0": hidden.v_0, "v_s": 1.0}
    number |= {"B": hidden.viscous, "D": hidden.coulomb, "L": hidden.per_torque, "q_0": q[0]}
    number["beta"] = hidden.mass * model.nominal + rotors
    p = np.zeros((model.size, 2))
    for name, value in number.items():
        p[model.places[name]] = np.reshape(np.broadcast_to(value, p[model.places[name], 0].shape), (-1, 1))
    p[model.places["L"], 1] = 0.0
    found = twins_of(model).positions(schedule(log, log.period), p)
    error = np.max(np.abs(found - q[:, :, None]), axis=(0, 1))
    assert error[0] < QUANTUM
    assert error[1] > 20 * QUANTUM


def test_two_cascades_have_the_same_motion_and_the_one_with_viscous_friction_is_taken() -> None:
    t, u = 0.008 * np.arange(400), steps(0.008, 3.2, 0)
    log = Log(t, np.tile(START, (400, 1)), u[:-1], np.zeros(3))
    unknowns = Unknowns(model_of(chain_of("ur10_slow")), log, "p_pi")
    at, theta = unknowns.places, np.zeros(unknowns.size)
    theta[at["k_p"]], theta[at["k_i"]], theta[at["f"]] = np.log([6.43, 13.0, 5.4]), np.log([9.97, 9.8, 9.0]), 0.77
    theta[at["w"]], theta[at["B"]], theta[at["D"]] = np.log([1 / 700, 1 / 900, 1 / 450]), [0.01, 0.2, 0.2], 0.01
    theta[at["v_0"]], theta[at["v_s"]], theta[at["delay"]] = np.log(0.02), np.log(0.05), 1.0
    other = second(unknowns, theta)
    assert np.all(np.abs(other[at["f"]] - theta[at["f"]]) > 0.02)
    assert second(unknowns, other) == pytest.approx(theta, abs=1e-9)
    both = unknowns.numbers(np.column_stack([theta, other]), log.period)
    q = twins_of(unknowns.model).positions(schedule(log, log.period), both)
    assert np.ptp(q[:, 0, 0]) > 0.01
    assert q[:, :, 0] == pytest.approx(q[:, :, 1], abs=1e-7)
    wrong = other.copy()
    wrong[at["B"]] = theta[at["B"]]
    moved = twins_of(unknowns.model).positions(schedule(log, log.period), unknowns.numbers(wrong[:, None], log.period))
    assert np.max(np.abs(moved[:, :, 0] - q[:, :, 0])) > 1e-5
    start = other.copy()
    assert np.array_equal(with_friction(unknowns, start, np.ones(3)), start)  # negative by an error of the fit
    settled = with_friction(unknowns, start, np.full(3, 1e-3))
    negative = start[at["B"]] < 0
    assert np.any(negative)
    assert np.all(settled[at["B"]][negative] == pytest.approx(theta[at["B"]][negative]))
    assert np.array_equal(settled[at["f"]][~negative], start[at["f"]][~negative])


def test_friction_that_grows_with_the_torque_is_found_and_in_the_twin(tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", *record(Hidden(K_P, K_P, K_I, per_torque=0.06), seconds=9.5))
    found = dm.identify(file, "ur10_slow", out=tmp_path / "out")
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(K_P, rel=0.005)
    assert found.delay[0] == pytest.approx(1, abs=0.02)
    value, limits = found.friction["per_torque"]
    assert value == pytest.approx([0.06] * 3, rel=0.1)
    assert np.all(np.abs(value - 0.06) < 0.75 * (limits[:, 1] - limits[:, 0]))  # three standard deviations
    check_twin(found, tmp_path / "out")
    [block] = [block for block in dm.load(tmp_path / "out" / "twin.yaml").blocks.values() if hasattr(block, "uneven")]
    assert block.per_torque == pytest.approx(value)


def test_friction_with_memory_is_no_confident_twin(tmp_path: Path) -> None:
    hidden = Hidden(K_P, K_P, K_I, hysteresis=60.0)
    found = dm.identify(write(tmp_path / "log.csv", *record(hidden)), "ur10_slow")
    assert found.kind == "unknown"
    assert found.summary["servo"] == {"class": "unknown", "parameters": {}, "intervals": None}
    assert found.summary["delay"]["interval"] is None


def test_lost_samples_are_found_and_their_commands_estimated(tmp_path: Path) -> None:
    t, q, u = record(Hidden(K_P, K_P, K_I), delay=2)
    kept = np.random.default_rng(0).random(len(t)) > 0.01
    kept[np.flatnonzero(np.diff(u[:, 0]))[3] + 1] = False  # the first sample of a step
    kept[0] = True
    found = dm.identify(write(tmp_path / "log.csv", t[kept], q[kept], u[kept]), "ur10_slow")
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(K_P, rel=0.005)
    assert found.delay[0] == pytest.approx(2, abs=0.02)
    assert any("samples are lost" in text and "are estimated" in text for text in found.notices)


@pytest.mark.parametrize("kind", ["recorded times", "samples and commands"])
def test_times_that_vary_are_found(kind: str, tmp_path: Path) -> None:
    t, q, u = record(Hidden(K_P, K_P, K_I), delay=2, jitter=0.2 if kind == "samples and commands" else 0.0)
    if kind == "recorded times":
        t = t + 0.0008 * np.random.default_rng(1).normal(size=len(t))
    found = dm.identify(write(tmp_path / "log.csv", t, q, u), "ur10_slow")
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(K_P, rel=0.005)
    assert found.delay[0] == pytest.approx(2, abs=0.02)
    text = {"recorded times": "its times are used", "samples and commands": "the delay is a number of intervals"}[kind]
    assert any(text in notice for notice in found.notices)


def test_the_limit_of_a_robot_that_clips_commands_is_found(tmp_path: Path) -> None:
    file = write(tmp_path / "log.csv", *record(Hidden(K_P, K_P, K_I), limit=0.25))
    found = dm.identify(file, "ur10_slow")
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(K_P, rel=0.005)
    assert [found.limited[joint][0] for joint in range(3)] == pytest.approx([0.25] * 3, rel=1e-4)
    assert any("the robot clips them at about 0.25 rad/s" in text for text in found.notices)
