"""Controllers whose graphs state one plant, at the plants of robots as they are sold: MuJoCo against `dmframe run`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.in_mujoco.closed_loop import Settings, error, in_dmframe, in_mujoco
from tests.in_mujoco.plant import Load, needs_mujoco
from tests.in_mujoco.servos import Cascade

pytestmark = needs_mujoco

INVERSE, TUNED, SUPERVISED = "ur10_slow_kinematic_inverse", "ur10_fast_tuned", "ur10_slow_supervised"
K_D = np.array([800.0, 800.0, 400.0])
LOADED = 7.2  # [s], a sampling instant of both clocks


@dataclass(frozen=True)
class Case:
    """Settings of a graph, and what they are in MuJoCo where the graph's servo and friction do not say it."""

    settings: Settings
    changes: Settings = field(default_factory=dict)


def pid(factor: float) -> Settings:
    return {f"servo.{name}": list(factor * K_D * ratio) for name, ratio in (("K_D", 1), ("K_P", 2.2), ("K_I", 0.7))}


PLANTS = {
    "servo of 0.3": Case(pid(0.3)),
    "servo of 3": Case(pid(3)),
    "twice the Coulomb friction": Case({"arm.coulomb": [16, 16, 8]}),
    "5 kg": Case(
        {"arm.type": "loaded_manipulator", "arm.payload": [5], "arm.payload_at": [LOADED]},
        {"loads": (Load(LOADED, 5.0),)},
    ),
    "rotors": Case(
        {"blocks.elastic": {"type": "elastic_joints", "stiffness": 4e6, "damping": 2e3, "inertia": [3, 3, 1.5]}},
        {"rotor": (3.0, 3.0, 1.5)},
    ),
    "stiff cascade": Case(
        {"servo.K_P": list(30 * K_D), "servo.K_I": list(200 * K_D)},  # K_v k_p + K_i, and K_i k_p
        {"servo": Cascade(np.full(3, 20.0), K_D, 10 * K_D)},
    ),
}
SECONDS = 14.4
"""The load is there for the last half of it; a sampling instant of both clocks."""


STEP = 5e-4
"""Of MuJoCo's RK4 [s]. `run` shortens its own where the plant is stiff; 1 ms is then too long, by 3 % in the error."""


@pytest.mark.parametrize("name", [INVERSE, TUNED, SUPERVISED])
@pytest.mark.parametrize("plant", PLANTS)
def test_a_controller_at_another_plant_has_the_error_of_a_run(plant: str, name: str) -> None:
    """The exported controller is that of the packaged graph: it has no number of the plant."""
    case, packaged = PLANTS[plant], in_dmframe(name, SECONDS)["arm.q"]
    run = in_dmframe(name, SECONDS, case.settings)
    motion = in_mujoco(name, SECONDS, case.settings, step=STEP, **case.changes)
    expected = error(run["arm.x"], run["path.x_d"])
    assert np.abs(run["arm.q"] - packaged).max() > 1e-4
    assert error(motion.x, run["path.x_d"]) == pytest.approx(expected, rel=0.01)
    np.testing.assert_allclose(motion.q, run["arm.q"], atol=2e-5)
