"""Sampling intervals over the box of a graph: below the limit of its robots, tied parameters, boxes without one."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.linalg import expm

import dmframe as dm
from dmframe.analysis.held import HeldLoop, held_loop, held_slopes
from dmframe.analysis.held_box import interval_over_box
from dmframe.analysis.held_proof import prove_clock
from dmframe.analysis.held_storage import find_storage
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.diagram import Diagram
from dmframe.exact.ball_matrix import middles
from dmframe.exact.balls import UndecidedError
from dmframe.exact.rational import Interval

SERVO = """
dmframe: 1
title: One joint with a vertical axis through a servo
robot: {model: ur10, free: [shoulder_pan_joint], tool: ee_link}
clock: 8 ms
duration: 10 s
start: {q: [0 deg]}
blocks:
  path:    {type: setpoint, q_d: [0.3]}
  task:    {type: joint_tracking, alpha_bar: 2}
  inverse: {type: kinematic_command}
  servo:   {type: pi_servo, K_P: 800, K_I: 1760}
  arm:     {type: manipulator, viscous: 5}
uncertain:
  servo.K_P: {factor: [0.8, 1.25]}
  servo.K_I/K_P: [1.76, 2.64]
  arm.viscous: [3, 8]
"""


class Law(AbstractBlock):
    """u = -3 y."""

    inputs = (Input("y"),)
    outputs = (Output("u", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"u": -3 * u.y})


class Lag(AbstractBlock):
    """dy/dt = v, dv/dt = (u - v) / tau: not affine in tau."""

    side = Side.PLANT
    inputs = (Input("u"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states: ClassVar[tuple[State, ...]] = (State("y"), State("v"))
    tau: Scalar = Real(default=0.2)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": x.v, "v": (u.u - x.v) / p.tau})


def unstable_from(loop: HeldLoop) -> float:
    """First unstable period of equal intervals."""
    A, E, K = (middles(matrix) for matrix in (loop.A, loop.E, loop.K))
    size = len(A)
    for period in np.geomspace(0.05, 5, 1500):
        held = np.zeros((len(K), size + len(K)))
        whole = expm(np.vstack([np.hstack([A - E @ K, E]), held]) * period)[:size]
        if np.max(np.abs(np.linalg.eigvals(whole[:, :size] + whole[:, size:] @ K))) >= 1:
            return float(period)
    return float("inf")


def over(graph: dm.Graph) -> float:
    given = graph.intervals()
    found = interval_over_box(held_slopes(graph.diagram, given), given)
    assert found is not None
    return found


def lag(low: str, high: str) -> dict[str, list[Interval]]:
    return {"lag.tau": [Interval(Fraction(low), Fraction(high))]}


def test_the_interval_is_below_that_of_every_robot_in_the_box() -> None:
    graph = dm.load(SERVO)
    interval = over(graph)
    for s, r, B in [*product((0.8, 1.25), (1.76, 2.64), (3.0, 8.0)), (1.0, 2.2, 5.0)]:
        member = graph.set({"servo.K_P": 800 * s, "servo.K_I": 800 * s * r, "arm.viscous": B, "uncertain": {}})
        assert interval < unstable_from(held_loop(member.diagram))
    assert interval < find_storage(held_loop(graph.diagram)).interval
    assert interval > 0.5


def test_a_wider_box_has_no_longer_interval() -> None:
    narrow = over(dm.load("pd_torque").set({"uncertain": {"arm.viscous": [4.9, 5.1]}}))
    wide = over(dm.load("pd_torque").set({"uncertain": {"arm.viscous": [0, 40]}}))
    assert wide < narrow < find_storage(held_loop(dm.load("pd_torque").diagram)).interval


def test_parameters_on_which_the_loop_is_not_affine_are_enclosed() -> None:
    diagram = Diagram.build({"law": Law(), "lag": Lag()})
    given = lag("0.19", "0.21")
    found = interval_over_box(held_slopes(diagram, given), given)
    assert found is not None
    for tau in (0.19, 0.2, 0.21):
        assert 0.1 < found < unstable_from(held_loop(Diagram.build({"law": Law(), "lag": Lag(tau=tau)})))


def test_a_box_with_an_unstable_robot_has_none() -> None:
    class Fast(AbstractBlock):
        """As the lag, with a third state: unstable for tau from 2/3 on."""

        side = Side.PLANT
        inputs = (Input("u"),)
        outputs = (Output("y", access=Access.MEASURED),)
        states: ClassVar[tuple[State, ...]] = (State("y"), State("v"), State("a"))
        tau: Scalar = Real(default=0.2)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            rates = {"y": x.v, "v": (x.a - x.v) * 2, "a": (u.u - x.a) / p.tau}
            return Equations(outputs={"y": x.y}, rates=rates)

    diagram = Diagram.build({"law": Law(), "lag": Fast()})
    assert find_storage(held_loop(diagram)).interval > 0
    given = lag("0.1", "3")
    with pytest.raises(UndecidedError, match=r"no sampling interval is proved for all robots|in continuous time"):
        interval_over_box(held_slopes(diagram, given), given)


def test_the_page_names_the_parameters() -> None:
    graph = dm.load(SERVO)
    found = prove_clock(graph.diagram, graph.clock, uncertain=graph.intervals())
    assert set(found.over) == {"servo.K_P", "servo.K_I/K_P", "arm.viscous"}
    assert found.interval == over(graph)
    alone = prove_clock(graph.diagram, graph.clock)
    assert alone.over == ()
    text = str(dm.load("pd_torque").set({"uncertain": {"arm.viscous": [2, 8]}}).verify(clock=True))
    assert "    for all robots in the intervals of arm.viscous" in text


def test_parameters_that_do_not_act_leave_the_own_interval() -> None:
    graph: Any = dm.load("pd_torque").set({"uncertain": {"arm.coulomb": {"factor": [1, 2]}}})
    found = prove_clock(graph.diagram, graph.clock, uncertain=graph.intervals())
    assert found.over == ()
    assert found.interval == find_storage(held_loop(graph.diagram)).interval
