"""A reference that keeps joints within limits: its bounds, and the tube of its proof, compared with runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dmframe as dm
from dmframe.block.certificate import Barrier, Certificate
from dmframe.catalogue import block_types
from dmframe.certify import claim_of
from dmframe.certify.barriers import Tube, tubes
from dmframe.certify.checked import Numbers
from dmframe.certify.symbols import symbols_of
from dmframe.diagram import Diagram
from dmframe.robot.library import load

LOWER, UPPER, SPEED, RATE, WIDTH, MARGIN = -1.0, 2.0, 1.5, 3.0, 0.05, 0.1
reals = st.floats(-50, 50)


def limited(q: float, wish: float) -> float:
    options = {"lower": LOWER, "upper": UPPER, "speed": SPEED, "approach": RATE, "rounding": WIDTH, "margin": MARGIN}
    block = block_types()["safe_reference"](**options)
    found = block.evaluate({"q": [q, 0.0], "dq_wish": [wish, 0.0]}, robot="arm2")
    return float(np.asarray(found.outputs["dq_r"])[0])


@settings(max_examples=40, deadline=None)
@given(st.floats(LOWER, UPPER), reals)
def test_the_reference_is_within_its_bounds_for_any_desired_motion(q: float, wish: float) -> None:
    room = [UPPER - MARGIN - q, q - LOWER - MARGIN]
    found, rounding = limited(q, wish), 1e-9
    assert -min(SPEED, RATE * room[1]) - rounding <= found <= min(SPEED, RATE * room[0]) + rounding
    sharp = min(max(wish, -min(SPEED, RATE * room[1])), min(SPEED, RATE * room[0]))
    assert abs(found - sharp) <= 2 * WIDTH  # and close to the value for sharp bounds


def tube_of(graph: dm.Graph) -> Tube | None:
    experiment = graph
    diagram = experiment.diagram
    claim = claim_of(diagram)
    uncertain = experiment.intervals(diagram)
    numbers = Numbers(claim, uncertain)
    return next(tubes(claim, numbers, symbols_of(claim, uncertain), experiment.start), None)


def test_no_tube_is_found_in_a_loop_whose_position_moves_otherwise_than_the_proof_states() -> None:
    graph = joint_graph()
    diagram = graph.diagram
    claim = claim_of(diagram)
    found = [
        next(tubes(claim_of(other), Numbers(claim, {}), symbols_of(claim, {}), graph.start), None)
        for other in (diagram, with_plant_faster(diagram, 1.01))
    ]
    assert found[0] is not None
    assert found[1] is None


def with_plant_faster(diagram: Diagram, factor: float) -> Diagram:
    plant = tuple(replace(v, own_rate=v.own_rate * factor) for v in diagram.loop.plant)
    return replace(diagram, loop=replace(diagram.loop, plant=plant))


def joint_graph(**changes: Any) -> dm.Graph:
    """A planar arm whose path exceeds the limit of its first joint."""
    made: dict[str, Any] = {
        "dmframe": 1,
        "robot": "arm2",
        "clock": "continuous",
        "duration": "4 s",
        "start": {"q": [0.8, 0.5], "dq": [1.0, 0.0]},
        "blocks": {
            "path": {"type": "sinusoid", "center": [1.5, 0.5], "amplitude": [0, 0.2], "rate": [1, 1]},
            "task": {"type": "joint_tracking", "alpha_bar": 2},
            "safe": {"type": "safe_reference", "lower": -2, "upper": [1.2, 2], "speed": 2, "approach": 4, "margin": 0},
            "model": {"type": "regressor", "friction": ["viscous"], "nominal": 0.8},
            "dynamics": {"type": "dynamic_compensator", "Gamma": 10},
            "inverse": {
                "type": "pi_inverse",
                "Lambda": 0.1,
                "Lambda_I": 10,
                "w_I": 2,
            },
            "servo": {"type": "pi_servo", "K_P": [60, 30], "K_I": [240, 120]},
            "arm": {"type": "manipulator", "viscous": [1, 0.5]},
        },
        "wires": {"safe.dq_wish": "task.dq_r", "inverse.dq_r": "safe.dq_r"},
    }
    return dm.load(made, name="joint").set(changes)


def spent_by_hand(graph: dm.Graph) -> float:
    """V(0) of the planar arm, written in NumPy; M is Pinocchio's."""
    chain = load("arm2")
    q, dq = np.array([0.8, 0.5]), np.array([1.0, 0.0])
    block = block_types()["safe_reference"](lower=-2.0, upper=[1.2, 2.0], speed=2.0, approach=4.0)
    wish = np.array([0.0, 0.2]) - 2 * (q - np.array([1.5, 0.5]))
    s = dq - np.asarray(block.evaluate({"q": q, "dq_wish": wish}, robot="arm2").outputs["dq_r"])
    model = chain.model
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    inertia = np.concatenate([model.inertias[k].toDynamicParameters() for k in (1, 2)])
    a_d_err = np.concatenate([0.2 * inertia, [1.0, 0.5]])
    K_P, K_I = np.array([60.0, 30.0]), np.array([240.0, 120.0])
    i = -pin.computeGeneralizedGravity(model, model.createData(), q) / K_I  # initially the servo compensates gravity
    ratios = np.sum((1 / K_P) ** 2 * K_P / 0.1 + (2 - K_I / K_P) ** 2 * K_P / 10)
    return float(s @ M @ s + a_d_err @ a_d_err / 10 + i @ (K_I * i) + ratios) / 2


