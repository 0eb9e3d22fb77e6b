"""The robot as a whole, in simulated time: a controller that drives it, and all causes of a stop."""

from __future__ import annotations

import time

import numpy as np
import pytest
from virtual_robots import FOLLOW, Client, graph, robot, runs

from dmframe.common.errors import ValueFault
from dmframe.runtime import Controller
from dmframe.virtual import VirtualRobot

INPUTS = ["input_int_register_24", *(f"input_double_register_{24 + k}" for k in range(6))]
OUTPUTS = ["timestamp", "actual_q", "actual_qd", "target_q", "output_int_register_24"]
FORM = "d6d6d6di"
PLACES = [0, 1, 2]


def driven(held: VirtualRobot, ticks: int) -> tuple[np.ndarray, list[int]]:
    """The graph's controller over RTDE; joint positions, and the age in samples of the answered commands."""
    own = graph("ur10_fast")
    assert own.clock == held.dt
    controller = Controller(own.diagram, held.dt, start=own.start)
    client = Client(held)
    client.begin(OUTPUTS, INPUTS)
    held.load_script(FOLLOW)
    rows, ages, first = list[np.ndarray](), list[int](), None
    chain = held.arm.chain
    for beat in range(1, ticks + 1):
        held.advance()
        samples = client.samples(FORM)
        if not samples:
            continue
        sample = samples[-1]
        first = sample[0] if first is None else first
        q, dq, q_c = (np.array(sample[k : k + 6])[PLACES] for k in (1, 7, 13))
        rows.append(q)
        ages.append(beat - sample[19])
        controller.measured["arm.q"][:], controller.measured["arm.dq"][:] = q, dq
        controller.measured["servo.q_c"][:] = q_c
        controller.measured["arm.x"][:] = held.arm.pose(np.array(sample[1:7]))[:3] * [-1, -1, 1]
        assert controller.step(sample[0] - first)
        client.write("i6d", beat, *controller.commanded["inverse.dq_c"], 0.0, 0.0, 0.0)
    assert chain.n == 3
    return np.array(rows), ages


def test_a_controller_over_rtde_does_what_it_does_in_a_simulation() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    found, ages = driven(robot(series="cb3"), 250)
    # the only differences are the acceleration of speedj, 40 rad/s^2, and the arm's sag in the first cycle
    assert np.max(np.abs(found - run["arm.q"][: len(found)])) < 2e-5
    assert set(ages[1:]) == {1}  # the answer to one sample is echoed in the next


def test_delays_add_up_in_what_the_client_reads() -> None:
    _, ages = driven(robot(series="cb3", command_delay=1, measurement_delay=2), 60)
    assert set(ages[10:]) == {4}


def test_one_sample_of_delay_would_be_noticed() -> None:
    run = graph("ur10_fast").run(2.0, progress=False).recording
    found, _ = driven(robot(series="cb3", command_delay=1), 250)
    assert np.max(np.abs(found - run["arm.q"][: len(found)])) > 1e-3


def moving(held: VirtualRobot, speed: float = 0.3) -> Client:
    """A robot that a client moves, at speed."""
    client = Client(held)
    client.begin(OUTPUTS, INPUTS)
    held.load_script(FOLLOW)
    for beat in range(1, 101):
        client.write("i6d", beat, speed, 0, 0, 0, 0, 0)
        held.advance()
    assert held.dq[0] == pytest.approx(speed, abs=0.05)
    return client


def at_rest_after(held: VirtualRobot) -> float:
    """Time until the first joint rests, up to a hundredth of its speed [s]."""
    begun = held.time
    while abs(held.dq[0]) > 3e-3 or not held.target.still:
        held.advance()
        assert held.time < begun + 1
    return held.time - begun


def test_a_silent_client_stops_the_arm() -> None:
    held = robot()
    moving(held)
    assert at_rest_after(held) < 0.1
    assert any("the client is silent" in text for text in held.messages)
    assert not held.running


def test_the_emergency_stop_and_the_way_back() -> None:
    held = robot()
    moving(held)
    held.emergency_stop()
    assert at_rest_after(held) < 0.1
    assert (held.safety.mode, held.safety.robot_mode, held.running) == (7, 3, False)
    assert held.safety.reason == "emergency stop: the button is pressed"
    held.load_script(FOLLOW)
    assert not held.running
    assert not held.unlock()
    assert held.release_emergency_stop()
    held.load_script(FOLLOW)
    assert not held.running  # the power is off
    assert not held.safety.power(7)
    assert held.safety.power(5)
    assert held.safety.power(7)
    held.load_script(FOLLOW)
    assert held.running


STOPPING = {
    "shoulder_pan_joint: commanded speed 2.168 rad/s": "speedj([2.5, 0, 0, 0, 0, 0], 4, 1)",
    "wrist_1_joint is commanded to move, but the graph holds it": "speedj([0, 0, 0, 0.1, 0, 0], 4, 1)",
    "a target speed is not a number": "speedj([read_input_float_register(24), 0, 0, 0, 0, 0], 4, 1)",
    "requested by the script": "protective_stop()",
    "shoulder_pan_joint: commanded speed 5 rad/s": "servoj([1.465411, -1.016031, 0.978316, 0, -1.5707963267948966, 0], "
    "0, 0, 0.002, 0)",
}


