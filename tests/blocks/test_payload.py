"""A load at the tool: compared with Pinocchio, proved between its steps, estimated, and its excitation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, final

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import TIME, Output, Side
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.projections import outside
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_document
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.results.along import along
from dmframe.results.reported import excitation
from dmframe.robot.library import find_robot
from dmframe_blocks._loads import with_body, with_held
from dmframe_blocks.loaded_manipulator import LoadedManipulator
from dmframe_blocks.payload import Payload
from dmframe_blocks.payload_regressor import PayloadRegressor

Array = NDArray[np.float64]
V_0 = 0.005  # [rad/s] of Coulomb friction
MASS, CENTER, INERTIA = 4.3, np.array([0.02, 0.08, -0.03]), 0.03 * np.eye(3)
GRIPPER = 0.3  # [kg], 40 mm before the flange
B, D = np.array([5, 5, 2, 0.2, 0.2, 0.1]), np.array([8, 8, 4, 0.05, 0.05, 0.05])


SMALL = """
dmframe: 1
robot: arm2
clock: continuous
duration: 1 s
start: {q: [0.5, 0.9]}
blocks:
  path:     {type: sinusoid, center: [0.5, 0.9], amplitude: 0.3, rate: [1, 2]}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: payload_regressor}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 4, w_I_box: [1, 10]}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: loaded_manipulator, viscous: 1}
  load:     {type: payload, mass: [1, 0], at: [0.2, 0.6]}