def test_the_tube_of_an_arm_on_its_way_to_a_limit_is_that_by_hand_and_holds() -> None:
    graph = joint_graph()
    tube = tube_of(graph)
    assert tube is not None
    assert tube.of == "arm.q"
    spent = spent_by_hand(graph)
    np.testing.assert_allclose(tube.spent, spent, rtol=1e-9)
    by_hand = np.sqrt(spent / (2 * 4 * np.array([61.0, 30.5])))
    np.testing.assert_allclose(tube.reach, by_hand, rtol=1e-6)
    np.testing.assert_allclose(tube.tube, tube.reach)  # inside at the start
    assert not tube.inside
    run = graph.run()
    passed = np.max(run.data["arm.q"].values, axis=0) - [1.2, 2.0]
    assert 0 < passed[0] <= tube.reach[0]  # it exceeds the limit by less than the tube
    room = 1.2 - run.data["arm.q"].values[:, 0]
    time = run.data["time"].values
    assert np.all(room >= np.exp(-4 * time) * room[0] - tube.reach[0])


def test_a_margin_of_as_much_keeps_the_limit() -> None:
    graph = joint_graph(**{"safe.margin": [0.4, 0.5]})
    tube = tube_of(graph)
    assert tube is not None
    assert tube.inside
    assert float(np.max(graph.run().data["arm.q"].values[:, 0])) < 1.2
    (reported,) = (item for item in graph.verify().verdict.statements if "stays between" in item.says)
    assert reported.signal == "arm.q"
    assert reported.says == "stays between -2, -2 and 1.2, 2 rad at all times"
    (reported,) = (item for item in joint_graph().verify().verdict.statements if "stays between" in item.says)
    assert reported.says.startswith("stays between -2, -2 and 1.2, 2 rad, but for at most 0.")


def test_intervals_widen_the_tube_to_hold_that_of_every_robot_in_them() -> None:
    graph = joint_graph()
    wide = tube_of(graph.set({"uncertain": {"servo.K_P": [[50, 25], [70, 35]]}}))
    assert wide is not None
    for K_P in ([50, 25], [70, 35], [65, 26]):
        one = tube_of(graph.set({"servo.K_P": K_P}))
        assert one is not None
        assert one.spent <= wide.spent
        assert np.all(one.reach <= wide.reach)


def test_where_v_may_rise_or_the_law_is_another_there_is_no_tube(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tube_of(joint_graph(**{"dynamics.leak": 0.1})) is None
    kind = block_types()["safe_reference"]
    honest = kind.certificate

    def lying(place: int, changed: Any) -> None:
        def stated(self: Any, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
            true = honest(self, u, x, p, truth)
            pieces = list(true.barriers[0].pieces)
            pieces[place] = changed(pieces[place], u)
            return Certificate(barriers=(Barrier(*pieces),), filters=true.filters)

        monkeypatch.setattr(kind, "certificate", stated)

    for place, changed in (
        (5, lambda rate, u: rate / 2),  # a rate that differs from that of the law
        (5, lambda rate, u: rate * (1 + u.q[0] ** 2)),  # a moving one
        (6, lambda width, u: -width),
        (4, lambda speed, u: 0 * speed),
        (3, lambda upper, u: upper - 0.1),
    ):
        lying(place, changed)
        assert tube_of(joint_graph()) is None


def test_without_the_filter_the_same_arm_goes_beyond_the_tube() -> None:
    graph = joint_graph(**{"blocks.safe": None, "wires": {}})
    assert float(np.max(graph.run().data["arm.q"].values[:, 0])) > 1.4


def test_on_a_robot_the_circle_stops_at_the_limit_and_the_whole_loop_is_stable() -> None:
    graph = dm.load("ur10_safe")
    found = graph.verify()
    assert found.proved
    assert found.verdict.states is not None
    assert not found.verdict.states.open  # q is bounded by its limits, and all other signals by q
    assert any(item.says.endswith("at all times") for item in found.conclusions)
    tube = tube_of(graph)
    assert tube is not None
    run = graph.run(until=15)
    q = run.data["arm.q"].values
    assert float(np.min(q[:, 0])) > 1.3
    error = np.linalg.norm(run.data["arm.x"].values - run.data["path.x_d"].values, axis=1)
    assert float(np.max(error)) > 0.05  # it left the path because of the limit


def test_a_run_warns_of_a_command_beyond_the_robots_velocity_limits() -> None:
    graph = dm.load("ur10_safe")
    assert not any("velocity limits" in notice for notice in graph.run(until=0.2).notices)
    far = graph.set({"blocks.safe": None, "wires": {}, "task.width": 100, "task.gamma": 20, "start.q": [-1, -1, 1]})
    notices = [notice for notice in far.run(until=0.2).notices if "velocity limits" in notice]
    assert len(notices) == 1
    assert notices[0].startswith("inverse.dq_c is beyond the robot's velocity limits, first at t = ")
    assert "shoulder_pan_joint" in notices[0]
