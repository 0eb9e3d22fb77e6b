"""Tools that need no further package simulate the same loop."""

from __future__ import annotations

import json
import math
from importlib import import_module
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from tests.benchmarks import chains
from tests.benchmarks.closed_loop import SIX_JOINTS
from tests.benchmarks.controller import Controller
from tests.benchmarks.loop import Loop
from tests.benchmarks.peers import PEERS, find
from tests.benchmarks.scalars import Robot

GRAPHS = ("ur10_fast", "ur10_full")


@pytest.mark.parametrize("graph", GRAPHS)
def test_numpy_on_pinocchio_simulates_the_same_loop_as_ours(graph: str) -> None:
    loop = Loop.read(graph)
    ours = find("ours_interpreted")(loop, 1e-3).run(0.4)
    theirs = find("numpy_pinocchio")(loop, 1e-3).run(0.4)
    assert ours.shape == (51, loop.n)
    assert np.ptp(ours, axis=0)[:3].min() > 1e-3
    np.testing.assert_allclose(theirs, ours, atol=1e-10)


def test_a_second_run_of_a_peer_starts_where_the_first_did() -> None:
    peer = find("numpy_pinocchio")(Loop.read("ur10_fast"), 1e-3)
    np.testing.assert_array_equal(peer.run(0.1), peer.run(0.1))


def test_the_regressor_in_two_calls_is_that_in_five() -> None:
    loop, rng = Loop.read("ur10_full"), np.random.default_rng(0)
    q, dq, z, dz = rng.normal(size=(4, loop.n))
    data, none = loop.model.createData(), np.zeros(loop.n)

    def Y(v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.array(pin.computeJointTorqueRegressor(loop.model, data, q, v, a))

    five = Y(none, dz) + (Y(dq + z, none) - Y(dq, none) - Y(z, none) + Y(none, none)) / 2
    np.testing.assert_allclose(Controller(loop).regressor(q, dq, z, dz), five, atol=1e-10)


@pytest.mark.parametrize("graph", GRAPHS)
def test_the_reference_is_differentiated_along_the_motion(graph: str) -> None:
    loop = Loop.read(graph)
    law, q, h = Controller(loop), loop.start["q"] + 0.1, 1e-6
    dq = np.linspace(-0.3, 0.4, loop.n)
    before, after = (law.reference(0.7 + s, q + s * dq, dq)[0] for s in (-h, h))
    np.testing.assert_allclose(law.reference(0.7, q, dq)[1], (after - before) / (2 * h), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("graph", GRAPHS)
def test_the_scalar_equations_are_pinocchios(graph: str) -> None:
    loop, rng = Loop.read(graph), np.random.default_rng(1)
    robot, data = Robot(loop, math.sin, math.cos), loop.model.createData()
    q, dq, torque = rng.normal(size=(3, loop.n))
    ddq = robot.acceleration(q.tolist(), dq.tolist(), torque.tolist())
    np.testing.assert_allclose(ddq, pin.aba(loop.model, data, q, dq, torque), rtol=1e-8)
    x, columns = robot.kinematics(q.tolist())
    J = pin.computeFrameJacobian(loop.model, data, q, loop.tool, pin.LOCAL_WORLD_ALIGNED)[:3]
    pin.framesForwardKinematics(loop.model, data, q)
    np.testing.assert_allclose(x, data.oMf[loop.tool].translation, atol=1e-12)
    np.testing.assert_allclose(np.transpose(columns), J, atol=1e-12)


def test_the_scalar_torques_are_the_regressors() -> None:
    loop, rng = Loop.read("ur10_full"), np.random.default_rng(2)
    robot = Robot(loop, math.sin, math.cos)
    q, dq, z, dz = rng.normal(size=(4, loop.n))
    a = rng.normal(size=(loop.n, 10))
    tau = robot.torque(robot.rotations(q.tolist()), *(v.tolist() for v in (dq, z, dz)), a.tolist())
    np.testing.assert_allclose(tau, Controller(loop).regressor(q, dq, z, dz) @ a.ravel(), atol=1e-9)


def test_a_generated_chain_has_its_joints_and_builds_a_loop(tmp_path: Path) -> None:
    from dmframe.graph.graph import Graph

    (tmp_path / "chain.urdf").write_text(chains.urdf(4), encoding="utf-8")
    (tmp_path / "chain.yaml").write_text(chains.graph(4), encoding="utf-8")
    diagram = Graph.read(tmp_path / "chain.yaml").diagram
    assert diagram.robot.n == 4
    assert diagram.loop.state.numel() == 11 * 4 + 5 * 4 + 4 * 4
    assert ca.depends_on(diagram.loop.joined([diagram.loop.plant[-1].own_rate])[0], diagram.loop.state)


@pytest.mark.parametrize("key", PEERS)
def test_every_peer_describes_itself_without_being_installed(key: str) -> None:
    peer = find(key)
    assert peer.title
    assert peer.missing() == "" or peer.missing().startswith("missing: ")
    assert import_module(f"tests.benchmarks.peers.{key}").__doc__


def test_the_parts_with_six_joints_name_peers_that_there_are() -> None:
    assert set(SIX_JOINTS) <= set(PEERS)
    assert json.loads(json.dumps(PEERS)) == list(PEERS)
