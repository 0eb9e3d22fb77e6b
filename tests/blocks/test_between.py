"""Channel models between controller and robot, compared with NumPy, SciPy and Pinocchio; and the notices of a run."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy

import dmframe as dm
from dmframe.catalogue import find_block
from dmframe.common.errors import DmframeError
from dmframe.robot.library import load as load_robot
from dmframe.simulate.instants import DRAWN, Instants

T = 0.004
STEP = 2 * np.pi / 2**17
Array = np.ndarray
Blocks = Mapping[str, Mapping[str, Any]]
PLAIN = {
    "dmframe": 1,
    "robot": "arm2",
    "clock": T,
    "seed": 7,
    "duration": 0.6,
    "start": {"q": [0.7, 1.1]},
    "blocks": {
        "path": {"type": "sinusoid", "center": [0.8, 1.0], "amplitude": [0.5, 0.6], "rate": [2.0, 3.0]},
        "task": {"type": "joint_tracking", "alpha_bar": 4},
        "command": {"type": "kinematic_command"},
        "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
        "arm": {"type": "manipulator", "viscous": [1, 0.5], "coulomb": [0.5, 0.2]},
    },
}


def graph(**blocks: Mapping[str, Any]) -> dm.Graph:
    """The plain graph with additional or other blocks."""
    held: Any = PLAIN["blocks"]
    return dm.load({**PLAIN, "blocks": {**held, **blocks}}, name="between")


def run(**blocks: Mapping[str, Any]) -> dict[str, Array]:
    """The recorded signals of a run, without matrices."""
    found = graph(**blocks).run(engine="interpreted").recording
    assert found.divergence is None
    return {**found.states, **found.outputs}


@cache
def seen_by(**values: float) -> dict[str, Array]:
    return run(encoder={"type": "encoder", "step": STEP, **values})


def rounded(q: Array, step: float = STEP) -> Array:
    return np.asarray(np.round(q / step) * step)


def filtered(differences: Array, time_constant: float) -> Array:
    c = np.exp(-T / time_constant)
    return np.asarray(scipy.signal.lfilter([1 - c], [1, -c], differences, axis=0))


def over(q: Array, time: float) -> Array:
    """(q - q(t - time)) / time, with the first Padé approximation of the delay, from SciPy's response to ramps."""
    times = T * np.arange(len(q))
    lag = np.column_stack([scipy.signal.lsim(([1.0], [time / 2, 1.0]), row - row[0], times)[1] + row[0] for row in q.T])
    return (q - (2 * lag - q)) / time


def test_an_encoder_rounds_angles_to_its_nearest_step() -> None:
    found = seen_by()
    np.testing.assert_allclose(found["encoder.q_m"], rounded(found["arm.q"]), atol=1e-12)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(found["encoder.q_m"], rounded(found["arm.q"], 2 * STEP), atol=1e-12)
    assert 0.2 * STEP < np.std(found["encoder.q_m"] - found["arm.q"]) < 0.4 * STEP  # 0.29, of a uniform error


def test_velocities_are_differences_over_a_sample_and_may_be_filtered() -> None:
    for time_constant in (None, 0.02):
        found = seen_by(**({} if time_constant is None else {"time_constant": time_constant}))
        differences = np.diff(found["encoder.q_m"], axis=0, prepend=found["encoder.q_m"][:1]) / T
        wanted = differences if time_constant is None else filtered(differences, time_constant)
        np.testing.assert_allclose(found["encoder.dq_m"], wanted, atol=1e-9)
        if time_constant is not None:
            with pytest.raises(AssertionError):
                np.testing.assert_allclose(found["encoder.dq_m"], filtered(differences, 0.03), atol=1e-9)


def test_a_manufacturers_differences_are_over_its_own_window() -> None:
    found, window = seen_by(window=0.008), 0.008
    wanted, twice = over(found["arm.q"], window), over(found["arm.q"], 2 * window)
    off, other = (np.max(np.abs(found["encoder.dq_m"] - each)[10:]) for each in (wanted, twice))
    assert off < 2 * STEP / window < other  # two roundings of half a step, linear interpolation between samples
    late = np.interp(T * np.arange(len(wanted)) - window / 2, T * np.arange(len(wanted)), found["arm.dq"][:, 0])
    assert np.max(np.abs(wanted[10:, 0] - late[10:])) < 0.05 * np.max(np.abs(late))


