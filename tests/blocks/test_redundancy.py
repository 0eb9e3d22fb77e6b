"""More joints than task coordinates: the self-motion of the generators, which does not move the tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block import Equations, Signals
from dmframe.catalogue import find_block
from dmframe.certify import verify
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, Solver, simulate

SERVOS = {
    "pi": (
        "{type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1, w_I_box: [0.2, 10]}",
        "{type: pi_servo, K_P: 60, K_I: 240}",
    ),
    "pid": (
        "{type: pid_inverse, K_c: 0.8, Lambda: 0.01, Lambda_P: 1, Lambda_I: 1, w_P: 2, w_I: 0.7,"
        " w_P_box: [1, 3], w_I_box: [0.5, 2]}",
        "{type: pid_servo, K_D: 80, K_P: 176, K_I: 56}",
    ),
}
GENERATORS = {
    "known": "  geometry: {type: kinematics}\n  task: {type: known_tracking, gamma: 1}\n",
    "observed": (
        "  geometry: {type: adaptive_kinematics, Gamma_k: 0.5, start_error: 0.02}\n"
        "  observer: {type: task_observer, beta: 2}\n  task: {type: observed_tracking, gamma: 2}\n"
    ),
}
POSTURE = "  posture: {type: null_space_posture, K_null: [0.5, 0.4, 0.3], q_0: [0.2, 0.5, 0.8]}\n"


def graph(folder: Path, generator: str = "known", servo: str = "pid", posture: str = POSTURE) -> Graph:
    inverse, law = SERVOS[servo]
    file = folder / "graph.yaml"
    file.write_text(
        "dmframe: 1\nrobot: arm3\nclock: continuous\nduration: 1\nstart: {near: [0.3, 0.7, 0.9]}\nblocks:\n"
        "  path: {type: circle, center: [0.4, 0.4], radius: 0.1, rate: 1}\n"
        f"{GENERATORS[generator]}{posture}  model: {{type: regressor, friction: [viscous]}}\n"
        f"  dynamics: {{type: dynamic_compensator, Gamma: 3}}\n  inverse: {inverse}\n  servo: {law}\n"
        "  arm: {type: manipulator, viscous: 1}\n",
        encoding="utf-8",
    )
    return Graph.read(file)


def reference(diagram: Diagram, state: np.ndarray) -> dict[str, np.ndarray]:
    """dq_r, J_hat and dq_null at a state and an instant, as computed by the controller."""
    loop = diagram.loop
    wanted = [signal for signal in loop.outputs if signal.name in ("dq_r", "J_hat", "dq_null")]
    expressions = loop.joined([loop.on_path(signal.expression) for signal in wanted])
    function = ca.Function("reference", [loop.state, loop.time, loop.p], expressions)
    return {
        signal.name: value.full() for signal, value in zip(wanted, function(state, 0.3, loop.p_values), strict=True)
    }


@pytest.mark.parametrize("generator", GENERATORS)
@pytest.mark.parametrize("servo", SERVOS)
def test_the_null_space_velocity_leaves_the_proof_as_it_is(generator: str, servo: str, tmp_path: Path) -> None:
    verdict = verify(graph(tmp_path, generator, servo).diagram, trials=1)
    assert verdict.outcome == "proved", verdict.reason
    assert any("joints stay bounded" in assumption.text for assumption in verdict.assumptions)


@pytest.mark.parametrize("generator", GENERATORS)
def test_the_reference_gains_the_null_space_velocity_without_what_the_tool_would_notice(
    generator: str, tmp_path: Path
) -> None:
    with_posture = graph(tmp_path, generator).diagram
    without = graph(tmp_path, generator, posture="").diagram
    rng = np.random.default_rng(4)
    state = rng.uniform(0.2, 0.9, with_posture.loop.state.numel())
    found, plain = reference(with_posture, state), reference(without, state)
    J, dq_null = found["J_hat"], found["dq_null"]
    free = found["dq_r"] - plain["dq_r"]
    np.testing.assert_allclose(free, (np.eye(3) - np.linalg.pinv(J) @ J) @ dq_null, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(J @ free, np.zeros((2, 1)), atol=1e-12)
    assert np.linalg.norm(free) > 1e-3


def test_a_generator_that_does_not_keep_it_out_of_the_task_is_refuted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind: Any = find_block("known_tracking")
    honest = kind.equations

    def leaking(self: Any, u: Any, x: Any, p: Any) -> Equations:
        reported = honest(self, u, x, p)
        return Equations(outputs={"dq_r": reported.outputs["dq_r"] + u.dq_null / 1000})

    monkeypatch.setattr(kind, "equations", leaking)
    verdict = verify(graph(tmp_path).diagram, trials=1)
    assert verdict.outcome == "refuted", verdict.reason


def test_the_derived_reference_acceleration_follows_the_self_motion(tmp_path: Path) -> None:
    loaded = graph(tmp_path)
    diagram = loaded.diagram
    run = simulate(diagram, 1.0, solver=Solver(step=2e-4, output=5e-3), start=loaded.start)
    loop = diagram.loop
    expression = diagram.resolver.derivative(diagram.resolver.output("inverse", "dq_ref"), "test")
    (joined,) = loop.joined([loop.on_path(expression)])
    function = ca.Function("ddq_ref", [loop.state, loop.time, loop.p], [stack([joined])])
    states = np.hstack([run.states[v.label] for v in loop.variables])
    dq_ref, times = run["inverse.dq_ref"], run.time
    for k in (40, 100, 160):
        slope = (dq_ref[k + 1] - dq_ref[k - 1]) / (times[k + 1] - times[k - 1])
        rate = function(states[k], times[k], loop.p_values).full().ravel()
        np.testing.assert_allclose(rate, slope, rtol=1e-3, atol=1e-3)


def turned(name: str, *, posture: bool) -> Recording:
    loaded = Graph.read(name)
    if not posture:
        blocks = {key: block for key, block in loaded.blocks.items() if key != "posture"}
        diagram = Diagram.build(blocks, {}, loaded.diagram.robot)
    else:
        diagram = loaded.diagram
    return simulate(diagram, 26.0, clock=loaded.file.clock, solver=loaded.solver, start=loaded.start)


def test_with_the_posture_a_turn_of_the_path_brings_the_joints_back_and_without_they_drift() -> None:
    turn = round(4 * np.pi / 0.008)
    drift = {}
    for posture in (True, False):
        run = turned("ur10_posture", posture=posture)
        assert run.divergence is None
        drift[posture] = float(np.max(np.abs(run["arm.q"][-1] - run["arm.q"][-1 - turn])))
        error = np.linalg.norm(run["arm.x"] - run["path.x_d"], axis=1)
        assert np.max(error) < 0.01
    assert drift[False] > 0.03
    assert drift[True] < 0.2 * drift[False]


def test_the_posture_pulls_each_joint_with_its_own_gain() -> None:
    block = find_block("null_space_posture")(K_null=[0.5, 2], q_0=[1, -1])
    u = Signals("posture", "inputs", {"q": ca.DM([1.5, 0])})
    p = Signals("posture", "parameters", {"K_null": ca.DM([0.5, 2]), "q_0": ca.DM([1, -1])})
    dq_null = block.equations(u, Signals("posture", "states", {}), p).outputs["dq_null"]
    np.testing.assert_allclose(dq_null.full().ravel(), [-0.25, -2])