@pytest.mark.parametrize("text", STOPPING)
def test_a_limit_stops_the_robot_and_the_reason_is_named(text: str) -> None:
    held = robot()
    held.registers.values["input_double_register_24"] = float("nan")
    held.load_script(f'def p():\n {STOPPING[text]}\n textmsg("sleeps")\n sleep(5)\nend\n')
    while held.running:
        held.advance()
    assert held.safety.reason.startswith(f"protective stop: {text}")
    assert held.safety.mode == 3
    assert np.isfinite(held.q).all()
    assert not any("sleeps" in text for text in held.messages)
    at_rest_after(held)
    assert held.unlock()
    assert runs(held, "def p():\n speedj([0.1, 0, 0, 0, 0, 0], 4, 0.1)\nend\n").safety.ready


def test_a_joint_limit_stops_the_robot_before_it_is_far_beyond() -> None:
    held = robot()
    held.load_script("def p():\n speedj([0, 0, 2.0, 0, 0, 0], 10, 5)\nend\n")
    while held.running:
        held.advance()
    assert held.safety.reason == "protective stop: elbow_joint: commanded angle 3.144 rad is outside its limits"
    at_rest_after(held)
    assert held.q[2] < np.pi + 2.0**2 / (2 * 20) + 0.1
    assert held.unlock()
    runs(held, "def p():\n speedj([0, 0, -0.5, 0, 0, 0], 10, 1)\nend\n")  # the way back is free
    assert held.safety.ready
    assert held.q[2] < np.pi


def test_a_slider_at_zero_holds_the_robot() -> None:
    held = robot(slider=0)
    client = Client(held)
    client.begin(["speed_scaling", "target_speed_fraction"], ["speed_slider_mask", "speed_slider_fraction"])
    held.load_script("def p():\n speedj([0.2, 0, 0, 0, 0, 0], 4, 1)\nend\n")
    held.advance(20)
    assert held.target.still
    client.write("Id", 1, 0.25)
    held.advance(100)
    assert held.target.qd[0] == 0.05
    assert client.samples("dd")[-1] == (1.0, 0.25)


def test_lost_samples_are_not_sent_and_follow_from_the_seed() -> None:
    def times(seed: int, lost: float) -> list[float]:
        held = robot(lost=lost, seed=seed)
        client = Client(held)
        client.begin(["timestamp"])
        held.advance(200)
        return [sample[0] for sample in client.samples("d")]

    found = times(1, 0.2)
    assert len(times(1, 0)) == 200
    assert found == times(1, 0.2) != times(2, 0.2)
    assert 120 < len(found) < 190


def test_the_next_samples_can_be_lost_on_purpose() -> None:
    held = robot()
    client = Client(held)
    client.begin(["timestamp"])
    held.advance(2)
    held.lose(3)
    held.advance(5)
    assert [round(sample[0] / held.dt) for sample in client.samples("d")] == [1, 2, 6, 7]


def test_a_watchdog_ends_the_program() -> None:
    held = robot()
    client = Client(held)
    client.begin(["timestamp"], ["input_int_register_24"])
    script = """def p():
  rtde_set_watchdog("input_int_register_24", 50, "stop")
  speedj([0.1, 0, 0, 0, 0, 0], 1, 9)
end
"""
    held.load_script(script)
    for beat in range(50):
        client.write("i", beat)
        held.advance()
    assert held.running
    held.advance(10)
    assert held.running
    held.advance(2)
    assert not held.running
    assert "watchdog: input_int_register_24 was not written for 10 cycles" in held.messages[-1]


@pytest.mark.parametrize(
    "wrong", [{"series": "x"}, {"slider": 2}, {"lost": -0.1}, {"command_delay": -1}, {"measurement_delay": 1.5}]
)
def test_numbers_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueFault, match=f"{next(iter(wrong))}: expected"):
        robot(**wrong)


def test_where_the_machine_is_late_the_robot_waits_and_hurries_never(monkeypatch: pytest.MonkeyPatch) -> None:
    held, now, begun = robot(), [0.0], list[float]()

    def sleep(seconds: float) -> None:
        now[0] += seconds

    def wanted() -> bool:
        begun.append(now[0])
        if len(begun) == 5:
            now[0] += 0.1  # this machine sleeps
        return len(begun) <= 10

    with monkeypatch.context() as patch:
        patch.setattr(time, "monotonic", lambda: now[0])
        patch.setattr(time, "sleep", sleep)
        held.serve(wanted)
    assert held.late == 1
    assert held.cycles == 10
    steps = np.diff(begun)
    assert np.delete(steps, 4) == pytest.approx(held.dt)
    assert steps[4] == pytest.approx(0.1)


def test_in_real_time_it_runs_in_a_thread_next_to_its_program() -> None:
    with robot(series="cb3") as held:
        with held.in_background():
            while held.cycles < 3:
                pass
        assert held.cycles >= 3
        ended = held.cycles
        held.advance()
        assert held.cycles == ended + 1
