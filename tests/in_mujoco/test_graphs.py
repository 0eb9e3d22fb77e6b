"""Exported controllers of packaged graphs in MuJoCo: the error is that of `dmframe run`."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.robot.library import find_robot
from tests.in_mujoco.closed_loop import Settings, error, in_dmframe, in_mujoco, plant_of
from tests.in_mujoco.plant import mujoco, needs_mujoco

pytestmark = needs_mujoco

INVERSE, FAST = "ur10_slow_kinematic_inverse", "ur10_fast_kinematic"
WHOLE = {  # the RMS error over the last eighth of 200 s, of 100 s with the pose [mm]
    "ur10_fast_kinematic": 9.377,
    "ur10_fast": 6.287,
    "ur10_fast_tuned": 0.2541,
    "ur10_slow_kinematic": 5.370,
    "ur10_slow": 3.884,
    "ur10_slow_tuned": 1.615,
    "ur10_slow_kinematic_inverse": 1.018,
    "ur10_slow_sampled": 0.01711,
    "ur10_slow_supervised": 0.00525,
    "ur10_slow_best": 0.000669,
    "ur10_pose": 0.0820,
}
SHORT = {INVERSE: 9.0, FAST: 6.4}
"""Graphs with fast compilation, by seconds in which friction and gravity already determine the error."""


@pytest.mark.parametrize("name", WHOLE)
def test_the_whole_run_of_a_graph_has_the_same_error_in_mujoco(name: str) -> None:
    seconds = 100.0 if name == "ur10_pose" else 200.0
    run = in_dmframe(name, seconds)
    expected = error(run["arm.x"], run["path.x_d"])
    assert expected == pytest.approx(WHOLE[name], rel=0.01)
    assert error(in_mujoco(name, seconds).x, run["path.x_d"]) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", SHORT)
def test_its_first_seconds_are_the_same_motion(name: str) -> None:
    run, motion = in_dmframe(name, SHORT[name]), in_mujoco(name, SHORT[name])
    assert np.ptp(run["arm.q"], axis=0).min() > 0.05
    np.testing.assert_allclose(motion.q, run["arm.q"], atol=1e-9)
    assert error(motion.x, run["path.x_d"]) == pytest.approx(error(run["arm.x"], run["path.x_d"]), rel=1e-6)


FAULTS: dict[str, Settings] = {
    "Coulomb friction with the other sign": {"coulomb": np.array([-8.0, -8.0, -4.0])},
    "no Coulomb friction": {"coulomb": np.zeros(3)},
    "masses of 105 percent": {"mass_scale": {"upper_arm_link": 1.05, "forearm_link": 1.05, "wrist_1_link": 1.05}},
    "a wrist held elsewhere": {"hold": {"wrist_1_joint": 0.0, "wrist_2_joint": -1.5, "wrist_3_joint": 0.0}},
    "viscous friction of 120 percent": {"viscous": np.array([6.0, 6.0, 2.4])},
    "rotors": {"rotor": (3.0, 3.0, 1.5)},
}
SMALL = ("viscous friction of 120 percent", "rotors")
"""Faults that change the motion, and its RMS error by less than 1 %."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_plant_is_found(fault: str) -> None:
    run, motion = in_dmframe(FAST, SHORT[FAST]), in_mujoco(FAST, SHORT[FAST], **FAULTS[fault])
    expected = error(run["arm.x"], run["path.x_d"])
    assert np.abs(motion.q - run["arm.q"]).max() > 1e-4
    assert (error(motion.x, run["path.x_d"]) == pytest.approx(expected, rel=0.01)) is (fault in SMALL)


def test_the_arm_that_mujoco_reads_from_the_urdf_is_that_of_pinocchio() -> None:
    """Gravity, velocity and inertia terms, at random states of the arm with fixed wrists."""
    plant = plant_of(dm.load(FAST))
    model, full = plant.model(), pin.buildModelFromUrdf(str(find_robot("ur10").urdf))
    pose = pin.neutral(full)
    for joint, angle in plant.hold.items():
        pose[full.joints[full.getJointId(joint)].idx_q] = angle
    reduced = pin.buildReducedModel(full, [full.getJointId(joint) for joint in plant.hold], pose)
    data, rng = mujoco.MjData(model), np.random.default_rng(4)
    for _ in range(5):
        data.qpos[:], data.qvel[:], data.qacc[:] = rng.normal(size=(3, 3))
        mujoco.mj_inverse(model, data)
        tau = pin.rnea(reduced, reduced.createData(), data.qpos, data.qvel, data.qacc)
        np.testing.assert_allclose(data.qfrc_inverse, tau, atol=1e-9)