"""


@cache
def model(held: str = "nothing") -> Any:
    found = pin.buildModelFromUrdf(str(find_robot("ur10").urdf))
    tool = found.frames[found.getFrameId("ee_link")].placement.translation
    gripper = pin.Inertia(GRIPPER, np.array([0, 0.04, 0]), 0.01 * np.eye(3))
    if held != "nothing":
        body = gripper if held == "gripper" else pin.Inertia(MASS, CENTER, INERTIA)
        found.appendBodyToJoint(6, body, pin.SE3(np.eye(3), tool))
    return found


@cache
def ran(until: float = 90.0) -> dm.Run:
    return dm.load("ur10_payload").run(until=until, judge=False)


def signals(run: dm.Run, *names: str) -> list[Array]:
    return [run.recording[name] for name in names]


def test_the_loaded_robot_accelerates_as_pinocchios_does() -> None:
    run = ran()
    q, dq, u, ddq = signals(run, "arm.q", "arm.dq", "servo.u", "arm.ddq")
    bare = model()
    for held, ticks in (("gripper", range(100, 3700, 700)), ("load", range(3800, 11000, 700))):
        robot = model(held)
        data, other = robot.createData(), bare.createData()
        for k in ticks:
            carried = pin.computeGeneralizedGravity(bare, other, q[k])  # the servo has no model of the load
            torque = u[k] + carried - B * dq[k] - D * np.tanh(dq[k] / V_0)
            assert ddq[k] == pytest.approx(pin.aba(robot, data, q[k], dq[k], torque), rel=1e-6, abs=1e-6)


def test_a_plant_with_bodies_of_its_own_accelerates_as_the_robot_with_them_does() -> None:
    graph = dm.load("ur10_payload").set({"blocks.load": None, "duration": "0.3 s"})
    own = [[1.3 * float(x) for x in row] for row in graph.diagram.robot.inertia]
    run = graph.set({"arm.bodies": own}).run(judge=False, progress=False)
    q, dq, u, ddq = signals(run, "arm.q", "arm.dq", "servo.u", "arm.ddq")
    bare, heavy = model(), pin.Model(model())
    for j in range(1, heavy.njoints):
        heavy.inertias[j] = pin.Inertia(
            1.3 * bare.inertias[j].mass, bare.inertias[j].lever, 1.3 * bare.inertias[j].inertia
        )
    data, other = heavy.createData(), bare.createData()
    for k in range(0, len(q), 10):
        carried = pin.computeGeneralizedGravity(bare, other, q[k])  # the servo compensates the file's robot
        torque = u[k] + carried - B * dq[k] - D * np.tanh(dq[k] / V_0)
        assert ddq[k] == pytest.approx(pin.aba(heavy, data, q[k], dq[k], torque), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([[1.0] * 10], r"arm.bodies: expected \[6, 10\] numbers"),
        ([[1.0] * 9] * 6, "expected rows of 10 numbers, found 9"),
    ],
)
def test_bodies_are_a_row_of_ten_numbers_for_each_link(rows: list[list[float]], text: str) -> None:
    with pytest.raises(dm.DmframeError, match=text):
        _ = dm.load("ur10_payload").set({"arm.bodies": rows}).diagram


def by_least_squares(run: dm.Run, start: float, end: float) -> Array:
    """The load's ten parameters, from the true motor torque by Pinocchio's regressor."""
    part = slice(*np.searchsorted(run.time, [start, end]), 10)
    rows, right = [], []
    bare = model()
    data = bare.createData()
    for q, dq, ddq, u in zip(*(x[part] for x in signals(run, "arm.q", "arm.dq", "arm.ddq", "servo.u")), strict=True):
        Y = np.array(pin.computeJointTorqueRegressor(bare, data, q, dq, ddq))[:, -10:]
        known = pin.rnea(bare, data, q, dq, ddq) - pin.computeGeneralizedGravity(bare, data, q)
        rows.append(np.hstack([Y, np.diag(dq), np.diag(np.tanh(dq / V_0))]))
        right.append(u - known)
    found, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)
    return np.asarray(found[:10])


def test_the_estimate_approaches_what_least_squares_on_the_runs_data_finds() -> None:
    run = ran()
    true = by_least_squares(run, 40, 90)
    tool = model().frames[model().getFrameId("ee_link")].placement.translation
    assert true[0] == pytest.approx(MASS, rel=1e-6)
    assert true[1:4] / true[0] - tool == pytest.approx(CENTER, abs=1e-6)
    mass, center = run.shown
    assert mass.values[0] == pytest.approx(MASS, rel=0.1)
    assert center.values == pytest.approx(CENTER, abs=0.01)


def test_before_it_is_there_and_once_it_is_put_down_the_gripper_is_left() -> None:
    assert [ran(until).shown[0].values[0] for until in (30.0, 120.0)] == pytest.approx([GRIPPER] * 2, abs=0.2)


def test_excitation_is_what_no_other_column_compensates() -> None:
    rng = np.random.default_rng(0)
    W = rng.normal(size=(300, 5)) * [1, 10, 0.1, 3, 1]
    others = np.delete(W, 1, axis=1)
    left = W[:, 1] - others @ np.linalg.lstsq(others, W[:, 1], rcond=None)[0]
    assert excitation(W, 100, np.eye(5)[1:2]) == pytest.approx(np.linalg.norm(left) / np.sqrt(100))
    W[:, 4] = W[:, 0] - 2 * W[:, 2]  # three that no row separates; their sum is determined
    found = excitation(W, 100, np.vstack([np.eye(5), [1, 0, -2, 0, 0], [1, 0, 0, 0, 1]]))
    assert list(found > 0) == [False, True, False, True, False, False, True]


def test_two_joints_determine_a_mass_by_the_difference_of_their_torques_and_a_single_one_never() -> None:
    """For a single joint, only first moments and one moment of inertia have an effect."""
    text = SMALL.replace("clock: continuous", "clock: 1 ms") + "  holds:    {type: payload_estimate}\n"
    alone = text.replace("arm2", "pendulum").replace("[0.5, 0.9]", "[0.5]").replace("[1, 2]", "[2]")
    alone = alone.replace("[60, 30]", "[30]").replace("[240, 120]", "[120]")
    excitations = [dm.load(graph).run(until=8).shown[0].excitation for graph in (text, alone)]
    assert excitations[1] == (0.0,)
    assert excitations[0] is not None
    assert excitations[0][0] > 0.1


def test_a_run_states_what_the_tool_holds_in_kilograms_and_metres() -> None:
    mass, center = ran().shown
    assert mass.excitation is not None
    assert mass.excitation[0] > 1.0
    assert "mass of the load 3.9" in str(ran())
    assert "N m/kg" in str(ran())
    assert ran().summary["shown"][1]["signal"] == center.label == "holds.c_load_hat"


def test_it_is_proved_between_the_steps_of_the_load() -> None:
    verdict = verify(Graph.read("ur10_payload").diagram)
    assert verdict.outcome == "proved"
    assert all(control.refuted for control in verdict.controls)
    assumed = " / ".join(item.text for item in verdict.assumptions)
    assert "the proof holds between two steps, each of which starts a new V" in assumed
    assert "load.a_load is the inertia of a rigid body: its pseudo-inertia is not negative" in assumed
    assert "model (payload_regressor) uses exact values of" in assumed


def test_a_load_outside_the_box_of_its_estimate_is_reported() -> None:
    graph = dm.load(SMALL).set({"dynamics.a_d_hat_box": [[0, -1, -1, -1, 0, -1, -1, 0, -1, 0, 0, 0], 1.5]})
    within, beyond = (graph.set({"load.mass": [mass, 0]}).verify() for mass in (1.4, 1.6))
    assert within.outcome == "proved"
    assert beyond.outcome == "not_applicable"
    assert "dynamics.a_d_hat: true value inside the box at t = 0.2 s" in str(beyond.reason)


@pytest.mark.parametrize(("later", "reported"), [(1.0, False), (-1e-6, True), (np.nan, True)])
def test_what_is_not_a_number_is_outside_too(later: float, reported: bool) -> None:
    loop = dm.load(SMALL).diagram.loop
    found = list(outside("dynamics.a_d_hat: true value inside the box", ca.if_else(loop.time > 60, later, 1), loop))
    assert bool(found) is reported
    assert all(not item.holds and "at t = 60.005 s" in item.name for item in found)


def test_a_robot_of_one_joint_takes_up_a_load_too() -> None:
    text = SMALL
    for old, new in {"arm2": "pendulum", "0.5, 0.9": "0.5", "1, 2": "1", "[60, 30]": "60", "[240, 120]": "240"}.items():
        text = text.replace(old, new)
    verdict = dm.load(text).verify()
    assert verdict.outcome == "proved"
    assert "load.a_load is the inertia of a rigid body: its pseudo-inertia is not negative" in {
        item.text for item in verdict.assumptions
    }


def test_v_jumps_where_the_load_does_and_nowhere_else() -> None:
    graph = dm.load("ur10_payload").set({"load.at": [0.0, 4.0, 8.0]})
    run = graph.run(until=10)
    V = along(claim_of(run.recording.diagram), run.recording).V
    steps = np.abs(np.diff(V)) * (run.time[1:] > 1)  # the first second belongs to the start
    largest = sorted(run.time[1:][np.argsort(steps)[-2:]])
    assert largest == pytest.approx([4.0, 8.0], abs=0.009)


def small() -> Graph:
    return Graph.of(read_document(SMALL, "small"))


def proof(**blocks: AbstractBlock) -> Verdict:
    graph = small()
    return verify(Diagram.build({**graph.blocks, **blocks}, graph.file.wires, graph.robot))


def test_gravity_known_or_its_fraction_estimated_both_are_proved() -> None:
    assert proof().outcome == "proved"
    assert proof(model=PayloadRegressor(gravity="share")).outcome == "proved"


def test_a_servo_that_compensates_the_links_is_refuted_where_the_controller_takes_them_for_its_own() -> None:
    arm = small().blocks["arm"]
    carried = type(arm)(**{**arm.model_dump(exclude_none=True), "maker_gravity": 0.5})
    assert proof(arm=carried).outcome == "refuted"
    assert proof(arm=carried, model=PayloadRegressor(gravity="share")).outcome == "proved"


@final
class Ramp(AbstractBlock):
    """A load that increases and declares its steps."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("a_load", "10", steps=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"a_load": u.t * ca.DM.ones(10)})


