"""Each rule of the gate, with a fault that it blocks and a command that it passes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dmframe.runtime import gate as gates
from dmframe.runtime.gate import MOST_CUTS, Gate, Limits
from dmframe.runtime.robot import Sample

T = 0.008
LIMITS = Limits(
    ["a", "b"],
    np.array([-1.0, -2.0]),
    np.array([1.0, 2.0]),
    np.array([1.0, 2.0]),
    acceleration=np.array([10.0, 10.0]),
    deceleration=4.0,
    box=np.array([[0.0, 0.0], [1.0, 1.0]]),
)
GOOD = Sample(0.0, np.zeros(2), np.zeros(2), np.zeros(2), np.array([0.5, 0.5]))


def admitted(**changed: Any) -> str:
    return str(Gate(LIMITS, T).admit(replace(GOOD, **changed)) or "")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({}, ""),
        ({"ready": False}, "robot: it is not ready to move"),
        ({"fault": "protective stop"}, "robot: protective stop"),
        ({"q": np.array([np.nan, 0])}, "not finite: invalid sample: q = [nan, 0.0]"),
        ({"dq": np.array([0, np.inf])}, "not finite: invalid sample: dq"),
        ({"q_c": np.array([np.nan, 0])}, "not finite: invalid sample: q_c"),
        ({"x": np.array([np.nan, 0])}, "not finite: invalid sample: x"),
        ({"time": np.nan}, "not finite: invalid sample: time = nan s"),
        ({"scaling": -1.0}, "not finite: invalid sample: time = 0.0 s, speed scaling = -1.0"),
        ({"missed": 5}, ""),
        ({"missed": 6}, "lost samples: 6 in a row, at most 5 are allowed"),
        ({"q_c": np.array([0, 0.19])}, ""),
        ({"q_c": np.array([0, -0.21])}, "deviation: b is 210 mrad from its target, at most 200 mrad is allowed"),
        ({"q_c": None}, ""),
        ({"x": np.array([0.5, 1.01])}, "workspace: coordinate 2 of the tool is at 1.01 m, its box is 0 m to 1 m"),
        ({"x": None}, ""),
    ],
)
def test_a_sample_is_admitted_or_the_rule_is_named(fault: dict[str, Any], message: str) -> None:
    found = admitted(**fault)
    assert found.startswith(message)
    assert bool(found) == bool(message)


def test_of_several_faults_the_first_rule_is_reported() -> None:
    worst: dict[str, Any] = {
        "fault": "protective stop",
        "q": np.array([np.nan, 0]),
        "missed": 9,
        "q_c": np.ones(2),
        "x": np.array([2.0, 2.0]),
    }
    order = []
    for key in list(worst):
        order.append(admitted(**worst).partition(":")[0])
        del worst[key]
    assert order == ["robot", "not finite", "lost samples", "deviation", "workspace"]


def sent(command: Any, gate: Gate | None = None, limits: Limits = LIMITS) -> tuple[np.ndarray, str]:
    gate, out = gate or Gate(limits, T), np.full(2, np.nan)
    stop = gate.limited(np.array(command, dtype=float), out)
    return out, str(stop or "")


def free(**changed: Any) -> Limits:
    return replace(LIMITS, acceleration=None, **changed)


def test_a_command_within_all_limits_passes_bit_by_bit() -> None:
    gate = Gate(LIMITS, T)
    command = np.array([0.0123456789, -0.01])
    out, stop = sent(command, gate)
    assert (out.tobytes(), stop, dict(gate.cuts)) == (command.tobytes(), "", {})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_not_finite_stops(bad: float) -> None:
    out, stop = sent([0.1, bad])
    assert stop.startswith("command not finite: [0.1, ")
    assert np.isnan(out).all()  # no command was written that could be sent


def test_a_command_far_above_a_speed_limit_stops_and_one_above_is_scaled_in_its_direction() -> None:
    gate = Gate(free(), T)
    out, stop = sent([2.0, -1.0], gate)
    np.testing.assert_allclose(out, [1.0, -0.5])
    assert (stop, dict(gate.cuts)) == ("", {"speed": 1})
    _, stop = sent([3.01, 0.0])
    assert stop == "command too fast: a is commanded 3.01 rad/s, above 3 times its limit of 1 rad/s"


def test_commands_change_as_fast_as_the_acceleration_allows() -> None:
    gate = Gate(LIMITS, T)
    seen = [sent([0.2, -0.1], gate)[0].copy() for _ in range(3)]
    np.testing.assert_allclose(seen, [[0.08, -0.08], [0.16, -0.1], [0.2, -0.1]])
    assert gate.cuts == {"acceleration": 2}


def travel(gate: Gate, rng: np.random.Generator) -> np.ndarray:
    """Final state of a robot that executes the output of the gate, for a controller that pushes at the limits."""
    q, visited = np.zeros(2), list[np.ndarray]()
    out = np.zeros(2)
    for k in range(3000):
        if k % 200 == 0:
            push = rng.uniform(-3, 3, 2)
        gate.admit(replace(GOOD, q=q.copy(), q_c=q.copy()))
        gate.limited(push, out)
        q = q + T * out
        visited.append(q.copy())
    return np.array(visited)


@pytest.mark.parametrize("limits", [LIMITS, free(), replace(LIMITS, acceleration=np.array([1.0, 30.0]))])
def test_no_joint_passes_its_limits_whatever_the_controller_commands(limits: Limits) -> None:
    visited = travel(Gate(limits, T), np.random.default_rng(0))
    assert (visited >= limits.lower - 1e-9).all()
    assert (visited <= limits.upper + 1e-9).all()
    assert visited.max() > 1.5  # it came close


def test_without_the_rule_of_joint_limits_they_are_passed() -> None:
    wide = replace(LIMITS, lower=np.full(2, -np.inf), upper=np.full(2, np.inf))
    assert np.abs(travel(Gate(wide, T), np.random.default_rng(0))).max() > 2.5


def test_a_joint_beyond_its_limit_may_only_come_back() -> None:
    gate = Gate(free(), T)
    gate.admit(replace(GOOD, q=np.array([1.1, 0]), q_c=np.array([1.1, 0])))
    assert sent([0.5, 0.5], gate)[0].tolist() == [0.0, 0.5]
    assert sent([-0.5, 0.5], gate)[0].tolist() == [-0.5, 0.5]


def test_too_many_cuts_in_a_row_stop_and_one_that_passes_begins_again() -> None:
    gate = Gate(free(), T)
    for _ in range(MOST_CUTS - 1):
        assert sent([1.5, 0], gate)[1] == ""
    assert sent([0.5, 0], gate)[1] == ""
    stops = [sent([1.5, 0], gate)[1] for _ in range(MOST_CUTS)]
    assert stops[:-1] == [""] * (MOST_CUTS - 1)
    assert stops[-1] == f"cuts: {MOST_CUTS} commands in a row were limited, the last one by speed"


def test_the_gate_states_of_itself_that_it_is_not_a_safety_function() -> None:
    assert "not a safety function" in (gates.__doc__ or "")
