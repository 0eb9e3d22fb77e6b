"""Each certificate in floating point: dV/dt along the closed loop compared with the blocks' claims at random points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block.certificate import Certificate
from dmframe.diagram import Diagram
from dmframe.diagram.view import view
from dmframe.graph.graph import Graph

ROBOTS = {
    "arm2": ("robot: arm2", "{center: [0.5, 0.3], radius: 0.1}", 2),
    "ur10": (
        "robot: {model: ur10, free: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint], tool: ee_link}",
        "{center: [-0.1, 0.6, 0.5], radius: 0.1}",
        3,
    ),
}
SERVOS = {
    "pi": (
        "{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w: 0.02, w_I: 2}",
        "{type: pi_servo, K_P: 60, K_I: 240}",
        ["inverse.w", "inverse.w_I"],
    ),
    "pid": (
        "{type: pid_inverse, K_c: 0.8, Lambda: 0.01, Lambda_P: 10, Lambda_I: 10, w: 0.01, w_P: 2, w_I: 0.5}",
        "{type: pid_servo, K_D: 80, K_P: 176, K_I: 56}",
        ["inverse.w", "inverse.w_P", "inverse.w_I"],
    ),
    "p_pi": (
        "{type: p_pi_inverse, K_c: 0.8, Lambda_f: 0.1, Lambda: 0.01, Lambda_r: 1, Lambda_c: 2, Lambda_z: 3, w: 0.01,"
        " w_r: 20, w_c: 19, w_z: 30}",
        "{type: p_pi_servo, k_p: 20, K_v: 80, K_i: 800, feed_forward: 0.7}",
        ["inverse.w_f", "inverse.w", "inverse.w_r", "inverse.w_c", "inverse.w_z"],
    ),
}
KAPPA = 0.37
COMBINATIONS = [(robot, task, servo) for robot in ROBOTS for task in ("task", "joint") for servo in SERVOS]


def build(robot: str, task: str, servo: str, folder: Path) -> Diagram:
    model, circle, n = ROBOTS[robot]
    inverse, law, _ = SERVOS[servo]
    if task == "task":
        source = "{type: circle, rate: 1, " + circle[1:]
        generator = "  geometry: {type: kinematics}\n  task: {type: known_tracking, gamma: 0.8}\n"
    else:
        source = f"{{type: sinusoid, center: {[0.4] * n}, amplitude: 0.3, rate: 1.1}}"
        generator = "  task: {type: joint_tracking, alpha_bar: 1.7}\n"
    file = folder / "graph.yaml"
    file.write_text(
        f"dmframe: 1\n{model}\nclock: continuous\nduration: 1\nblocks:\n  path: {source}\n{generator}"
        "  model: {type: regressor, friction: [viscous, coulomb]}\n  dynamics: {type: dynamic_compensator, Gamma: 3}\n"
        f"  inverse: {inverse}\n  servo: {law}\n  arm: {{type: manipulator, viscous: 1.5, coulomb: 2, K: 1.3}}\n"
    )
    return Graph.read(file).diagram


def certificates(diagram: Diagram) -> dict[str, Certificate]:
    """The certificates of all blocks; the true values of one are passed to the others."""
    found, known = dict[str, Certificate](), dict[str, Any]()
    for name in sorted(diagram.blocks, key=lambda name: name not in ("arm", "model")):
        seen = view(diagram, name, known)
        reported = diagram.blocks[name].composed_certificate(seen.u, seen.x, seen.p, seen.truth)
        if reported is not None:
            found[name] = reported
            known[name] = reported.truth
    return found


def residual(diagram: Diagram, flipped: str = "", kappa: float = KAPPA) -> tuple[np.ndarray, np.ndarray]:
    """dV/dt + dissipation - cross terms, and the size of its terms, at random states, gains and trajectories."""
    loop = diagram.loop
    V, claimed, supplied = ca.SX(0), ca.SX(0), ca.SX(0)
    for reported in certificates(diagram).values():
        weight = kappa if reported.consumes is None else 1
        V += weight * sum((term.value for term in reported.storage), ca.SX(0)) / 2
        claimed += weight * sum((term.value for term in reported.dissipation), ca.SX(0))
        if reported.consumes is not None:
            supplied = reported.consumes.value
            claimed -= supplied
    rates = [v.own_rate * (-1 if v.label == flipped else 1) for v in loop.variables]
    V, claimed, supplied, *rates = loop.joined([V, claimed, supplied, *rates])
    rate = ca.vertcat(*(ca.vec(item) for item in rates))
    leaves = diagram.resolver.trajectories
    now = [leaf.symbol for key, leaf in leaves.items() if (*key[:2], key[2] + 1) in leaves]
    ahead = [leaves[(*key[:2], key[2] + 1)].symbol for key in leaves if (*key[:2], key[2] + 1) in leaves]
    dV = ca.jtimes(V, loop.state, rate) + ca.jtimes(V, ca.vertcat(*now), ca.vertcat(*ahead))
    w = ca.vertcat(*(leaf.symbol for leaf in loop.trajectories))
    function = ca.Function("residual", [loop.state, w, loop.p], [dV, claimed, supplied])
    rng = np.random.default_rng(5)
    rows = []
    for _ in range(6):
        parts = [
            leaf.value.ravel(order="F")
            * (1 if leaf.label.startswith("robot.") else rng.uniform(0.5, 2, leaf.value.size))
            for leaf in loop.parameters
        ]
        state = rng.uniform(-1, 1, loop.state.numel())
        point = function(state, rng.uniform(-0.7, 0.7, w.numel()), np.concatenate(parts))
        rows.append([float(value) for value in point])
    values = np.array(rows)
    return values[:, 0] + values[:, 1], np.abs(values).sum(axis=1)


@pytest.mark.parametrize(("robot", "task", "servo"), COMBINATIONS)
def test_v_falls_by_exactly_what_the_blocks_state(robot: str, task: str, servo: str, tmp_path: Path) -> None:
    diagram = build(robot, task, servo, tmp_path)
    for kappa in (KAPPA, 2.9):
        left, size = residual(diagram, kappa=kappa)
        assert np.all(size > 1e-3)
        assert np.max(np.abs(left) / size) < 1e-9


@pytest.mark.parametrize(("robot", "task", "servo"), COMBINATIONS)
def test_an_adaptation_law_of_the_wrong_sign_breaks_the_balance(
    robot: str, task: str, servo: str, tmp_path: Path
) -> None:
    diagram = build(robot, task, servo, tmp_path)
    for label in ("dynamics.a_d_hat", *SERVOS[servo][2]):
        left, size = residual(diagram, flipped=label)
        assert np.max(np.abs(left) / size) > 1e-6, label


@pytest.mark.parametrize("servo", SERVOS)
def test_the_supplies_of_the_servo_level_cancel(servo: str, tmp_path: Path) -> None:
    diagram = build("arm2", "task", servo, tmp_path)
    reported = certificates(diagram)
    total = sum((item.supply for item in reported.values() if item.consumes is None), ca.SX(0))
    size = sum((ca.fabs(item.supply) for item in reported.values()), ca.SX(0))
    total, size = diagram.loop.joined([total, size])
    w = ca.vertcat(*(leaf.symbol for leaf in diagram.loop.trajectories))
    function = ca.Function("supply", [diagram.loop.state, w, diagram.loop.p], [total, size])
    rng = np.random.default_rng(3)
    for _ in range(5):
        point = rng.uniform(-1, 1, diagram.loop.state.numel()), rng.uniform(-1, 1, w.numel()), diagram.loop.p_values
        left, scale = (float(value) for value in function(*point))
        assert abs(left) < 1e-10 * scale