def test_noise_is_that_of_the_seed_and_of_the_stated_size() -> None:
    noisy = graph(encoder={"type": "encoder", "step": 1e-12, "noise": [1e-3, 2e-3]})
    one, again = (noisy.run().recording for _ in range(2))
    other = noisy.set(seed=8).run().recording
    assert np.array_equal(one["encoder.q_m"], again["encoder.q_m"])
    assert not np.array_equal(one["encoder.q_m"], other["encoder.q_m"])
    drawn = Instants.of(one.diagram.loop, T, 7).rows(0, len(one.time))[:, DRAWN:]
    added = drawn[:, :2] * [1e-3, 2e-3]
    np.testing.assert_allclose(one["encoder.q_m"] - one["arm.q"], added, atol=1e-11)


def test_the_tool_is_seen_through_the_encoders_and_through_no_one_elses_lengths() -> None:
    found, chain = seen_by(), load_robot("arm2")
    data = chain.model.createData()
    for k in (0, 70, 150):
        pin.framesForwardKinematics(chain.model, data, found["encoder.q_m"][k])
        seen = data.oMf[chain.model_tool].translation[[0, 2]]
        np.testing.assert_allclose(found["encoder.x_m"][k], seen, atol=1e-12)
    sensor = graph(encoder={"type": "encoder", "step": STEP, "tool_from": "sensor"})
    assert "encoder.x_m" not in sensor.run().recording.outputs


def test_controllers_read_the_encoder_even_where_a_wire_states_the_arm_and_all_others_the_truth() -> None:
    data: Any = {**PLAIN, "blocks": {**PLAIN["blocks"], "encoder": {"type": "encoder", "step": 0.01}}}  # type: ignore[dict-item]
    for wires in ({}, {"task.q": "arm.q"}):
        made = dm.load({**data, "wires": wires}, name="between")
        sources = {end: f"{s.block}.{s.port}" for end, s in made.diagram.sources.items() if hasattr(s, "port")}
        assert sources["task", "q"] == "encoder.q_m"
        assert sources["servo", "q"] == sources["encoder", "q"] == "arm.q"
    found = made.run()
    assert found.error is not None
    assert (found.error.desired, found.error.actual) == ("path.q_d", "arm.q")
    assert found.notices[0] == "not ideal: arm.q, arm.dq and arm.x through encoder"
    assert graph().run().notices == ()


def delayed(sent: Array, samples: int, share: float = 0.0) -> Array:
    """Delayed by whole samples and a fraction of one, zero before."""
    early = np.vstack([np.zeros((samples + 1, sent.shape[1])), sent])
    return (1 - share) * early[1 : len(sent) + 1] + share * early[: len(sent)]


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_a_command_arrives_whole_samples_late(samples: int) -> None:
    found = run(way={"type": "transport_delay", "samples": samples})
    sent, arrived = found["command.dq_c"], found["way.dq_c_late"]
    assert np.array_equal(arrived, delayed(sent, samples))
    assert not np.array_equal(arrived, delayed(sent, samples + 1))
    taken = found["arm.q"][0] + T * np.vstack([np.zeros(2), np.cumsum(arrived, axis=0)[:-1]])
    np.testing.assert_allclose(found["servo.q_c"], taken, atol=1e-12)  # the servo integrates the delayed command


