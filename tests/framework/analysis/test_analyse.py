"""Poles, margins, passivity and periods, compared with hand calculations, SciPy and runs."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, final
from xml.etree import ElementTree

import numpy as np
import pytest
import scipy

from dmframe.analysis import (
    Linear,
    bode_svg,
    equilibrium,
    frozen,
    linearise,
    linearised_period,
    nyquist_svg,
    servo_transfer,
    simulated_period,
    tick_jacobian,
)
from dmframe.analysis.servo import left_out
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Diagonal, Positive
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.certify.true_values import true_values
from dmframe.common.errors import EngineError, MissingError, ShapeError, ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Solver, simulate
from dmframe_blocks.joint_tracking import JointTracking
from dmframe_blocks.kinematic_command import KinematicCommand
from dmframe_blocks.pi_servo import PiServo
from dmframe_blocks.setpoint import Setpoint

K_P, K_I, J, ALPHA = 6.0, 40.0, 0.5, 7.0


@final
class Flywheel(AbstractBlock):
    """A pure inertia, J ddq = u."""

    side = Side.PLANT
    inputs = (Input("u", "n", "V"),)
    outputs = (
        Output("q", "n", "rad", Access.MEASURED),
        Output("dq", "n", "rad/s", Access.MEASURED, derivative_of="q"),
        Output("ddq", "n", "rad/s^2", derivative_of="dq"),
        Output("g", "n", "N m"),
        Output("K", "n", "N m/V"),
    )
    states = (State("q", "n", "rad"), State("dq", "n", "rad/s"))

    J: Diagonal = Positive("n", "kg m^2")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        outputs = {"q": x.q, "dq": x.dq, "ddq": u.u / p.J, "g": 0 * x.q, "K": 0 * x.q + 1}
        return Equations(outputs=outputs, rates={"q": x.dq, "dq": u.u / p.J})


@cache
def flywheel() -> Diagram:
    blocks: dict[str, AbstractBlock] = {
        "path": Setpoint(q_d=(0.3,)),
        "task": JointTracking(alpha_bar=ALPHA),
        "inverse": KinematicCommand(),
        "servo": PiServo(K_P=K_P, K_I=K_I),
        "arm": Flywheel(J=J),
    }
    return Diagram.build(blocks)


@cache
def packaged(name: str, *overrides: str) -> tuple[Diagram, Any]:
    graph = Graph.read(name, overrides)
    return graph.diagram, graph


def held_loop(period: float) -> np.ndarray:
    """The sampled flywheel by SciPy: states q, dq, i; dq_c = -alpha q held."""
    A = np.array([[0, 1, 0], [0, -K_P / J, -K_I / J], [0, 1, 0]])
    B = np.array([[0], [K_P / J], [-1]])
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, np.eye(3), np.zeros((3, 1))), period, method="zoh")
    return np.asarray(Ad - ALPHA * Bd @ np.array([[1, 0, 0]]))


def radius(period: float) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(held_loop(period)))))


def test_a_pi_servo_on_a_pure_inertia_has_the_textbooks_poles_and_margins() -> None:
    (joint,) = servo_transfer(flywheel())
    assert np.allclose(joint.servo.num, [K_P, K_I])
    assert np.allclose(joint.servo.den, [1, 0])
    assert (joint.inertia, joint.viscous) == pytest.approx((J, 0))
    expected = np.roots([J, K_P, K_I])
    assert np.allclose(np.sort_complex(joint.tracking.poles), np.sort_complex(expected))
    # |L| = 1: (K_P w)^2 + K_I^2 = J^2 w^4; the phase there is -180 deg + atan(K_P w / K_I)
    crossover = np.sqrt((K_P**2 + np.sqrt(K_P**4 + 4 * J**2 * K_I**2)) / 2) / J
    assert joint.margins.gain_crossover == pytest.approx(crossover, rel=1e-6)
    assert joint.margins.phase == pytest.approx(np.degrees(np.arctan(K_P * crossover / K_I)), rel=1e-6)
    assert joint.margins.gain == np.inf
    assert joint.passive_servo.holds
    assert joint.port is None


def test_a_double_real_pole_is_reported_as_one_and_a_pair_as_a_pair() -> None:
    def loop(A: list[list[float]]) -> Linear:
        none = np.zeros((2, 0))
        whole = np.array(A)
        return Linear(("a[0]", "a[1]"), (), (), np.zeros(2), 0, 0.0, whole, none, lambda _: none, none, whole, none)

    split = loop([[-0.1, 0.3], [-(0.2**2) / 0.3 * 1.00000000000001, -0.5]])  # (s + 0.3)^2 up to the last digits
    assert np.any(split.poles.imag)
    assert split.pole(0) == split.pole(-1) == pytest.approx(-0.3)
    assert split.pole(0).imag == 0  # type: ignore[union-attr]
    pair = loop([[-1.0, 2.0], [-2.0, -1.0]]).pole(0)
    assert pair is not None
    assert (pair.real, abs(pair.imag)) == pytest.approx((-1, 2))
    assert loop([[0.0, 0.0], [0.0, 0.0]]).pole(0) is None


def test_the_closed_loops_poles_are_the_characteristic_polynomials_roots() -> None:
    linear = linearise(flywheel())
    # J s^2 q = -(K_P + K_I/s)(s + alpha) q
    expected = np.roots([J, K_P, K_P * ALPHA + K_I, K_I * ALPHA])
    assert np.allclose(np.sort_complex(linear.poles), np.sort_complex(expected))
    assert linear.at_rest == 1  # q_c is integrated and has no effect
    assert linear.drift < 1e-12


def test_the_trajectory_acts_through_the_servo_as_by_hand() -> None:
    linear = linearise(flywheel())
    assert linear.trajectories == ("path.q_d[0]",)  # constant: dq_d is zero
    row = linear.B[linear.states.index("arm.dq[0]")]
    assert np.allclose(row, [K_P * ALPHA / J])  # of dq_c = -alpha (q - q_d)
    assert np.allclose(linear.B[linear.states.index("servo.i[0]")], [-ALPHA])
    assert np.allclose(linear.B[linear.states.index("arm.q[0]")], 0)


@pytest.mark.parametrize("name", ["arm2_joint", "pendulum"])
def test_the_inverse_at_its_true_values_is_the_servos_inverse(name: str) -> None:
    omega = np.logspace(-2, 3, 12)
    for joint in servo_transfer(packaged(name)[0]):
        assert joint.inverse is not None
        assert np.allclose(joint.inverse.at(1j * omega) * joint.servo.at(1j * omega), 1)


@pytest.mark.parametrize("period", [0.001, 0.02, 0.3])
def test_the_sampled_poles_are_scipys_zero_order_hold(period: float) -> None:
    found = linearise(flywheel()).sampled_poles(period)
    assert np.allclose(np.sort_complex(found), np.sort_complex(np.linalg.eigvals(held_loop(period))))


def test_the_linearised_period_is_where_scipys_spectral_radius_crosses_one() -> None:
    expected = scipy.optimize.brentq(lambda period: radius(period) - 1, 0.05, 1.0)
    found = linearised_period(linearise(flywheel()))
    assert found.stable <= expected <= found.unstable
    assert found.unstable - found.stable < 1e-5 * expected
    assert "spectral radius" in found.meaning


def test_a_linear_plants_simulated_period_is_the_linearised_one() -> None:
    expected = scipy.optimize.brentq(lambda period: radius(period) - 1, 0.05, 1.0)
    found = simulated_period(flywheel(), 0.01, start={"q": [0.4]}, horizon=6.0)
    assert found.stable < expected * 1.1
    assert found.unstable > expected
    assert found.unstable - found.stable < 0.05 * expected


def test_a_run_near_the_set_point_follows_the_matrix_exponential() -> None:
    diagram, _ = packaged("pendulum")
    still = frozen(diagram)
    linear = linearise(diagram)
    labels = [label.partition("[")[0] for label in linear.states]
    nudge = 1e-5 * np.array([1.0 if label in ("arm.q", "servo.i") else 0.0 for label in labels])
    start: dict[str, list[float]] = {}
    for label, value in zip(labels, linear.point + nudge, strict=True):
        start.setdefault(label, []).append(value)
    run = simulate(still, 2.0, solver=Solver(output=0.5), start=start)
    states = np.hstack([run.states[label] for label in dict.fromkeys(labels)])
    for time, state in zip(run.time, states, strict=True):
        expected = linear.point + scipy.linalg.expm(linear.A * time) @ nudge
        assert np.allclose(state, expected, atol=2e-3 * 1e-5)


@pytest.mark.parametrize(("name", "clock"), [("arm2_joint", 0.002), ("ur10_fast_tuned", 0.008)])
def test_the_exact_hold_is_what_the_simulators_tick_does(name: str, clock: float) -> None:
    diagram, graph = packaged(name)
    linear = linearise(diagram, start=graph.start)
    coarse = tick_jacobian(diagram, linear, clock, Solver(step=0.001))
    fine = tick_jacobian(diagram, linear, clock, Solver(step=0.0001))
    exact = linear.sampled(clock)
    assert np.max(np.abs(fine - exact)) < 1e-6 * np.max(np.abs(exact))
    assert np.max(np.abs(fine - exact)) < 0.01 * np.max(np.abs(coarse - exact))


def test_the_equilibrium_is_on_the_goal_with_true_estimates() -> None:
    diagram, graph = packaged("ur10_fast")
    still = frozen(diagram)
    linear = linearise(diagram, start=graph.start)
    state = dict(zip(linear.states, linear.point, strict=True))
    assert state["inverse.w[0]"] == pytest.approx(1 / 800)
    assert state["inverse.w_P[1]"] == pytest.approx(2.2)
    assert state["inverse.w_I[2]"] == pytest.approx(0.7)
    q = np.array([state[f"arm.q[{j}]"] for j in range(3)])
    from dmframe.robot.chain import pin_configuration

    robot = still.robot
    import pinocchio as pin

    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, pin_configuration(robot, q))
    assert np.allclose(data.oMf[robot.model_tool].translation, [-0.07, 0.82, 0.55], atol=1e-7)


def test_known_estimates_are_kept_and_shift_the_equilibrium() -> None:
    diagram, _ = packaged("pendulum")
    assert true_values(diagram)["inverse.w"] == pytest.approx([1 / 20])
    state = equilibrium(frozen(diagram), {"inverse.w_I": 0.5})
    labels = linearise(diagram, state).states
    assert state[labels.index("inverse.w_I[0]")] == 0.5


def test_moving_leaves_out_the_slope_of_coulomb_friction_alone() -> None:
    diagram, graph = packaged("ur10_fast_kinematic")
    at_rest = linearise(diagram, start=graph.start)
    moving = linearise(diagram, at_rest.point, moving=True)
    q, dq = (at_rest.states.index(f"arm.{name}[0]") - at_rest.controller for name in ("q", "dq"))
    change = (at_rest.plant_A - moving.plant_A)[dq : dq + 3, dq : dq + 3]
    M = np.linalg.inv(-change @ np.diag(0.005 / np.array([8.0, 8.0, 4.0])))
    assert np.allclose(M, M.T, rtol=1e-9)
    joints = servo_transfer(diagram, at_rest.point)
    assert np.allclose(np.diag(M), [joint.inertia for joint in joints], rtol=1e-9)
    assert np.allclose(at_rest.plant_A[:q], moving.plant_A[:q])


def test_a_pi_servo_with_its_inverse_is_a_stiffness_and_a_damping() -> None:
    for joint, K_P, K_I, B in zip(
        servo_transfer(packaged("arm2_joint")[0]), (60, 30), (240, 120), (1, 0.5), strict=True
    ):
        assert joint.port is not None
        assert joint.passive_port is not None
        assert np.allclose(joint.port.num, [K_P + B, K_I])
        assert np.allclose(joint.port.den, [1, 0])
        assert joint.passive_port.holds
        assert joint.passive_port.least == pytest.approx(K_P + B)


@pytest.mark.parametrize("name", ["torque_indirect_pi", "torque_direct_pid"])
def test_the_inverse_of_a_users_torque_has_no_port_of_a_sliding_variable(name: str) -> None:
    for joint in servo_transfer(packaged(name)[0]):
        assert joint.port is None
        assert joint.inverse is None


@pytest.mark.parametrize(("K_c", "holds"), [(1.0, True), (0.35, True), (0.25, False)])
def test_a_pid_servo_with_its_inverse_is_passive_exactly_where_m_bar_is_positive(K_c: float, holds: bool) -> None:
    K_D, K_P, K_I, B = 20.0, 60.0, 20.0, 0.3
    (joint,) = servo_transfer(packaged("pendulum", f"inverse.K_c={K_c}")[0])
    assert joint.port is not None
    assert joint.passive_port is not None
    # K_star (s^2 + (w_P + K_c) s + w_I) / (s (s + K_c)) + B
    assert np.allclose(joint.port.num, [K_D + B, K_P + (K_D + B) * K_c, K_I])
    assert np.allclose(joint.port.den, [1, K_c, 0], atol=1e-9)
    M_bar = (K_D + B) * K_c + K_P - K_I / K_c
    assert (M_bar > 0) is holds
    assert joint.passive_port.holds is holds
    assert joint.passive_port.least == pytest.approx(min(K_D + B, M_bar / K_c))
    assert not joint.passive_servo.holds


def test_figures_are_well_formed_and_the_same_each_time() -> None:
    joints = servo_transfer(packaged("pendulum")[0])
    for draw in (bode_svg, nyquist_svg):
        text = draw(joints)
        assert ElementTree.fromstring(text).tag.endswith("svg")
        assert text == draw(joints)
        assert "http://" not in text.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
            "http://creativecommons.org", ""
        )
    assert nyquist_svg(joints) != nyquist_svg(servo_transfer(flywheel()))


def test_a_state_of_another_size_is_refused() -> None:
    with pytest.raises(ShapeError, match="linearise: expected a state of 4 numbers, found 3"):
        linearise(flywheel(), np.zeros(3))


def test_estimates_that_are_no_states_are_refused() -> None:
    diagram, _ = packaged("pendulum")
    with pytest.raises(
        ValueFault,
        match=r"estimates.arm.q: expected one number, or one per element, .*; its states are dynamics.a_d_hat, ",
    ):
        equilibrium(frozen(diagram), {"arm.q": 0})


def test_a_loop_without_an_equilibrium_is_reported() -> None:
    diagram, _ = packaged("arm2_joint")
    with pytest.raises(EngineError, match=r"set-point: expected an equilibrium .* found none; \S+ still changes by"):
        equilibrium(frozen(diagram), {"inverse.w_I": 0})


def test_a_search_that_overflows_is_reported_as_a_loop_without_an_equilibrium() -> None:
    with pytest.raises(EngineError, match=r"found none; in the search, the rate of leak\.h or its slope overflows"):
        equilibrium(frozen(Diagram.build({"leak": Leak()})))


@final
class Leak(AbstractBlock):
    """A tank that continues to leak when it is empty."""

    states = (State("h", "", "m"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"h": -1 - x.h**1.5})

    def start(self, u: Signals, p: Signals, truth: Signals) -> dict[str, Any]:
        return {"h": 0.5}


def test_a_diagram_without_a_servo_or_a_goal_is_refused() -> None:
    wheel = Diagram.build({"arm": Flywheel(J=(J,)), "servo": PiServo(K_P=1, K_I=1), "push": Still()})
    with pytest.raises(EngineError, match="largest stable period: expected a goal to follow, such as x_d for x, found"):
        simulated_period(wheel, 0.01)
    with pytest.raises(ValueFault, match="horizon: expected a positive number of seconds, found -1"):
        simulated_period(wheel, 0.01, horizon=-1)
    with pytest.raises(
        MissingError, match="servo: expected a plant block with input dq_c whose output u drives an arm"
    ):
        servo_transfer(Diagram.build({"push": Still()}), np.zeros(0))


class Still(AbstractBlock):
    """Outputs no command."""

    outputs = (Output("dq_c", "1", "rad/s", Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"dq_c": 0})


@pytest.mark.parametrize(
    "override",
    ["servo.K_D=1e308", "servo.K_D=1e160", "inverse.K_c=1e300", "dynamics.Gamma=1e308", "arm.viscous=1e160"],
)
def test_numbers_that_overflow_are_named_before_any_linear_algebra(
    capfd: pytest.CaptureFixture[str], override: str
) -> None:
    with pytest.raises(EngineError) as caught:
        linearise(Graph.read("pendulum", [override]).diagram)
    label, _, value = override.partition("=")
    assert str(caught.value).endswith(
        f": the rates of the loop overflow, with {label} = {float(value):g}; take numbers nearer to 1"
    )
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("override", ["inverse.K_c=1e-300", "servo.K_I=1e-300", "arm.viscous=1e-300"])
def test_numbers_that_vanish_are_analysed_without_a_warning(override: str) -> None:
    diagram = Graph.read("pendulum", [override]).diagram
    assert len(linearise(diagram).poles)
    (joint,) = servo_transfer(diagram)
    assert np.isfinite(joint.margins.phase)


def test_a_tick_that_overflows_is_unstable_and_its_poles_are_none() -> None:
    linear = linearise(Graph.read("pendulum", ["servo.K_D=1e9"]).diagram)
    assert linear.spectral_radius(1e290) == np.inf
    with pytest.raises(EngineError, match="overflows; take a faster clock"):
        linear.sampled_poles(1e290)


def test_friction_of_the_velocity_alone_is_left_out_of_the_joint_loops_and_named() -> None:
    plain = Graph.read("ur10_slow_kinematic")
    graph = Graph.read("ur10_slow_kinematic", ["reality={stribeck_friction: {sticking: 3, velocity: 0.1}}"])
    loops = [servo_transfer(own.diagram, start=own.start) for own in (plain, graph)]
    assert [joint.loop.num.tolist() for joint in loops[0]] == [joint.loop.num.tolist() for joint in loops[1]]
    (friction,) = left_out(graph.diagram)
    v_0 = float(graph.diagram.robot.friction_velocity)
    v = np.linspace(0, 1, 200001)
    slope = np.gradient(3 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / v_0), v)
    assert friction.standstill == pytest.approx(3 / v_0)
    assert friction.least == pytest.approx(np.min(slope), rel=0.01)
    assert np.all(np.abs(slope[v > friction.above]) < 0.011 * np.max(np.abs(slope)))
    assert left_out(plain.diagram) == ()
    loaded = Graph.read("ur10_slow_kinematic", ["reality={stribeck_friction: {per_torque: 0.1}}"])
    with pytest.raises(MissingError, match="found stribeck_friction in between"):
        servo_transfer(loaded.diagram, start=loaded.start)


@pytest.mark.parametrize(
    ("reality", "between"),
    [
        ("{torque_limits: {}}", "torque_limits"),
        ("{friction_compensation: {coulomb: 1}, torque_limits: {}}", "friction_compensation and torque_limits"),
        ("{elastic_joints: {stiffness: 1e3, inertia: 1}}", "elastic_joints"),
    ],
)
def test_blocks_between_servo_and_arm_are_named(reality: str, between: str) -> None:
    graph = Graph.read("ur10_slow_kinematic", [f"reality={reality}"])
    with pytest.raises(MissingError, match=f"expected one that drives arm itself, found {between} in between"):
        servo_transfer(graph.diagram, start=graph.start)


def test_a_gain_that_follows_from_margins_is_remarked_and_a_given_one_is_not() -> None:
    block = Graph.read("ur10_fast_inverse_tuned").blocks["task"]
    text = block.remark()
    assert text.startswith("Lambda is derived at each sampling period T from gain_margin 1.2 and delay_margin 2")
    assert f"T Lambda = {2 * math.sin(math.pi / 10) / 1.2:.3g}" in text
    assert Graph.read("ur10_slow_kinematic_inverse").blocks["task"].remark() == ""
