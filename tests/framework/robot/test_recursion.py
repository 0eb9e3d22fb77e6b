"""Inverse dynamics repeated by CasADi, compared with the recursion in Python, operation by operation, and Pinocchio."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from dmframe.block.steady import same_expression
from dmframe.robot import recursion
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot


@pytest.fixture(autouse=True)
def _nothing_stated() -> None:
    recursion.forget()


def arguments(n: int) -> dict[str, tuple[Any, ...]]:
    q, dq, dq_ref, ddq_ref = (ca.SX.sym(name, n) for name in ("q", "dq", "dq_ref", "ddq_ref"))
    zero, half = ca.SX(n, 1), ca.vertcat(*[ddq_ref[0], *[0.0] * (n - 1)])
    return {
        "all": (q, dq, dq_ref, ddq_ref),
        "plain": (q, dq, dq, ddq_ref),
        "gravity": (q, zero, zero, zero),
        "mass": (q, zero, zero, ddq_ref),
        "expressions": (2 * q, dq + q, ca.sin(dq_ref), dq - ddq_ref),
        "constants": (q, dq, ca.SX(np.arange(1.0, n + 1)), ddq_ref),
        "some constants": (q, dq, dq_ref, half),
    }


@pytest.mark.parametrize("name", ["arm2", "ur5", "panda"])
@pytest.mark.parametrize("share", [1, 0, ca.SX.sym("share")])
def test_the_expressions_are_those_of_the_recursion(name: str, share: Any) -> None:
    chain = load(name)
    for _ in range(2):  # stated, and repeated for another robot's symbols
        robot = SymbolicRobot(chain)
        for what, (q, dq, dq_ref, ddq_ref) in arguments(robot.n).items():
            found = robot.inverse_dynamics(q, dq, dq_ref, ddq_ref, gravity_share=share)
            plain = dq_ref is dq
            expected = robot._torque(plain, q, dq, ddq_ref, robot.inertia, ca.SX(share), dq_ref)
            assert same_expression(found, expected), what
    assert len(recursion._TRACED) == len(arguments(2)) - 2  # expressions have the zeros of all; some constants, none


def test_other_zeros_and_constants_are_stated_again() -> None:
    robot, n = SymbolicRobot(load("arm2")), 2
    q, dq, zero = ca.SX.sym("q", n), ca.SX.sym("dq", n), ca.SX(n, 1)
    still = robot.inverse_dynamics(q, dq, zero, zero)
    for value in (1.0, 2.0):
        moved = robot.inverse_dynamics(q, dq, zero, ca.SX([value, 0]))
        assert not same_expression(moved, still)
        assert same_expression(moved, robot._torque(False, q, dq, ca.SX([value, 0]), robot.inertia, ca.SX(1), zero))


@pytest.mark.parametrize(("one", "other"), [("ur5", "ur10"), ("ur10", "panda")])
def test_robots_after_each_other_have_their_own_numbers(one: str, other: str) -> None:
    rng = np.random.default_rng(3)
    for name in (one, other, one):
        chain = load(name)
        robot = SymbolicRobot(chain)
        q, dq, ddq = (ca.SX.sym(label, robot.n) for label in ("q", "dq", "ddq"))
        values = [value.ravel() for value in robot.values().values()]
        torque = ca.Function(
            "torque", [q, dq, ddq, *(item.symbol for item in robot.constants)], [robot.inverse_dynamics(q, dq, dq, ddq)]
        )
        at = [rng.uniform(-1, 1, robot.n) for _ in range(3)]
        expected = pin.rnea(chain.model, chain.model.createData(), *at)
        np.testing.assert_allclose(torque(*at, *values).full().ravel(), expected, rtol=1e-9, atol=1e-9)


def test_few_functions_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recursion, "_MOST", 3)
    robot, q = SymbolicRobot(load("arm2")), ca.SX.sym("q", 2)
    for k in range(8):
        robot.inverse_dynamics(q, q, q, ca.SX([float(k), 1.0]))
    assert 1 <= len(recursion._TRACED) <= 3


def test_robots_with_free_axes_are_not_repeated() -> None:
    robot = SymbolicRobot(load("arm2"))
    free, axes, _ = robot.with_free_axes()
    q = ca.SX.sym("q", 2)
    robot.inverse_dynamics(q, q, q, q)
    assert ca.depends_on(free.inverse_dynamics(q, q, q, q), axes)