def test_a_share_of_a_sample_is_exact_at_samples_and_between_them_within_its_bound() -> None:
    share = 0.3
    found = run(way={"type": "transport_delay", "samples": 1, "share": share})
    sent, arrived = found["command.dq_c"], found["way.dq_c_late"]
    np.testing.assert_allclose(arrived, delayed(sent, 1, share), atol=1e-14)
    # the exact one changes at (k + share) T; its integral on a grid of a tenth of a sample
    change = np.repeat(delayed(sent, 1), 10, axis=0)
    exact = np.vstack([np.zeros((3, 2)), change])[: len(change)]
    taken = np.cumsum(exact, axis=0) * T / 10
    smeared = np.cumsum(np.repeat(arrived, 10, axis=0), axis=0) * T / 10
    assert np.max(np.abs((taken - smeared)[9::10])) < 1e-12
    bound = np.max(np.abs(np.diff(delayed(sent, 1), axis=0))) * T / 4
    assert 0.5 * bound < np.max(np.abs(taken - smeared)) < bound


def chances(way: Mapping[str, Any], ticks: int) -> tuple[dict[str, Array], Array]:
    found = graph(way={"type": "transport_delay", **way}).run(engine="interpreted").recording
    drawn = Instants.of(found.diagram.loop, T, 7).rows(0, ticks)[:, DRAWN:]
    return {**found.states, **found.outputs}, (drawn + 1) / 2


def test_late_and_lost_commands_come_as_given_by_the_seed() -> None:
    found, chance = chances({"samples": 2, "late": 0.3, "lost": 0.1}, 151)
    sent, arrived = found["command.dq_c"], found["way.dq_c_late"]
    due, before, last = delayed(sent, 2), delayed(sent, 3), np.zeros(2)
    events = np.zeros(2, dtype=int)
    for k in range(len(sent)):
        late, lost = chance[k, 0] < 0.3, chance[k, 1] < 0.1
        last = last if lost else before[k] if late else due[k]
        events += [late, lost]
        assert np.array_equal(arrived[k], last), k
    assert 25 < events[0] < 65  # of 151 samples, 45 and 15 are expected
    assert 5 < events[1] < 27
    never, _ = chances({"samples": 2, "late": 0.0, "lost": 0.0}, 151)
    assert np.array_equal(never["way.dq_c_late"], delayed(never["command.dq_c"], 2))
    always, _ = chances({"samples": 2, "late": 1.0}, 151)
    assert np.array_equal(always["way.dq_c_late"], delayed(always["command.dq_c"], 3))


def test_positions_and_torques_are_delayed_too_and_start_where_the_robot_is_held() -> None:
    found = run(
        send={"type": "position_command"},
        takes={"type": "position_interface"},
        way={"type": "transport_delay", "samples": 2, "carries": "position"},
    )
    sent, arrived = found["send.q_t"], found["way.q_t_late"]
    assert np.array_equal(arrived, np.vstack([[found["arm.q"][0]] * 2, sent])[: len(sent)])
    assert np.array_equal(found["way.dq_c_late"], delayed(found["command.dq_c"], 2))
    made = dm.load("slotine_li").set({"clock": "2 ms", "duration": 0.1})
    torque = made.set({"blocks.way": {"type": "transport_delay", "carries": "torque"}}).run().recording
    tau, late = torque["command.tau_c"], torque["way.tau_c_late"]
    assert np.array_equal(late[1:], tau[:-1])
    still = made.set({"blocks.way": {"type": "transport_delay", "carries": "torque", "samples": 4}}).run().recording
    held = np.abs(still["arm.dq"][:5])
    assert np.max(held) < 1e-9


def test_measurements_come_late_together_and_the_servos_target_with_them() -> None:
    found = run(
        encoder={"type": "encoder", "step": STEP},
        back={"type": "measurement_delay", "samples": 2, "share": 0.25},
        send={"type": "position_command"},
        takes={"type": "position_interface"},
    )
    names = {"q": "encoder.q_m", "dq": "encoder.dq_m", "x": "encoder.x_m", "q_c": "servo.q_c"}
    for name, origin in names.items():
        first = found[origin][0]
        wanted = delayed(found[origin] - first, 2, 0.25) + first
        np.testing.assert_allclose(found[f"back.{name}_late"], wanted, atol=1e-12, err_msg=name)
    assert np.array_equal(found["send.q_t"], found["back.q_c_late"])


