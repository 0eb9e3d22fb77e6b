"""A load's estimates are reset when the gripper reports a new load: proved between steps, the jump of V by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import dmframe as dm
from dmframe.certify import claim_of, verify
from dmframe.certify.hypotheses import BETWEEN
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_document
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.results.along import along
from dmframe.robot.library import find_robot
from dmframe_blocks.gripper import Gripper
from dmframe_blocks.payload import Payload
from dmframe_blocks.reset_compensator import ResetCompensator

Array = NDArray[np.float64]
HEAVY, LIGHT = 4.3, 1.3  # [kg], including 0.3 kg of the gripper
CENTER, INERTIA = np.array([0.02, 0.08, -0.03]), 0.03 * np.eye(3)

SMALL = """
dmframe: 1
robot: pendulum
clock: 1 ms
duration: 3 s
start: {q: [0.5]}
blocks:
  path:     {type: sinusoid, center: [0.5], amplitude: 0.3, rate: 2}
  task:     {type: joint_tracking, alpha_bar: 2}
  model:    {type: payload_regressor}
  dynamics: {type: reset_compensator, Gamma: 1, clearing: 20}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 4, w_I_box: [1, 10]}
  servo:    {type: pi_servo, K_P: [30], K_I: [120]}
  arm:      {type: loaded_manipulator, viscous: 1}
  load:     {type: payload, mass: [1, 0, 1], at: [0, 1, 2]}
  gripper:  {type: gripper, at: [1, 2]}
