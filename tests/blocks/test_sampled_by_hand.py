"""The hand-written sampled law, compared with another prototype's output, and with mechanics without regressors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from sampled_by_hand import Arm, Array, Circle, Kinematic, Known, Observer, Plant, SampledLaw, closed_loop

from dmframe.robot.library import find_robot

START, PATH, T = np.array([2.023732, -1.174227, 1.336627]), Circle((-0.45, 0.45, 0.5), 0.1, 0.5), 0.09
K_D, K_P, K_I = np.array([800.0, 800, 400]), np.array([1760.0, 1760, 880]), np.array([560.0, 560, 280])
STEP = 2 * np.pi / 2**17  # [rad] of the encoder


def ur10() -> Arm:
    hold = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
    return Arm.load(str(find_robot("ur10").urdf), "ee_link", hold, [5, 5, 2], [8, 8, 4])


def inertial(arm: Arm) -> Array:
    return np.concatenate([link.toDynamicParameters() for link in list(arm.model.inertias)[1:]])


def test_the_columns_are_those_of_the_inertia_matrix_of_coriolis_and_of_gravity() -> None:
    arm, q, v = ur10(), np.array([0.3, -1.0, 0.7]), np.array([0.4, 0.5, -0.7])
    M, C = pin.crba(arm.model, arm.data, q), pin.computeCoriolisMatrix(arm.model, arm.data, q, v)
    M = np.triu(M) + np.triu(M, 1).T
    np.testing.assert_allclose(arm.momentum(q, v) @ inertial(arm), M @ v, atol=1e-12)
    np.testing.assert_allclose(arm.slope_of_energy(q, v) @ inertial(arm), C.T @ v, atol=1e-12)
    assert np.max(np.abs(arm.slope_of_energy(q, v) @ inertial(arm) - C @ v)) > 0.01  # C is not its transpose
    np.testing.assert_allclose(arm.gravity(q) @ inertial(arm), arm.gravity_torque(q), atol=1e-12)


@dataclass
class Knowing(SampledLaw):
    """With the true parameters and without adaptation; records the equation errors."""

    wrong: list[Array] = field(default_factory=list)
    mutant: str = ""

    def learn(self, h: Array, g: Array, free: Array) -> None:
        self.wrong.append(g - np.sum(h * self.theta, axis=1))

    def begin(self, q: Array) -> None:
        super().begin(q)
        a, w = inertial(self.arm), 1 / K_D
        held = -self.arm.gravity_torque(q)
        columns = [K_P / K_D, K_I / K_D, w * held, np.outer(w, a), w * self.arm.B, w * self.arm.D]
        self.theta = np.column_stack(columns)

    def row(self, at: Known, u: Array, v: Array, before: Any) -> Array:
        psi = super().row(at, u, v, before)
        m = at.q + self.T * v / 2
        if self.mutant == "C'v":
            psi[:, 3:-2] += 2 * self.arm.slope_of_energy(m, v)
        elif self.mutant == "gravity":
            psi[:, 3:-2] -= self.arm.gravity(m)
        elif self.mutant == "momentum":
            psi[:, 3:-2] -= (self.arm.momentum(m, v) - self.arm.momentum(at.m, at.v)) / self.T
        elif self.mutant == "z":
            psi[:, 1] = 0
        elif self.mutant == "explicit e":
            psi[:, 0] += self.T * u / 2
        return psi


@pytest.mark.parametrize(
    ("mutant", "least", "most"),
    [("", 0, 5e-6), *((mutant, 1.5e-5, 1) for mutant in ("C'v", "gravity", "momentum", "z", "explicit e"))],
)
def test_the_servo_averaged_over_a_sample_is_linear_in_its_true_constants(
    mutant: str, least: float, most: float
) -> None:
    law = Knowing(ur10(), 0.02, tau=None, mutant=mutant)
    closed_loop(law, Plant(law.arm, START, K_D, K_P, K_I, step=2e-3), PATH, 60)
    assert least <= np.max(np.abs(law.wrong[20:])) < most  # [rad/s], without the fast transient at the start


def residuals(T: float) -> tuple[float, float]:
    """The largest residuals [rad/s] with true parameters: for the law, and with a centred difference of momentum.

    The circle at 2 rad/s, without Coulomb friction, whose mean over a sample is not considered here.
    """
    arm = ur10()
    arm.D = 0 * arm.D
    law, steps = Knowing(arm, T, tau=None), list[tuple[Known, Known]]()
    begin = law.after

    def after(at: Known, u: Array, q: Array) -> Known:
        steps.append((at, begin(at, u, q)))
        return steps[-1][1]

    law.after = after  # type: ignore[method-assign]
    closed_loop(law, Plant(arm, START, K_D, K_P, K_I, step=2.25e-3), Circle(PATH.center, PATH.radius, 2.0), int(4 / T))
    coded, centred = list[Array](), list[Array]()
    for (_, before), (at, now), (_, later) in zip(steps, steps[1:], steps[2:], strict=False):
        coded.append(now.y - np.sum(now.psi * law.theta, axis=1))
        change = arm.momentum(now.q, (now.v + later.v) / 2) - arm.momentum(at.q, (before.v + now.v) / 2)
        psi = now.psi.copy()
        psi[:, 3:-2] += (change - arm.momentum(now.m, now.v) + arm.momentum(before.m, before.v)) / T
        centred.append(now.y - np.sum(psi * law.theta, axis=1))
    start = len(coded) // 3
    return float(np.max(np.abs(coded[start:]))), float(np.max(np.abs(centred[start:])))


def test_the_residual_is_of_first_order_and_a_centred_momentum_change_is_not_better_on_a_slow_clock() -> None:
    found = {T: residuals(T) for T in (0.09, 0.045, 0.0225)}
    rounded = {T: tuple(round(1e6 * value) for value in values) for T, values in found.items()}
    assert rounded == {0.09: (331, 406), 0.045: (167, 189), 0.0225: (82, 74)}  # docs/explanation/sampled_law.md
    orders = [np.log2(found[T][0] / found[T / 2][0]) for T in (0.09, 0.045)]
    assert orders == pytest.approx([1, 1], abs=0.06)


@pytest.mark.parametrize(
    ("law", "keys", "quoted"),
    [(SampledLaw, {"tau": None}, 0.72), (Observer, {}, 0.29), (Kinematic, {}, 5.02)],
    ids=["sampled law", "observer", "kinematic"],
)
def test_the_first_seconds_are_those_of_a_prototype_written_separately(
    law: type[SampledLaw], keys: dict[str, Any], quoted: float
) -> None:
    arm = ur10()
    seen = closed_loop(law(arm, T, **keys), Plant(arm, START, K_D, K_P, K_I, step=2e-3), PATH, 139)
    assert 1e3 * np.sqrt(np.mean(np.sum(seen["error"] ** 2, axis=1))) == pytest.approx(quoted, abs=0.011)


@pytest.mark.parametrize(("tau", "least", "most"), [(2.0, 0, 0.6), (None, 1.2, 20)], ids=["filtered", "not"])
def test_only_the_filter_ignores_that_the_servo_began_at_another_target(
    tau: float | None, least: float, most: float
) -> None:
    law = SampledLaw(ur10(), T, tau=tau, delay=1)
    plant = Plant(law.arm, START, K_D, K_P, K_I, offset=0.01, step=2e-3)
    seen = closed_loop(law, plant, PATH, 250, STEP)
    assert least < 1e3 * np.max(np.linalg.norm(seen["error"][200:], axis=1)) < most
    assert not law.guarded