def test_commands_are_cut_off_at_the_robots_own_limits_or_those_given_and_the_run_warns() -> None:
    for speed, limits in ((None, [3.0, 4.0]), ([0.5, 0.9], [0.5, 0.9])):
        given = {} if speed is None else {"speed": speed}
        made = graph(limits={"type": "command_limits", **given}).set({"path.rate": [9.0, 9.0]})
        found = made.run(engine="interpreted")
        sent, taken = found.recording["command.dq_c"], found.recording["limits.dq_lim"]
        assert np.array_equal(taken, np.clip(sent, -np.array(limits), limits))
        over_it = np.any(sent != taken, axis=1)
        assert over_it.any()
        first = found.time[np.argmax(over_it)]
        assert found.notices[1].startswith(
            f"a commanded velocity is beyond its limit, and is saturated, first at t = {first:.6g} s, in "
            f"{100 * np.mean(over_it):.3g} % of the recorded instants; the largest value is "
        )
        q_c = found.recording["arm.q"][0] + T * np.vstack([np.zeros(2), np.cumsum(taken, axis=0)[:-1]])
        np.testing.assert_allclose(found.recording["servo.q_c"], q_c, atol=1e-12)
    assert len(graph(limits={"type": "command_limits", "speed": 9}).run().notices) == 1


def test_signals_of_warnings_are_recorded_though_the_log_lists_other_signals() -> None:
    few = graph(limits={"type": "command_limits", "speed": 0.5}).set({"log": {"signals": ["arm.q"]}})
    assert few.run().notices[1].startswith("a commanded velocity is beyond its limit")


def test_a_ramp_is_a_filter_near_the_command_and_a_straight_line_far_from_it() -> None:
    found = run(ramp={"type": "command_ramp", "time_constant": 0.02})
    c = np.exp(-T / 0.02)  # exact, of a command that is held for a sample
    sent = found["command.dq_c"]
    wanted = scipy.signal.lfilter([0, 1 - c], [1, -c], sent, axis=0)
    np.testing.assert_allclose(found["ramp.dq_ramp"], wanted, atol=1e-6)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(
            found["ramp.dq_ramp"], scipy.signal.lfilter([0, 1 - c], [1, -c], 1.01 * sent, axis=0), atol=1e-6
        )
    found = run(ramp={"type": "command_ramp", "acceleration": [5, 6]})
    slope = np.diff(found["ramp.dq_ramp"], axis=0) / T
    assert np.all(np.abs(slope) <= np.array([5, 6]) * (1 + 1e-9))
    np.testing.assert_allclose(np.abs(slope[:3]), [[5, 6]] * 3)  # from rest to a distant command


def test_a_motors_torque_ends_at_its_limit_and_friction_is_compensated_before_it() -> None:
    found = graph(
        friction={"type": "friction_compensation", "coulomb": [0.5, 0.2], "velocity": 0.05},
        drive={"type": "torque_limits", "torque": [18, 6]},
        arm={"type": "manipulator", "K": [2, 4], "viscous": [1, 0.5], "coulomb": [0.5, 0.2]},
    ).run(engine="interpreted")
    rows, K = found.recording, np.array([2.0, 4.0])
    more = rows["servo.u"] + np.array([0.5, 0.2]) * np.tanh(rows["arm.dq"] / 0.05) / K
    np.testing.assert_allclose(rows["friction.u_comp"], more, rtol=1e-12)
    np.testing.assert_allclose(rows["drive.u_lim"], np.clip(K * more, [-18, -6], [18, 6]) / K, rtol=1e-12)
    assert np.max(np.abs(rows["drive.tau_excess"])) > 1
    assert found.notices[1].startswith("a motor's torque is beyond its limit, and is saturated, first at")
    ends = {"drive": {"type": "torque_limits"}}
    assert graph(**ends).run().recording["drive.u_lim"].max() <= 120  # the URDF's


