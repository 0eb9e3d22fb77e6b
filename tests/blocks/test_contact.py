"""A tool against an elastic wall, and the admittance: compared with Pinocchio and with spring theory, and proved."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy
from faulty import verdict_with
from numpy.typing import NDArray

import dmframe as dm
from dmframe.block import AbstractBlock
from dmframe.block.certificate import Assumption, Certificate, StableLinear
from dmframe.certify import Verdict, verify
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_document
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.results.metrics import tracking_error
from dmframe.robot.library import find_robot
from dmframe.simulate import Recording, simulate
from dmframe_blocks.admittance import Admittance
from dmframe_blocks.force_sensor import ForceSensor
from dmframe_blocks.wall import Wall

Array = NDArray[np.float64]
V_0 = 0.005  # [rad/s] of Coulomb friction
K_D, K_P, K_I = np.array([800.0, 800, 400]), np.array([1760.0, 1760, 880]), np.array([560.0, 560, 280])
B, D = np.array([19.7, 16.8, 8.9]), np.array([13.6, 14.9, 5.8])
ROTORS = np.array([2.5, 4.7, 1.2])  # [kg m^2]
FACE, STIFFNESS, DAMPING = 0.84, 1000.0, 500.0  # the wall y = 0.84 m, N/m, N s/m^2
K_A = 400.0  # [N/m]
PRESSED = 0.05  # [m] from the wall's surface to the goal behind it


@cache
def model() -> Any:
    full = pin.buildModelFromUrdf(str(find_robot("ur10").urdf))
    hold = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
    pose = pin.neutral(full)
    for joint, angle in hold.items():
        pose[full.joints[full.getJointId(joint)].idx_q] = angle
    reduced = pin.buildReducedModel(full, [full.getJointId(joint) for joint in hold], pose)
    reduced.armature = ROTORS
    return reduced


@cache
def tool(data: Any = None) -> tuple[Any, int]:
    return model().createData(), model().getFrameId("ee_link")


def place(q: Array) -> tuple[Array, Array]:
    """The tool's position, and its Jacobian."""
    data, frame = tool()
    pin.computeJointJacobians(model(), data, q)
    pin.updateFramePlacements(model(), data)
    J = pin.getFrameJacobian(model(), data, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
    return data.oMf[frame].translation.copy(), np.array(J)


def wall_force(x: Array, dx: Array, stiffness: float = STIFFNESS, damping: float = DAMPING) -> Array:
    depth = x[1] - FACE
    return np.array([0.0, -depth * max(stiffness + damping * dx[1], 0.0) if depth > 0 else 0.0, 0.0])


@cache
def ran(until: float, *overrides: str) -> Recording:
    graph = Graph.read("ur10_admittance", overrides)
    return simulate(graph.diagram, until, clock=graph.file.clock, start=graph.start)


def ticks(run: Recording, start: float, end: float) -> slice:
    first, last = np.searchsorted(run.time, [start, end])
    return slice(int(first), int(last))


def simulated(run: Recording, start: float, end: float, force: Callable[[Array, Array], Array]) -> Array:
    """The joints at `end` by SciPy, from the run's state at `start` with its commands."""
    part, data = ticks(run, start, end), tool()[0]
    y = np.concatenate([run[name][part.start] for name in ("arm.q", "arm.dq", "servo.q_c", "servo.i")])
    for k in range(part.start, part.stop):
        dq_c = run["inverse.dq_c"][k]

        def rate(_: float, y: Array, dq_c: Array = dq_c) -> Array:
            q, dq, q_c, i = y.reshape(4, 3)
            u = -K_D * (dq - dq_c) - K_P * (q - q_c) - K_I * i
            x, J = place(q)
            torque = u - B * dq - D * np.tanh(dq / V_0) + J.T @ force(x, J @ dq)
            return np.concatenate([dq, pin.aba(model(), data, q, dq, torque), dq_c, q - q_c])

        y = scipy.integrate.solve_ivp(rate, (0, 0.008), y, method="LSODA", rtol=1e-8, atol=1e-10).y[:, -1]
    return y[:3]


def test_the_robot_in_contact_moves_as_pinocchio_and_scipy_move_it() -> None:
    run = ran(4.0)
    start, end = 1.2, 2.0  # contact begins in between
    depth = run["wall.depth"][ticks(run, start, end)].ravel()
    assert depth[0] == 0 < depth[-1]
    found = run["arm.q"][ticks(run, start, end).stop]
    assert np.abs(found - simulated(run, start, end, wall_force)).max() < 2e-7
    without = simulated(run, start, end, lambda x, dx: np.zeros(3))
    soft = simulated(run, start, end, lambda x, dx: wall_force(x, dx, damping=0.0))
    assert np.abs(found - without).max() > 1e-4
    assert np.abs(found - soft).max() > 2e-6


def test_at_every_instant_the_power_that_the_robot_stores_is_what_motors_friction_and_wall_give() -> None:
    run, data = ran(8.0), tool()[0]
    given, lost = [], 0.0
    signals = [run[name] for name in ("arm.q", "arm.dq", "arm.ddq", "servo.u", "wall.f_ext")]
    for q, dq, ddq, u, f in zip(*signals, strict=True):
        x, J = place(q)
        assert f == pytest.approx(wall_force(x, J @ dq), abs=1e-7)
        stored = dq @ pin.rnea(model(), data, q, dq, ddq)  # d/dt of kinetic and potential energy
        given.append(dq @ (u - B * dq - D * np.tanh(dq / V_0)) + f @ J @ dq - stored)
        lost -= 0.008 * f @ J @ dq
    assert np.abs(given).max() < 1e-8
    spring = 0.5 * STIFFNESS * float(run["wall.depth"][-1].item()) ** 2
    assert 0 < spring < lost < 1.2 * spring  # its input less the energy of its spring was dissipated


@pytest.mark.parametrize(("stiffness", "K_a"), [(1000, 400), (300, 800), (20000, 400)])
def test_pressed_into_the_wall_the_tool_stays_where_two_springs_agree(stiffness: float, K_a: float) -> None:
    run = ran(60.0, f"wall.stiffness={stiffness}", f"compliance.K_a={K_a}")
    x_a = -PRESSED * stiffness / (stiffness + K_a)
    assert run["compliance.x_a"][-1] == pytest.approx([0, x_a, 0], abs=2e-6)
    assert run["wall.f_ext"][-1] == pytest.approx([0, K_a * x_a, 0], rel=1e-3, abs=1e-9)
    assert np.linalg.norm(run["arm.x"][-1] - run["compliance.x_c"][-1]) < 2e-6


def test_the_run_is_judged_by_the_goal_that_the_force_has_moved() -> None:
    error = tracking_error(ran(8.0))
    assert error is not None
    assert (error.signal, error.desired) == ("x - x_c", "compliance.x_c")
    assert error.rms_by_eighth[-1] < 0.5e-3
    assert np.linalg.norm((ran(8.0)["arm.x"] - ran(8.0)["path.x_d"])[-1]) > 30e-3


def test_behind_an_encoder_it_is_judged_by_the_same_goal_and_the_tools_true_place() -> None:
    graph = dm.load("ur10_admittance").reality({"encoder": {"step": "1 urad"}, "transport_delay": {"samples": 1}})
    (goal,) = graph.diagram.loop.goals
    assert (goal.actual, goal.desired) == ("arm.x", "compliance.x_c")
    error = graph.run(until="8 s", progress=False, judge=False).error
    assert error is not None
    assert error.rms_by_eighth[-1] is not None
    assert error.rms_by_eighth[-1] < 0.5e-3  # 35 mm from path.x_d


def test_a_stiff_wall_requires_a_damping_of_more_than_its_stiffness_times_the_period() -> None:
    """Stability of the sampled mass on a spring: D_a > T k; with T k = 800 N s/m."""
    bounces, rests = (ran(20.0, "wall.stiffness=1e5", f"compliance.D_a={D_a}") for D_a in (250, 1200))
    spread = [float(np.ptp(run["wall.f_ext"][ticks(run, 6, 8), 1])) for run in (bounces, rests)]
    assert spread[0] > 1.0
    assert spread[1] < 0.2


SMALL = """
dmframe: 1
robot: arm2
clock: continuous
duration: 1 s
start: {q: [0.5, 0.9]}
blocks:
  path:       {type: circle, center: [0.5, 0.4], radius: 0.1, rate: 1 rad/s}
  geometry:   {type: kinematics}
  compliance: {type: admittance, M_a: 10, D_a: 200, K_a: 400}
  task:       {type: known_tracking, gamma: 1}
  model:      {type: regressor}
  dynamics:   {type: dynamic_compensator, Gamma: 1}
  inverse:    {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 4, w_I_box: [1, 10]}
  servo:      {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:        {type: manipulator, viscous: 1}
  wall:       {type: wall, point: [0.6, 0], normal: [-3, -4], stiffness: 1000, damping: 100}
wires: {task.x_d: compliance.x_c}
"""


@cache
def small() -> Graph:
    """Two joints and a PI servo."""
    return Graph.of(read_document(SMALL, "small"))


@pytest.mark.parametrize("name", ["arm2, PI", "ur10_admittance"])
def test_it_is_proved_and_what_the_environment_has_to_do_is_assumed(name: str) -> None:
    graph = small() if name == "arm2, PI" else Graph.read(name)
    verdict = verify(graph.diagram)
    assert verdict.outcome == "proved"
    assert all(control.refuted for control in verdict.controls)
    assert "the environment's force f_ext stays bounded" in [item.text for item in verdict.assumptions]
    assert {"x - x_d", "d(x - x_d)/dt"} == {item.signal for item in verdict.statements if item.concludes}
    assert verdict.states is not None
    assert not verdict.states.open


def without(**methods: Any) -> Verdict:
    """The proof with methods of the admittance replaced."""
    graph = small()
    given = {"__module__": Admittance.__module__, "__doc__": "With a fault, and without printed laws.", **methods}
    kind = type(Admittance)("Admittance", (Admittance,), given)
    block = kind(**graph.blocks["compliance"].model_dump())
    return verify(Diagram.build({**graph.blocks, "compliance": block}, graph.file.wires, graph.robot))


def with_torque(factor: float) -> Callable[..., Any]:
    def equations(self: AbstractBlock, u: Any, x: Any, p: Any) -> Any:
        stated = Admittance.equations(self, u, x, p)  # type: ignore[arg-type]
        torque = {"tau_task": factor * stated.outputs["tau_task"]}
        return type(stated)({**stated.outputs, **torque}, stated.rates)

    return equations


@pytest.mark.parametrize("factor", [0.0, -1.0, 0.99])
def test_a_force_that_is_not_cancelled_is_refuted(factor: float) -> None:
    assert without(equations=with_torque(factor)).outcome == "refuted"


def test_a_force_that_does_not_act_on_the_robot_as_stated_is_refuted() -> None:
    graph = small()
    verdict = verdict_with(graph, "wall", positive=lambda value: value)
    assert verdict.outcome == "proved"  # a wall that also pulls is another environment, which V does not cover
    sensor = {**graph.blocks, "sensor": ForceSensor(offset=1)}
    assert verify(Diagram.build(sensor, graph.file.wires, graph.robot)).outcome == "not_applicable"


BOUNDED = (Assumption("f is bounded"),)


def driven(inputs: Any, otherwise: Any = BOUNDED) -> Callable[..., Certificate]:
    def certificate(self: AbstractBlock, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        rates = ((0, 1), (-p.K_a / p.M_a, -p.D_a / p.M_a))  # type: ignore[attr-defined]
        item = StableLinear((x.x_a, x.v_a), rates, (x.x_a, x.v_a), otherwise, inputs=inputs(u, p))
        return Certificate(linear=(item,))

    return certificate


@pytest.mark.parametrize(
    "inputs",
    [lambda u, p: (), lambda u, p: (0, 2 * u.f_ext / p.M_a), lambda u, p: (u.f_ext / p.D_a, 0 * u.f_ext / p.M_a)],
)
def test_without_the_right_input_nothing_bounds_the_goal(inputs: Any) -> None:
    verdict = without(certificate=driven(inputs))
    assert verdict.outcome == "proved"
    assert verdict.states is not None
    assert "compliance.v_a" in verdict.states.open
    assert not any(item.concludes for item in verdict.statements)


@pytest.mark.parametrize(
    ("inputs", "otherwise", "reports"),
    [
        (lambda u, p: (u.f_ext,), BOUNDED, "expected no input or 2 for the 2 vectors"),
        (lambda u, p: (0, u.f_ext / p.M_a), (), "expected assumptions as otherwise, together with the inputs"),
    ],
)
def test_an_input_without_an_assumption_is_refused_by_name(inputs: Any, otherwise: Any, reports: str) -> None:
    verdict = without(certificate=driven(inputs, otherwise))
    assert verdict.outcome == "not_applicable"
    assert reports in verdict.reason


def test_a_normal_without_a_direction_is_refused() -> None:
    with pytest.raises(DmframeError, match=r"normal: expected a direction, .*, found \[0.0, 0.0, 0.0\]"):
        Wall(point=[0, 0, 0], normal=[0, 0, 0], stiffness=1)


def test_a_sensor_with_an_offset_presses_less_by_it() -> None:
    plain, off = (ran(20.0, *more) for more in ((), ("blocks.sensor={type: force_sensor, offset: [0, -7, 0]}",)))
    at = ticks(plain, 7.9, 8).start  # it rests inside the wall
    # K_a x_a = f + offset, f = -k (depth - |x_a|): less force by offset k/(k + K_a)
    less = 7 * STIFFNESS / (STIFFNESS + K_A)
    assert off["wall.f_ext"][at, 1] - plain["wall.f_ext"][at, 1] == pytest.approx(less, rel=0.05)
