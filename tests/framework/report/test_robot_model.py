from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest

from dmframe.report.planar import robot_model
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot


def value(latex, numbers, q, rates):
    """Value of a printed sum: each symbol replaced by its number, then plain arithmetic."""
    text = latex.removeprefix("= ")

    def wave(found):
        angle = sum(q[int(digit) - 1] for digit in found[2])
        return f"({float((np.sin if found[1] == 's' else np.cos)(angle))!r})"

    text = re.sub(r"\\ddot q_\{\\mathrm r(\d)\}", lambda f: f"({rates['ddq_ref'][int(f[1]) - 1]!r})", text)
    text = re.sub(r"\\dot q_\{\\mathrm r(\d)\}", lambda f: f"({rates['dq_ref'][int(f[1]) - 1]!r})", text)
    text = re.sub(r"\\dot q_\{(\d)\}", lambda f: f"({rates['dq'][int(f[1]) - 1]!r})", text)
    text = re.sub(r"\b([sc])_\{(\d+)\}", wave, text)
    text = re.sub(r"(mc|[mpgI])_\{(\w+)\}", lambda f: f"({numbers[f[1] + f[2]]!r})", text.replace(r"\mathrm{mc}", "mc"))
    text = re.sub(r"\^\{(\d)\}", r"**\1", text)
    return eval(re.sub(r"(?<=[\d.)])\s+(?=[\d(.])", " * ", text))


def numbers_of(chain):
    names = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    found = {"g0": 9.81}
    for i, (row, joint) in enumerate(zip(chain.inertia, chain.joints, strict=True), start=1):
        found |= {f"{name}{i}": float(x) for name, x in zip(names, row, strict=True)}
        found |= {f"p{axis}{i}": float(x) for axis, x in zip("xyz", joint.translation, strict=True)}
    return found


@pytest.mark.parametrize("name", ["arm2", "arm3", "pendulum"])
def test_what_is_printed_of_a_planar_arm_is_what_is_simulated(name):
    chain = load(name)
    n, model, robot = chain.n, robot_model(chain), SymbolicRobot(chain)
    rng = np.random.default_rng(1)
    q = rng.uniform(-2, 2, n)
    rates = {label: [float(x) for x in rng.normal(size=n)] for label in ("dq", "dq_ref", "ddq_ref")}
    numbers = numbers_of(chain)
    symbols, values = zip(*((c.symbol, [float(x) for x in c.values]) for c in robot.constants), strict=True)
    dq = ca.SX(rates["dq"])
    exact = ca.Function("f", list(symbols), [robot.mass_matrix(q), robot.coriolis(q, dq), robot.gravity_torque(q)])
    M, C, g = (np.array(x) for x in exact(*values))
    expected = {f"g_{{{i + 1}}}": g[i, 0] for i in range(n)}
    expected |= {f"C_{{{i + 1}{j + 1}}}": C[i, j] for i in range(n) for j in range(n)}
    expected |= {f"M_{{{i + 1}{j + 1}}}": M[i, j] for i in range(n) for j in range(n)}
    if n == 1:
        expected = {label[0]: number for label, number in expected.items()}
    for row in model.rows:
        label = row.left.split(" = ")[0]
        assert value(row.right, numbers, q, rates) == pytest.approx(expected[label], abs=1e-12), label
    assert {label for row in model.rows for label in row.left.split(" = ")} == set(expected)


def test_the_printed_regressor_times_the_parameters_is_the_torque():
    chain = load("arm2")
    robot, model = SymbolicRobot(chain), robot_model(chain)
    rng = np.random.default_rng(2)
    q = rng.uniform(-2, 2, 2)
    rates = {label: [float(x) for x in rng.normal(size=2)] for label in ("dq", "dq_ref", "ddq_ref")}
    numbers = numbers_of(chain)
    symbols, values = zip(*((c.symbol, [float(x) for x in c.values]) for c in robot.constants), strict=True)
    torque = robot.inverse_dynamics(q, *(ca.SX(rates[label]) for label in ("dq", "dq_ref", "ddq_ref")))
    expected = ca.Function("f", list(symbols), [torque])(*values).full().ravel()
    total = np.zeros(2)
    for name, column in model.regressor:
        parameter = value(name, numbers, q, rates)
        total += [parameter * value(entry, numbers, q, rates) for entry in column]
    np.testing.assert_allclose(total, expected, rtol=1e-12)


@pytest.mark.parametrize("chain", [None, "ur10", "panda"])
def test_larger_robots_are_not_written_out(chain):
    assert robot_model(None if chain is None else load(chain)) is None