def test_joints_stick_at_slow_motion_and_rub_more_in_one_direction() -> None:
    sticking, uneven = np.array([0.5, 0.2]), np.array([0.3, -0.1])
    rubbing = {"type": "stribeck_friction", "sticking": sticking.tolist(), "uneven": uneven.tolist()}
    found = run(rubbing=rubbing, arm={"type": "manipulator", "K": [2, 4], "viscous": [1, 0.5], "coulomb": [0.5, 0.2]})
    taken = np.array([2.0, 4.0]) * (found["servo.u"] - found["rubbing.u_left"])
    slow = np.exp(-((found["arm.dq"] / 0.05) ** 2))
    fast = np.abs(found["arm.dq"]) > 0.15
    assert fast.any(axis=0).all()
    np.testing.assert_allclose(taken[fast], np.broadcast_to(uneven, taken.shape)[fast], atol=1e-4)
    near = (np.abs(found["arm.dq"]) > 0.02) & ~fast  # phi is one at that velocity
    assert near.sum() > 5
    wanted = sticking * slow * np.sign(found["arm.dq"]) + uneven
    np.testing.assert_allclose(taken[near], wanted[near], atol=1e-3)
    assert np.max(np.abs(taken[near] - (wanted - 2 * uneven)[near])) > 0.1
    assert np.max(np.abs(taken[0])) < 1e-9  # at rest


def test_a_stop_pushes_back_as_in_hunt_and_crossley_and_only_warns_without_stiffness() -> None:
    stop = {"type": "joint_stops", "lower": [-1, -1], "upper": [0.9, 1.2]}
    soft = {**stop, "stiffness": [4000, 2000], "damping": [900, 400]}
    free, held = (graph(stops=each).run(engine="interpreted") for each in (stop, soft))
    for found in (free, held):
        q = found.recording["arm.q"]
        np.testing.assert_allclose(
            found.recording["stops.beyond"], np.maximum(q - [0.9, 1.2], 0) - np.maximum(-1 - q, 0), atol=1e-15
        )
        assert found.notices[-1].startswith("a joint is beyond its range, first at t = ")
    deep, dq = held.recording["stops.beyond"], held.recording["arm.dq"]
    push = np.array([4000, 2000]) * deep + np.array([900, 400]) * np.abs(deep) * dq
    np.testing.assert_allclose(held.recording["stops.u_stop"], held.recording["servo.u"] - push, atol=1e-9)
    assert np.max(np.abs(deep)) < 0.3 * np.max(np.abs(free.recording["stops.beyond"]))
    assert "stops.u_stop" not in free.recording.outputs


def test_a_joint_without_a_stated_range_has_none() -> None:
    block = find_block("joint_stops")()
    far = block.evaluate({"q": [900.0], "dq": [0.0], "u": [0.0], "K": [1.0]}, robot="pendulum")
    assert far.outputs["beyond"] == pytest.approx([900 - 6.3], abs=0.1)


def loaded(mass: float) -> Any:
    """arm2 in Pinocchio with a point mass at its tool."""
    chain = load_robot("arm2")
    model = chain.model.copy()
    tool = model.frames[chain.model_tool]
    model.appendBodyToJoint(tool.parentJoint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), tool.placement)
    return model, model.createData()


@pytest.mark.parametrize(("t", "mass"), [(0.9, 0.0), (1.0, 2.5), (1.9, 2.5), (2.1, 0.5)])
def test_a_load_moves_with_the_robot_as_in_pinocchio(t: float, mass: float) -> None:
    values = {"viscous": 0.0, "K": [2.0, 3.0], "maker_gravity": 0.4}
    block = find_block("loaded_manipulator")(payload=[2.5, 0.5], payload_at=["1 s", "2 s"], **values)
    q, dq, u = np.array([0.4, -0.9]), np.array([1.1, -0.7]), np.array([3.0, -1.0])
    found = block.evaluate({"u": u, "t": t}, {"q": q, "dq": dq}, robot="arm2").outputs
    model, data = loaded(mass)
    bare, own = loaded(0.0)
    kept = 0.4 * pin.computeGeneralizedGravity(bare, own, q)  # the manufacturer's model has no load
    ddq = pin.aba(model, data, q, dq, np.array([2.0, 3.0]) * u + kept)
    np.testing.assert_allclose(found["ddq"], ddq, rtol=1e-9)
    np.testing.assert_allclose(found["g"], pin.computeGeneralizedGravity(model, data, q) - kept, rtol=1e-9)
    assert found["load"] == mass
    if mass:
        wrong, numbers = loaded(1.1 * mass)
        assert not np.allclose(found["ddq"], pin.aba(wrong, numbers, q, dq, np.array([2.0, 3.0]) * u + kept), rtol=1e-3)