@final
class Silent(AbstractBlock):
    """A load that steps without declaring it."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("a_load", "10"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"a_load": (u.t >= 1) * ca.DM.ones(10)})


def test_a_load_that_moves_between_its_steps_is_reported() -> None:
    with pytest.raises(DmframeError, match=r"load.a_load: expected a signal that is constant between steps"):
        proof(load=Ramp())
    assert "jumps from 0 to 1 at t = 1 s" in proof(load=Silent()).reason


def test_only_a_source_steps_and_only_a_controller_shows() -> None:
    for side, output, stated in (
        (Side.PLANT, Output("c", "", "m", shown="a place"), "c is shown, but is no controller output"),
        (Side.CONTROLLER, Output("m", "", "kg", steps=True), "m steps, but is no source output"),
    ):
        members = {"side": side, "outputs": (output,), "equations": Ramp.equations, "__module__": __name__}
        found = type(Ramp)("Wrong", (AbstractBlock,), members).contract("w")
        assert [fault.text for fault in found] == [f"w: declares that {stated}; remove the declaration"]


@pytest.mark.parametrize(
    ("load", "stated"),
    [
        ({"mass": [1], "at": [0, 1]}, "expected at for each of 1 masses, found 2"),
        ({"mass": [1, 2], "at": [1, 1]}, "expected increasing times"),
        ({"mass": [-1], "at": [0]}, "expected rigid bodies, found mass -1"),
        ({"mass": [1], "at": [0], "inertia": [[1, 0, 1, 0, 0, 3]]}, "expected rigid bodies, found mass 1 with inertia"),
        ({"mass": [0], "at": [0], "inertia": [[1, 0, 1, 0, 0, 1]]}, "expected rigid bodies, found mass 0 with inertia"),
    ],
)
def test_a_load_that_is_not_a_rigid_body_is_refused(load: dict[str, Any], stated: str) -> None:
    with pytest.raises(DmframeError, match=stated):
        Payload(**load)


def learning_all(load: str = "mass: [1, 0], at: [0.2, 0.6]", arm: str = "loaded_manipulator") -> dm.Graph:
    """SMALL with columns for all links instead of those for the load."""
    text = SMALL.replace("payload_regressor", "regressor").replace("mass: [1, 0], at: [0.2, 0.6]", load)
    return dm.load(text.replace("loaded_manipulator", arm))


@pytest.mark.parametrize("gravity", ["together", "apart"])
def test_columns_for_all_links_estimate_a_load_too_and_that_is_proved_between_its_steps(gravity: str) -> None:
    verdict = learning_all().set({"model.gravity": gravity}).verify().verdict
    assert verdict.outcome == "proved", verdict.reason
    (printed,) = [
        item.text for item in verdict.assumptions if "constant between its steps; the proof holds between" in item.text
    ]
    assert printed.startswith("load.a_load is bounded")
    assert printed.endswith("at a step only the storage functions of dynamics and arm jump")


def test_the_true_parameters_are_those_of_the_last_link_with_the_load_as_pinocchio_has_them() -> None:
    graph = dm.load("ur10_payload").set(
        {
            "model": {"type": "regressor", "friction": ["viscous", "coulomb"], "gravity": "apart"},
            "holds": None,
            "baseline": {},
        }
        | {"dynamics": {"type": "dynamic_compensator", "Gamma": 1}}
    )
    claim = claim_of(graph.diagram)
    loop, true = claim.loop, claim.truths["model"]["a_d"]
    (true,) = loop.joined([true])
    function = ca.Function("a_d", [loop.time, loop.p], [loop.on_path(true)])
    for held, t in (("gripper", 10.0), ("load", 60.0), ("gripper", 100.0)):
        found, robot = function(t, loop.p_values).full().ravel(), model(held)
        links = np.concatenate([np.array(robot.inertias[k].toDynamicParameters()) for k in range(1, 7)])
        assert found[:60] == pytest.approx(links, rel=1e-9, abs=1e-9)
        weighs = found[60:84].reshape(6, 4)  # the servo compensates the robot's own weight only
        own = np.array([model().inertias[k].toDynamicParameters()[:4] for k in range(1, 7)])
        assert weighs == pytest.approx(links.reshape(6, 10)[:, :4] - own, abs=1e-9)


@pytest.mark.parametrize("kind", ["regressor", "payload_regressor"])
def test_a_robot_that_takes_no_load_has_none_in_its_true_parameters(kind: str) -> None:
    """A payload together with `manipulator` has no effect, and a proof treats it so."""
    verdict = learning_all(arm="manipulator").set({"model.type": kind}).verify().verdict
    assert verdict.outcome == "proved", verdict.reason
    assert not any("load.a_load" in item.text for item in verdict.assumptions)


def test_true_parameters_with_another_load_than_the_robots_are_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = LoadedManipulator.certificate

    def heavier(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Any:
        stated = honest(self, u, x, p, truth)
        return replace(stated, truth={**stated.truth, "a_held": 2 * u.a_load}) if stated else None

    monkeypatch.setattr(LoadedManipulator, "certificate", heavier)
    assert learning_all().verify().verdict.outcome == "refuted"


def test_a_load_outside_of_the_box_of_all_links_is_found() -> None:
    def fails(load: str) -> list[str]:
        verdict = learning_all(load).set({"dynamics.a_d_hat_box": [-20, 20]}).verify().verdict
        return [item.name for item in verdict.conditions if not item.holds]

    assert fails("mass: [1], at: [0.2]") == []
    (name,) = fails("mass: [30], at: [0.2]")
    assert "true value inside the box at t = 0.2" in name


def test_where_nothing_is_held_the_links_have_their_own_parameters_without_a_body_of_zero() -> None:
    links, held = ca.SX.sym("a", 20), ca.SX.sym("held", 10)
    assert with_held(links, ca.DM.zeros(10)) is links
    assert ca.is_equal(with_held(links, held), with_body(links, held), 9)
    assert ca.is_equal(with_held(links, held, lambda body: 2 * body), with_body(links, 2 * held), 9)


def test_of_two_loads_the_true_one_is_that_which_the_robot_carries() -> None:
    graph = dm.load(SMALL + "  other:    {type: payload, mass: [2], at: [0.4]}\nwires: {arm.a_load: other.a_load}\n")
    claim = claim_of(graph.diagram)
    names = {symbol.name() for symbol in ca.symvar(claim.truths["model"]["a_d"])}
    assert any(name.startswith("other.a_load") for name in names)
    assert not any(name.startswith("load.") for name in names)
    assert graph.verify().proved
