"""Functions of a live page in addition to its run."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from in_node import content_of_graph

import dmframe as dm
from dmframe.codegen import wasm
from dmframe.common.errors import ValueFault
from dmframe.page.content import content_of
from dmframe.page.sliders import sliders_of
from dmframe.robot.frames import frames, tool
from dmframe.robot.symbolic import SymbolicRobot

pytest.importorskip("wasmtime", reason="wasmtime is not installed")

from page_checks import check_along_a_run, check_functions, functions


@pytest.fixture(scope="module")
def arm2():
    return dm.verify("arm2_joint")


@pytest.mark.parametrize("name", ["arm2_joint", "theorem_1"])
def test_error_and_v_of_a_page_are_those_of_a_run(name):
    check_along_a_run(dm.verify(name))


@pytest.mark.parametrize("fault", ["begin", "judged", "shown"])
def test_a_page_whose_functions_are_wrong_is_seen(arm2, monkeypatch, fault):
    right = functions(arm2)
    function = getattr(right, fault)
    given = [ca.SX.sym("x", function.numel_in(i)) for i in range(function.n_in())]
    wrong = ca.Function(fault, given, [function(*given) * 1.001])
    monkeypatch.setattr("page_checks.functions", lambda _: replace(right, **{fault: wrong}))
    check = check_along_a_run if fault == "shown" else check_functions
    with pytest.raises(AssertionError):
        check(arm2)


def test_rates_of_the_plant_at_another_state_are_seen(arm2, monkeypatch):
    right = wasm._flow
    monkeypatch.setattr(wasm, "_flow", lambda at, sizes: right(at, {**sizes, "Z": sizes["Z"] - 1}))
    with pytest.raises(AssertionError):
        check_functions(arm2)


@pytest.mark.parametrize("name", ["ur10", "panda", "arm2"])
def test_joints_and_tool_are_where_pinocchio_has_them(name):
    from dmframe.robot.library import load

    chain = load(name)
    robot = SymbolicRobot(chain)
    q = ca.SX.sym("q", chain.n)
    p = ca.vertcat(*(constant.symbol for constant in robot.constants))
    numbers = np.concatenate([robot.values()[constant.name] for constant in robot.constants])
    found = ca.Function("f", [q, p], [frames(robot, q), tool(robot, q)])
    at = np.random.default_rng(0).uniform(-1, 1, chain.n)
    placed, end = (each.full() for each in found(at, numbers))
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, at)
    for joint in range(chain.n):
        there = data.oMi[joint + 1]
        np.testing.assert_allclose(placed[:9, joint].reshape(3, 3, order="F"), there.rotation, atol=1e-9)
        np.testing.assert_allclose(placed[9:, joint], there.translation, atol=1e-9)
    np.testing.assert_allclose(end.ravel(), data.oMf[chain.model_tool].translation, atol=1e-9)


def test_margins_at_other_numbers_are_judged_as_verify_judges_them():
    graph = dm.load("pendulum")
    made, holding = functions(graph.verify()), list[bool]()
    for K_c in (graph.blocks["inverse"].K_c, 0.01):
        other = graph.set({"inverse.K_c": K_c})
        judged = made.judged(0.3, 0.01, other.diagram.loop.p_values).full().ravel()
        decided = {condition.name: condition.holds for condition in other.verify().conditions}
        for condition, place in zip(made.conditions, made.margins, strict=True):
            least = judged[place[0] : sum(place)].min() if place[1] else 0.0
            assert (least > 0 if condition.strict and place[1] else least >= 0) == decided[condition.name]
        holding.append(all(decided.values()))
    assert holding == [True, False]


def test_sliders_move_what_changes_alone(arm2):
    sliders = sliders_of(arm2.diagram, arm2.verdict)
    labels = [slider.label for slider in sliders]
    assert "dynamics.Gamma" in labels
    assert not any("box" in label for label in labels)
    parameters = {parameter.label: parameter for parameter in arm2.diagram.loop.parameters}
    for slider in sliders:
        assert slider.label.split("[")[0] in parameters
        assert slider.most > 0
        assert slider.group in ("controller", "hidden", "path")


def labels_of(graph):
    return [slider["label"] for slider in content_of_graph(graph)["sliders"]]


def test_a_number_on_which_nothing_depends_has_no_slider():
    still, rubbing = (dm.load("pendulum").set({"arm.coulomb": size}) for size in (0, 0.2))
    without, with_it = labels_of(still), labels_of(rubbing)
    assert "robot.friction_velocity" not in without
    assert "robot.friction_velocity" in with_it
    assert without == [label for label in with_it if label not in ("robot.friction_velocity", "arm.coulomb")]
    run = {value: still.set({"robot.friction_velocity": value}).run(until=0.2) for value in (0.01, 0.1)}
    np.testing.assert_array_equal(run[0.01]["arm.q"], run[0.1]["arm.q"])


def test_a_loop_with_chance_has_no_page(arm2):
    graph = dm.load("arm2_joint").set({"jitter": "0.1 ms"})
    with pytest.raises(ValueFault, match="page: expected a deterministic loop, found jitter"):
        content_of(graph, arm2.verdict)
