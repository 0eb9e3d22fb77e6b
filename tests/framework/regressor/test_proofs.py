"""Structural properties, proved for every packaged robot and for random chains; seeded faults are refuted."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dmframe.regressor.proofs import Proof, proof_page, prove
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot

ROBOTS = ("arm2", "arm3", "panda", "pendulum", "ur10", "ur3", "ur5", "xarm7", "z1")
NAMES = {
    "linear in a_d",
    "regressor",
    "composition",
    "M symmetric",
    "dM/dt - 2C skew",
    "Christoffel",
    "Jacobian",
    "kinematic regressor",
    "dJ/dt",
}


def failing(proofs: tuple[Proof, ...]) -> set[str]:
    return {proof.name for proof in proofs if not proof.holds}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_property_is_proved_for_every_packaged_robot(name: str) -> None:
    proofs = prove(load(name), trials=2)
    assert {proof.name for proof in proofs} == NAMES
    assert failing(proofs) == set()
    assert all(proof.test.log2_error_bound < -150 for proof in proofs)
    if name != "pendulum":  # C is zero for one joint
        assert all(proof.control for proof in proofs)


def urdf(kinds: list[str], seed: int) -> str:
    """A chain with rpy written in four decimals, so that no rotation is exactly orthogonal."""
    rng = np.random.default_rng(seed)

    def three(low: float, high: float) -> str:
        return " ".join(f"{x:.4f}" for x in rng.uniform(low, high, 3))

    parts = ['<robot name="random"><link name="l0"/>']
    for i, kind in enumerate(kinds, start=1):
        parts.append(
            f'<link name="l{i}"><inertial><origin xyz="{three(-0.2, 0.2)}" rpy="{three(-1, 1)}"/>'
            f'<mass value="{rng.uniform(1, 5):.3f}"/><inertia ixx="0.03" iyy="0.04" izz="0.05" ixy="0.001" ixz="0.002" '
            f'iyz="0.003"/></inertial></link><joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/>'
            f'<child link="l{i}"/><origin xyz="{three(-0.5, 0.5)}" rpy="{three(-1.6, 1.6)}"/>'
            f'<axis xyz="{three(0.1, 1)}"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>'
        )
    return "".join([*parts, "</robot>"])


@settings(max_examples=6, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.sampled_from(["revolute", "prismatic"]), min_size=1, max_size=6), st.integers(0, 2**31))
def test_every_property_is_proved_for_random_urdf_chains(kinds: list[str], seed: int) -> None:
    chain = SerialChain.from_model(pin.buildModelFromXML(urdf(kinds, seed)), name="random")
    assert failing(prove(chain, trials=1)) == set()


def test_rotations_as_the_file_rounds_them_are_refuted() -> None:
    robot = load("xarm7")
    placements = list(robot.model.jointPlacements)[1:]
    joints = tuple(
        replace(joint, rotation=tuple(tuple(Fraction(float(x)) for x in row) for row in placement.rotation))
        for joint, placement in zip(robot.joints, placements, strict=True)
    )
    assert {"dM/dt - 2C skew", "M symmetric"} & failing(prove(replace(robot, joints=joints), trials=1))
    assert failing(prove(robot, trials=1)) == set()


class Faulty:
    """A symbolic robot with one wrong quantity."""

    def __init__(self, robot: SymbolicRobot, **wrong: Any) -> None:
        self._robot, self._wrong = robot, wrong

    def __getattr__(self, name: str) -> Any:
        if name in self._wrong:
            return lambda *arguments: self._wrong[name](self._robot, *arguments)
        return getattr(self._robot, name)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"coriolis": lambda r, *a: r.coriolis(*a) * 1.001}, {"composition", "dM/dt - 2C skew"}),
        ({"coriolis": lambda r, *a: r.coriolis(*a).T}, {"composition", "Christoffel"}),  # s'C's equals s'C s
        ({"mass_matrix": lambda r, *a: 2 * r.mass_matrix(*a)}, {"composition", "M symmetric", "dM/dt - 2C skew"}),
        ({"gravity_torque": lambda r, *a: -r.gravity_torque(*a)}, {"composition"}),
        ({"regressor": lambda r, *a: r.regressor(a[0], a[1], a[1], a[3])}, {"regressor"}),
        ({"regressor": lambda r, *a: r.regressor(a[0], a[2], a[1], a[3])}, set()),  # it is symmetric in dq and dq_ref
        ({"jacobian": lambda r, *a: -r.jacobian(*a)}, {"Jacobian", "kinematic regressor"}),
        ({"kinematic_regressor": lambda r, q, psi: r.kinematic_regressor(psi, q)}, {"kinematic regressor"}),
    ],
)
def test_a_fault_in_one_quantity_is_refuted_where_it_is(wrong: dict[str, Any], expected: set[str]) -> None:
    chain = load("arm3")
    robot: Any = Faulty(SymbolicRobot(chain), **wrong)
    assert failing(prove(chain, trials=1, robot=robot)) == expected


def test_the_page_states_what_is_proved_and_refuted() -> None:
    chain = load("pendulum")
    good = proof_page(chain, prove(chain, trials=1))
    assert good.startswith("pendulum, 1 joints: for all poses")
    assert "s'(dM/dt - 2 C(q, dq)) s = 0" in good
    assert "an injected fault has no effect" in good
    robot: Any = Faulty(SymbolicRobot(chain), gravity_torque=lambda r, *a: 2 * r.gravity_torque(*a))
    assert "REFUTED" in proof_page(chain, prove(chain, trials=1, robot=robot))