"""


# for one joint it is not decided that its mass matrix stays positive with an unknown load
TWO = SMALL.replace("pendulum", "arm2").replace("[0.5]", "[0.5, 0.9]")
TWO = TWO.replace("[30]", "[60, 30]").replace("[120]", "[240, 120]")


def small(text: str = SMALL) -> Graph:
    return Graph.of(read_document(text, "small"))


@cache
def graph() -> dm.Graph:
    """The gripper; from 20 s on it carries 4 kg, from 50 s on 1 kg."""
    plain = dm.load("ur10_payload")
    known = plain.blocks["dynamics"]
    body, gripper = [0.03, 0, 0.03, 0, 0, 0.03], [0.01, 0, 0.01, 0, 0, 0.01]
    kept = {"Gamma": list(known.Gamma), "a_d_hat": list(known.a_d_hat)}
    loads = {
        "load.mass": [0.3, HEAVY, LIGHT],
        "load.at": [0, 20, 50],
        "blocks.gripper": {"type": "gripper", "at": [20, 50]},
        "load.center": [[0, 0.04, 0], list(CENTER), list(CENTER)],
        "load.inertia": [gripper, body, body],
    }
    return plain.set({**loads, "dynamics": {"type": "reset_compensator", **kept}})


@cache
def ran() -> dm.Run:
    return graph().run(until=80)


def body_of(mass: float) -> pin.Inertia:
    return pin.Inertia(mass, CENTER, INERTIA)


def tool() -> pin.SE3:
    bare = pin.buildModelFromUrdf(str(find_robot("ur10").urdf))
    return pin.SE3(np.eye(3), bare.frames[bare.getFrameId("ee_link")].placement.translation)


def mass_matrix(mass: float, q: Array) -> Array:
    loaded = pin.buildModelFromUrdf(str(find_robot("ur10").urdf))
    loaded.appendBodyToJoint(6, body_of(mass), tool())
    upper = np.triu(pin.crba(loaded, loaded.createData(), q))
    return np.asarray(upper + np.triu(upper, 1).T)


def jump_at(run: dm.Run, instant: float) -> float:
    """V after an instant minus V before it, at the same state."""
    claim, recording = claim_of(run.recording.diagram), run.recording
    k = int(np.searchsorted(recording.time, instant - 1e-6))
    before = replace(recording, time=recording.time - 1e-9)
    return float(along(claim, recording).V[k] - along(claim, before).V[k])


def test_the_jump_of_v_is_that_computed_with_pinocchio() -> None:
    """kappa/2 (sigma' (M_new - M_old) sigma + the squares after, minus those before), with kappa = 1."""
    recording = ran().recording
    k = int(np.searchsorted(recording.time, 50 - 1e-6))
    q, sigma = recording["arm.q"][k], recording["inverse.sigma"][k]
    even, odd = (recording.states[f"dynamics.a_{name}"][k, :10] for name in ("even", "odd"))
    known = graph().blocks["dynamics"]
    prior, gain = np.array(known.a_d_hat[:10]), np.array(known.Gamma[:10])
    old, new = (tool().act(body_of(mass)).toDynamicParameters() for mass in (HEAVY, LIGHT))
    kinetic = sigma @ (mass_matrix(LIGHT, q) - mass_matrix(HEAVY, q)) @ sigma
    after = np.sum((prior + even - new) ** 2 / gain) + np.sum(odd**2 / gain)
    before = np.sum((prior + odd - old) ** 2 / gain) + np.sum(even**2 / gain)
    assert kinetic < 0  # releasing a part of a load removes energy
    assert jump_at(ran(), 50) == pytest.approx((kinetic + after - before) / 2, rel=1e-6)


def test_a_reset_begins_at_the_prior_leaves_friction_and_finds_the_mass() -> None:
    time, a_d_hat = ran().time, ran().recording["dynamics.a_d_hat"]
    k, prior = int(np.searchsorted(time, 50 - 1e-6)), np.array(graph().blocks["dynamics"].a_d_hat)
    assert np.abs(a_d_hat[k - 1, 0] - prior[0]) > 3
    assert a_d_hat[k, :10] == pytest.approx(prior[:10], abs=1e-9)
    assert a_d_hat[k, 10:] == pytest.approx(a_d_hat[k - 1, 10:], abs=0.02)
    assert np.abs(a_d_hat[k, 10:] - prior[10:]).max() > 0.1  # which had been estimated
    assert np.mean(a_d_hat[(time > 30) & (time < 50), 0]) == pytest.approx(HEAVY, rel=0.1)
    assert np.mean(a_d_hat[time > 60, 0]) == pytest.approx(LIGHT, abs=0.4)
    excitation = ran().shown[0].excitation
    assert excitation is not None
    assert excitation[0] > 0.5


def test_it_is_proved_at_any_instant_of_grasping_and_the_part_of_v_that_jumps_is_named() -> None:
    found = verify(small(TWO).diagram)
    assert found.outcome == "proved"
    assert not found.bounds
    assert all(control.refuted for control in found.controls)
    assert ("idle", "goes to zero") in [(item.signal, item.says) for item in found.statements]
    assumed = " / ".join(item.text for item in found.assumptions)
    start = f"is bounded, and {BETWEEN.removeprefix('is ').format(V='V')}; at a step only the storage"
    assert f"load.a_load {start} functions of dynamics and arm jump" in assumed
    assert f"gripper.odd {start} function of dynamics jumps" in assumed


def with_fault(**methods: Callable[..., Any]) -> ResetCompensator:
    members = {"__module__": __name__, "__doc__": "With a fault, and without printed laws.", **methods}
    kind = type(ResetCompensator)("Faulty", (ResetCompensator,), members)
    made: ResetCompensator = kind(Gamma=1, clearing=20)
    return made


def _mixed(self: Any, u: Any, p: Any) -> Any:
    c = ca.repmat(u.odd, p.Gamma.shape[0], 1)
    return c, 1 - c


def _both_learn(self: Any, u: Any, x: Any, p: Any, sigma: Any) -> Any:
    stated = dict(ResetCompensator.direction(self, u, x, p, sigma))
    return {**stated, "a_odd": -u.Y_d.T @ sigma}


def _grows(self: Any, u: Any, x: Any, p: Any, sigma: Any) -> Any:
    stated = ResetCompensator.direction(self, u, x, p, sigma)
    idle = p.clearing * self._idle(u, x, p) / p.Gamma
    c, s = self._chosen(u, p)
    return {"a_even": stated["a_even"] - 2 * s * idle, "a_odd": stated["a_odd"] + 2 * c * idle}


def _used_fades(self: Any, u: Any, x: Any, p: Any, sigma: Any) -> Any:
    stated = ResetCompensator.direction(self, u, x, p, sigma)
    return {"a_even": stated["a_even"] - p.clearing * x.a_even, "a_odd": stated["a_odd"] - p.clearing * x.a_odd}


@pytest.mark.parametrize(
    "fault", [{"_chosen": _mixed}, {"direction": _both_learn}, {"direction": _grows}, {"direction": _used_fades}]
)
def test_a_faulty_exchange_of_the_sets_is_refuted(fault: dict[str, Callable[..., Any]]) -> None:
    plain = small()
    blocks = {**plain.blocks, "dynamics": with_fault(**fault)}
    found = verify(Diagram.build(blocks, plain.file.wires, plain.robot))
    assert found.outcome == "refuted"
    assert "dynamics" in found.reason


def changed(**blocks: Any) -> dm.Run:
    return dm.load(SMALL).set({f"{name.replace('__', '.')}": value for name, value in blocks.items()}).run()


def test_between_the_steps_v_falls_and_at_a_step_alone_it_rises() -> None:
    run = changed(clock="continuous")
    V = along(claim_of(run.recording.diagram), run.recording).V
    rises = run.time[1:][np.diff(V) > 1e-9 * V.max()]
    assert set(np.round(rises, 2)) <= {1.0, 2.0}


def test_what_is_kept_is_there_again_when_the_load_is() -> None:
    a_d_hat = changed(dynamics__clearing=0).recording["dynamics.a_d_hat"][:, :10]
    assert a_d_hat[2000] == pytest.approx(a_d_hat[999], abs=1e-3)
    assert np.abs(a_d_hat[1001] - a_d_hat[999]).max() > 0.01
    assert np.abs(changed().recording["dynamics.a_d_hat"][2000, :10]).max() < 1e-3


def at(block: Any, time: float, output: str) -> Array:
    chain = dm.load("ur10_payload").robot
    return np.asarray(block.evaluate({"t": time}, robot=chain).outputs[output])


def test_what_a_drawing_states_of_the_load_takes_its_error_out_of_v() -> None:
    """The expected load is the true one: no error of the load remains, and no reset can increase V."""
    loads = {"mass": [2, 1], "at": [1, 2], "center": [[0, 0.1, 0], [0.1, 0, 0]]}
    gripper, payload = Gripper(**loads), Payload(**loads)
    assert [at(gripper, time, "odd") for time in (0.5, 1, 1.5, 2, 3)] == [0, 1, 1, 0, 0]
    for time in (0.5, 1.5, 2.5):
        assert at(gripper, time, "a_expected") == pytest.approx(at(payload, time, "a_load"))
    stored = list[Array]()
    for expected in ([1, 0.5], [0, 0]):
        values = {"load__mass": [0, 1, 0.5], "gripper__mass": expected, "arm__viscous": 0}
        run = changed(**values)
        terms = along(claim_of(run.recording.diagram), run.recording).terms
        stored.append(np.sum([term.values for term in terms if term.block == "dynamics"], axis=0))
    for k in (1000, 2000):
        assert stored[0][k] < 0.02
        assert stored[1][k] > 0.1


@pytest.mark.parametrize(
    ("values", "reports"),
    [
        ({"at": [1, 1]}, "expected increasing times"),
        ({"at": [1, 2], "mass": [1]}, "expected at for each of 1 masses, found 2"),
        ({"at": [1], "mass": [-1]}, "expected rigid bodies, found mass -1"),
        ({"at": [1], "center": [[0, 0, 0]]}, "expected a mass for each center and inertia, found none"),
    ],
)
def test_a_schedule_that_no_gripper_can_have_is_refused(values: dict[str, Sequence[Any]], reports: str) -> None:
    with pytest.raises(DmframeError, match=reports):
        Gripper(**values)