def test_without_a_load_it_is_the_manipulator() -> None:
    arm: Any = {**PLAIN["blocks"]["arm"]}  # type: ignore[index]
    never = run(arm={**arm, "type": "loaded_manipulator", "payload": [1.0], "payload_at": [9.0]})
    np.testing.assert_allclose(never["arm.q"], run()["arm.q"], atol=1e-12)


def test_a_twisting_joint_is_that_of_an_integration_by_scipy() -> None:
    data: Any = {**PLAIN, "duration": 0.2, "blocks": {**PLAIN["blocks"]}}  # type: ignore[dict-item]
    data["blocks"]["arm"] = {"type": "manipulator", "viscous": [1, 0.5]}
    data["blocks"]["gears"] = {"type": "elastic_joints", "stiffness": [3000, 900], "damping": [4, 2], "inertia": 0.2}
    data["wires"] = {"servo.q": "gears.theta", "servo.dq": "gears.dtheta"}
    found = dm.load(data, name="between").run(engine="interpreted").recording
    chain, n = load_robot("arm2"), 2
    model, numbers = chain.model, chain.model.createData()
    k, d, K_P, K_I = (np.array(pair) for pair in ([3000, 900], [4, 2], [60, 30], [240, 120]))

    def rate(_: float, y: Array, dq_c: Array) -> Array:
        q, dq, theta, dtheta, i = y.reshape(5, n)
        twist = k * (theta - q) + d * (dtheta - dq)
        ddq = pin.aba(model, numbers, q, dq, twist - np.array([1, 0.5]) * dq)
        u = -K_P * (dtheta - dq_c) - K_I * i
        return np.concatenate([dq, ddq, dtheta, (u - twist) / 0.2, dtheta - dq_c])

    q = np.array([0.7, 1.1])
    g = pin.computeGeneralizedGravity(model, numbers, q).copy()
    y = np.concatenate([q, 0 * q, q + g / k, 0 * q, -g / K_I])
    for row in range(50):
        np.testing.assert_allclose(found["arm.q"][row], y[:n], atol=2e-6)
        np.testing.assert_allclose(found["gears.theta"][row], y[2 * n : 3 * n], atol=2e-6)
        y = scipy.integrate.solve_ivp(rate, (0, T), y, args=(found["command.dq_c"][row],), rtol=1e-9, atol=1e-11).y[
            :, -1
        ]
    assert np.max(np.abs(found["gears.theta"] - found["arm.q"])) > 3e-3


EVERYTHING: Blocks = {
    "way": {"type": "transport_delay", "samples": 1, "late": 0.2, "lost": 0.05},
    "limits": {"type": "command_limits", "speed": 1.5},
    "ramp": {"type": "command_ramp", "acceleration": 20, "time_constant": 0.004},
    "friction": {"type": "friction_compensation", "coulomb": [0.2, 0.1]},
    "rubbing": {"type": "stribeck_friction", "sticking": [0.2, 0.1], "uneven": [0.1, -0.05]},
    "drive": {"type": "torque_limits", "torque": [40, 15]},
    "stops": {"type": "joint_stops", "lower": [-1, -1], "upper": [1.2, 1.5], "stiffness": 3000, "damping": 500},
    "arm": {"type": "loaded_manipulator", "viscous": [1, 0.5], "payload": [0.5], "payload_at": [0.3]},
    "encoder": {"type": "encoder", "step": STEP, "noise": 1e-5, "window": 0.008},
    "back": {"type": "measurement_delay", "samples": 1, "share": 0.5},
}


