"""The regressor's columns, initial values and true values have one order: that of the parameter names."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from faulty import verdict_with

from dmframe.certify.true_values import true_values
from dmframe.graph.graph import Graph
from dmframe.robot.library import load

EVERYTHING = {"friction": ("coulomb", "viscous"), "gravity": "apart", "bias": True, "nominal": 0.5}


def regressor(**options):
    return type(Graph.read("arm2_joint").blocks["model"])(**options)


@pytest.fixture(scope="module")
def columns():
    """Each column of Y_d and each initial value by its name; with the motion."""
    robot, block = load("arm2"), regressor(**EVERYTHING)
    motion = dict(zip(("q", "dq", "dq_ref", "ddq_ref"), np.random.default_rng(2).uniform(-1, 1, (4, 2)), strict=True))
    outputs = block.evaluate(motion, robot=robot).outputs
    names = [element.name for element in block.elements(robot)["p"]]
    assert len(names) == outputs["Y_d"].shape[1]
    return (
        dict(zip(names, outputs["Y_d"].T, strict=True)),
        dict(zip(names, outputs["a_d_nominal"], strict=True)),
        motion,
    )


def test_friction_and_bias_have_a_column_a_joint(columns):
    Y_d, _, motion = columns
    for i, unit in enumerate(np.eye(2), start=1):
        np.testing.assert_allclose(Y_d[f"B_{i}"], motion["dq_ref"][i - 1] * unit)
        np.testing.assert_allclose(Y_d[f"D_{i}"], np.tanh(motion["dq_ref"][i - 1] / 0.005) * unit)
        np.testing.assert_allclose(Y_d[f"tau_bias{i}"], unit)


def test_masses_weigh_in_columns_of_their_own_where_gravity_is_separate(columns):
    Y_d, _, motion = columns
    together = regressor().evaluate(motion, robot="arm2").outputs["Y_d"]
    still = regressor().evaluate({**motion, **dict.fromkeys(("dq", "dq_ref", "ddq_ref"), np.zeros(2))}, robot="arm2")
    for place, name in enumerate(f"{stem}{i}" for i in (1, 2) for stem in ("m_", "mc_x", "mc_y", "mc_z")):
        mark = name.replace("_", "_g")
        column = 10 * (place // 4) + place % 4
        np.testing.assert_allclose(Y_d[mark], still.outputs["Y_d"][:, column], atol=1e-12)
        np.testing.assert_allclose(Y_d[name] + Y_d[mark], together[:, column], atol=1e-12)


def test_the_start_is_the_share_of_what_the_model_states(columns):
    Y_d, start, _ = columns
    body = load("arm2").model.inertias[2]
    assert start["m_2"] == start["m_g2"] == pytest.approx(0.5 * body.mass)
    assert start["mc_x2"] == start["mc_gx2"] == pytest.approx(0.5 * body.mass * body.lever[0])
    assert [start[f"{name}_{i}"] for name in "BD" for i in (1, 2)] == [0, 0, 0, 0]
    held = -0.5 * sum(start[name] / 0.5 * column for name, column in Y_d.items() if "_g" in name)
    np.testing.assert_allclose([start["tau_bias1"], start["tau_bias2"]], held, atol=1e-12)


def test_the_truth_is_what_the_plant_has():
    overrides = ["model.friction=[coulomb, viscous]", "arm.coulomb=[3, 4]", "arm.viscous=[1, 2]"]
    diagram = Graph.read("arm2_joint", overrides).diagram
    names = [element.name for element in diagram.blocks["model"].elements(diagram.robot)["p"]]
    known = dict(zip(names, true_values(diagram)["dynamics.a_d_hat"], strict=True))
    assert [known[name] for name in ("B_1", "B_2", "D_1", "D_2")] == [1, 2, 3, 4]
    assert known["m_2"] == diagram.robot.model.inertias[2].mass


@pytest.mark.parametrize("swapped", [(0, 1), (3, 9), (20, 21), (19, 22)])
def test_a_proof_refutes_two_swapped_columns(swapped):
    """Joints' friction, two links' parameters, inertia and friction: a_d, its estimate and Y_d must agree."""

    def horzcat(*parts):
        whole = ca.horzcat(*parts)
        order = list(range(whole.shape[1]))
        one, other = swapped
        order[one], order[other] = order[other], order[one]
        return whole[:, order] if whole.shape[1] > 20 else whole

    graph = Graph.read("arm2_joint", ["model.friction=[viscous, coulomb]"])
    fault = SimpleNamespace(**{**vars(ca), "horzcat": horzcat})
    assert verdict_with(graph, "model").outcome == "proved"
    assert verdict_with(graph, "model", ca=fault).outcome == "refuted"
