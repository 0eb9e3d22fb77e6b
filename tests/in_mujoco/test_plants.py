"""Controllers of graphs with one plant, on plants of commercial robots: MuJoCo compared with `dmframe run`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from tests.in_mujoco.closed_loop import Settings, error, in_dmframe, in_mujoco
from tests.in_mujoco.plant import Load, needs_mujoco
from tests.in_mujoco.servos import Cascade, DigitalCascade

pytestmark = needs_mujoco

INVERSE, TUNED, SUPERVISED = "ur10_slow_kinematic_inverse", "ur10_fast_tuned", "ur10_slow_supervised"
K_D = np.array([800.0, 800.0, 400.0])
LOADED = 3.6  # [s], a sampling instant of both clocks


@dataclass(frozen=True)
class Case:
    """Settings of a graph, and those in MuJoCo if the graph's servo and friction do not define them."""

    settings: Settings
    changes: Settings = field(default_factory=dict)


def pid(factor: float) -> Settings:
    return {f"servo.{name}": list(factor * K_D * ratio) for name, ratio in (("K_D", 1), ("K_P", 2.2), ("K_I", 0.7))}


def cascade(feed_forward: float, **more: float) -> Case:
    """P around PI, stiffer than the packaged servo: K_P / K_D is 30/s there, and 2.2/s in it."""
    times = {"velocity_filter": 0.002, "torque_lag": 0.001}
    block = {"type": "p_pi_servo", "k_p": 20, "K_v": list(K_D), "K_i": list(10 * K_D), "feed_forward": feed_forward}
    servo = Cascade(np.full(3, 20.0), K_D, 10 * K_D, feed_forward, **times)
    return Case({"blocks.servo": block | times | more}, {"servo": servo})


PLANTS = {
    "servo of 0.3": Case(pid(0.3)),
    "servo of 3": Case(pid(3)),
    "twice the Coulomb friction": Case({"arm.coulomb": [16, 16, 8]}),
    "Stribeck friction and friction by load": Case(
        {"blocks.gears": {"type": "stribeck_friction", "sticking": 4, "velocity": 0.05, "per_torque": 0.05}},
        {"sticking": 4.0, "slow": 0.05, "per_torque": 0.05},
    ),
    "5 kg": Case(
        {"arm.type": "loaded_manipulator", "arm.payload": [5], "arm.payload_at": [LOADED]},
        {"loads": (Load(LOADED, 5.0),)},
    ),
    "rotors": Case({"arm.rotor": [3, 3, 1.5]}, {"rotor": (3.0, 3.0, 1.5)}),
    "stiff cascade": cascade(1.0),
    "stiff cascade with half of the feed-forward": cascade(0.5),
    "stiff cascade without feed-forward": cascade(0.0),
}
SECONDS = 7.2
"""The load acts in the last half of it; a sampling instant of both clocks."""


STEP = 5e-4
"""Of MuJoCo's RK4 [s]. `run` shortens its own steps for a stiff plant; 1 ms then changes the error by 3 %."""


@pytest.mark.parametrize("name", [INVERSE, TUNED, SUPERVISED])
@pytest.mark.parametrize("plant", PLANTS)
def test_a_controller_at_another_plant_has_the_error_of_a_run(plant: str, name: str) -> None:
    """The exported controller is that of the packaged graph: it contains no number of the plant."""
    case, packaged = PLANTS[plant], in_dmframe(name, SECONDS)["arm.q"]
    run = in_dmframe(name, SECONDS, case.settings)
    motion = in_mujoco(name, SECONDS, case.settings, step=STEP, **case.changes)
    expected = error(run["arm.x"], run["path.x_d"])
    assert np.abs(run["arm.q"] - packaged).max() > 1e-4
    assert error(motion.x, run["path.x_d"]) == pytest.approx(expected, rel=0.01)
    np.testing.assert_allclose(motion.q, run["arm.q"], atol=2e-5)


def in_cycles(name: str) -> Any:
    """A controller on the stiff cascade with its own clock of 1 kHz."""
    servo = DigitalCascade(np.full(3, 20.0), K_D, 10 * K_D, velocity_filter=0.002, torque_lag=0.001)
    return in_mujoco(name, SECONDS, servo=servo, step=STEP)


@pytest.mark.parametrize("name", [INVERSE, "ur10_fast_kinematic"])
def test_a_servo_that_samples_at_1_khz_has_the_error_of_a_run(name: str) -> None:
    run = in_dmframe(name, SECONDS, cascade(1.0, cycle=1e-3).settings)
    expected = error(run["arm.x"], run["path.x_d"])
    assert error(in_cycles(name).x, run["path.x_d"]) == pytest.approx(expected, rel=0.01)


def test_where_a_loop_amplifies_it_the_cycle_of_the_block_is_nearer_than_none() -> None:
    without, block = (
        in_dmframe(TUNED, SECONDS, case.settings)["arm.q"] for case in (cascade(1), cascade(1, cycle=1e-3))
    )
    q = in_cycles(TUNED).q
    assert 1e-6 < np.std(q - block) < 0.7 * np.std(q - without)