def test_both_engines_and_a_batch_agree_with_all_of_it() -> None:
    made = graph(**EVERYTHING)
    one, two = (made.run(engine=engine).recording for engine in ("interpreted", "compiled"))
    for label in ("arm.q", "encoder.dq_m", "way.dq_c_late", "drive.tau_excess", "stops.beyond"):
        np.testing.assert_allclose(one[label], two[label], atol=2e-6, err_msg=label)  # rounding may change a step
    values = {"servo.K_P": [[60, 30], [80, 40]]}
    swept = dm.sweep(made, values)
    single = [made.set({"servo.K_P": each}).run().error for each in values["servo.K_P"]]
    found = np.asarray(swept["rms_by_eighth"])
    for row, error in zip(found.reshape(2, -1), single, strict=True):
        assert error is not None
        np.testing.assert_allclose(row, error.rms_by_eighth, rtol=1e-4)


def test_it_is_not_proved_and_the_reason_is_reported() -> None:
    found = graph(way={"type": "transport_delay"}).verify().verdict
    assert (found.outcome, found.reason.split(";")[0]) == ("not_applicable", "way.dq_c_line is a sampled state")


def test_a_channel_that_only_warns_does_not_change_the_proof() -> None:
    plain = dm.load("pendulum")
    with_stops = plain.reality({"joint_stops": {}}).verify().verdict
    assert (with_stops.outcome, plain.verify().verdict.outcome) == ("proved", "proved")
    pushed = plain.reality({"joint_stops": {"stiffness": 1000}}).verify().verdict
    assert (pushed.outcome, "no certificate" in pushed.reason) == ("not_applicable", True)


@pytest.mark.parametrize(
    ("block", "text"),
    [
        ({"type": "encoder", "step": 0}, "x.step: expected a number > 0, found 0"),
        ({"type": "encoder", "step": 1, "window": 1, "time_constant": 1}, "expected a window or a time_constant"),
        ({"type": "transport_delay", "samples": 5}, "x.samples: expected 0, 1, 2, 3 or 4, found 5"),
        ({"type": "transport_delay", "share": 1.5}, "expected a share of at most 1, found 1.5; raise samples"),
        ({"type": "transport_delay", "share": 0.5, "late": 0.5}, "expected share or late, found both"),
        ({"type": "transport_delay", "late": 1.5}, "expected late to be a probability, at most 1, found 1.5"),
        ({"type": "transport_delay", "lost": -1}, "x.lost: expected a number >= 0, found -1"),
        ({"type": "measurement_delay", "share": 2}, "expected a share below 1, found 2; raise samples"),
        ({"type": "command_limits", "speed": -1}, "x.speed: expected a number > 0, found -1"),
        ({"type": "joint_stops", "lower": [0, 0]}, "expected both lower and upper, or neither, found one"),
        ({"type": "loaded_manipulator", "payload": [1], "payload_at": [1, 2]}, "expected as many masses as payload_at"),
        ({"type": "loaded_manipulator", "payload": [-1], "payload_at": [1]}, "expected masses of 0 or above, found"),
        ({"type": "loaded_manipulator", "payload": [1, 2], "payload_at": [2, 1]}, "expected increasing times, found"),
    ],
)
def test_wrong_parameters_are_refused_with_their_names(block: Mapping[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        graph(x=block)
    assert text in str(caught.value)


def test_a_controller_starts_at_what_comes_late() -> None:
    made = graph(encoder={"type": "encoder", "step": 0.01}, back={"type": "measurement_delay", "samples": 3})
    made = made.set({"blocks.command": {"type": "pi_inverse", "Lambda": 0.01, "Lambda_I": 1}})
    blocks: Any = {"model": {"type": "regressor"}, "dynamics": {"type": "dynamic_compensator", "Gamma": 1}}
    found = made.set({f"blocks.{name}": block for name, block in blocks.items()}).run(until=0.02)
    np.testing.assert_allclose(found.recording["command.q_r"][0], [0.7, 1.1], atol=1e-9)
    np.testing.assert_allclose(found.recording["back.q_late"][:4], [[0.7, 1.1]] * 4, atol=1e-9)
