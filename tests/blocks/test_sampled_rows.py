"""Rows of a sampled estimator compared with motions of its plant: correct rows are explained, false ones refuted."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.certify import Verdict, verify
from dmframe.certify.checked import Checked
from dmframe.certify.claim import claim_of
from dmframe.certify.explained import compared, explained
from dmframe.robot.library import load as load_robot
from dmframe_blocks._averaged_servo import averaged_servo
from dmframe_blocks._last_sample import LastSample
from dmframe_blocks._row_means import RowMeans
from dmframe_blocks._sample_estimators import Projection
from dmframe_blocks._sample_response import Response
from dmframe_blocks.sampled_inverse import SampledInverse

PID = {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]}
PI = {"type": "pi_servo", "K_P": [60, 30], "K_I": [120, 60]}
P_PI = {"type": "p_pi_servo", "k_p": 3, "K_v": [60, 30], "K_i": [120, 60], "feed_forward": [0.8, 0.9]}
P_PI_BOXES = {"k_P_box": [1, 10], "k_I_box": [1, 10]}  # true values 5/s and 6/s^2
SQUARES = {"estimator": "least_squares", "average": 2}
ECHO = {"echoed": True}


def verdict(maker: dict[str, Any] = PID, **inverse: Any) -> Verdict:
    """Of two links with that servo, and such a sampled inverse."""
    memory = {} if "estimator" in inverse else {"replay": 2}
    graph = sampled_arm2(**{"servo": maker["type"].removesuffix("_servo"), **memory, **inverse})
    graph["blocks"]["servo"] = maker
    if samples := inverse.get("delay"):
        graph["blocks"]["line"] = {"type": "transport_delay", "samples": samples}
    if inverse.get("echoed"):
        graph["wires"] = {"inverse.q_echo": "servo.q_c"}
    return verify(dm.load(graph).diagram)


def checked(found: Verdict) -> Any:
    (item,) = [item for item in found.conditions if "leave unexplained of the plant's motion" in item.name]
    return item


@pytest.mark.parametrize(
    ("maker", "options"),
    [
        (PID, {}),
        (PI, {}),
        (PID, {"filtered": False}),
        (PID, {"average": 3, "stride": 2}),
        (PID, {"delay": 1}),
        (PI, {"delay": 2, "average": 2}),
        (PID, ECHO),
        (PID, {"time_stamps": True}),
        (PI, SQUARES),
        (PID, {**SQUARES, "filtered": False, "tau": 0.5}),
        (P_PI, P_PI_BOXES),
        (PID, {"servo": "p_pi"}),
        (P_PI, {**SQUARES, **P_PI_BOXES}),
    ],
)
def test_correct_rows_are_explained(maker: dict[str, Any], options: dict[str, Any]) -> None:
    found = verdict(maker, **options)
    assert found.outcome == "proved", found.reason
    assert checked(found).holds
    assert not found.rows_assumed


def test_noise_and_a_load_that_is_picked_up_take_no_part() -> None:
    graph = dm.load(sampled_arm2(replay=2))
    assert checked(verify(graph.reality({"encoder": {"step": 1e-4, "noise": 1e-4}}).diagram)).holds
    data = sampled_arm2(replay=2)
    data["blocks"]["arm"]["type"] = "loaded_manipulator"
    data["blocks"]["load"] = {"type": "payload", "mass": [1.0], "at": [0.3]}
    assert checked(verify(dm.load(data).diagram)).holds


def test_a_command_that_the_plant_changes_is_not_what_acted() -> None:
    ramp = dm.load(sampled_arm2(replay=2)).reality({"command_ramp": {"time_constant": 0.02}})
    found = verify(ramp.diagram)
    assert found.outcome == "not_applicable"
    assert not checked(found).holds


def sampled(change: Callable[[SampledInverse, Any, LastSample], LastSample]) -> dict[str, Any]:
    """The last sample with its command, v, psi and y changed; both sides are then filtered correctly."""
    honest = SampledInverse._last

    def lying(self: SampledInverse, u: Any, x: Any, p: Any) -> LastSample:
        last = change(self, x, honest(self, u, x, p))
        h, g = (last.psi - x.psi_slow, last.y - x.y_slow) if self.filtered else (last.psi, last.y)
        return replace(last, h=h, g=g)

    return {"_last": lying}


def column(k: int, value: Callable[[Any], Any]) -> dict[str, Any]:
    """The column with this number in the rows of all joints replaced."""

    def change(self: SampledInverse, x: Any, last: LastSample) -> LastSample:
        psi = ca.SX(last.psi)
        for part in averaged_of(self).joints:
            place = part.start + k if k >= 0 else part.stop + k
            psi[place] = value(psi[place])
        return replace(last, psi=psi)

    return sampled(change)


def averaged_of(block: SampledInverse) -> Any:
    """The averaged servo of the two links."""
    return averaged_servo(load_robot("arm2"), block.servo, frozenset(block.friction), block.dynamics)


def crossed(self: SampledInverse, x: Any, last: LastSample) -> LastSample:
    """The columns of K_I/K_D and of the viscous friction exchanged."""
    psi = ca.SX(last.psi)
    for part in averaged_of(self).joints:
        psi[part.start + 1], psi[part.stop - 2] = psi[part.stop - 2], psi[part.start + 1]
    return replace(last, psi=psi)


def one_side(self: SampledInverse, u: Any, x: Any, p: Any) -> LastSample:
    last = LAST(self, u, x, p)
    return replace(last, g=last.y)


def regressors(momentum: float, kinetic: float, gravity: float) -> dict[str, Any]:
    """`Response.row` with factors of its three regressors."""

    def row(self: Response, start: Any, v: Any, command: Any, T: Any, used: Any = 1) -> Any:
        robot, m = self.robot, start.q + T * v / 2
        change = (robot.momentum_regressor(m, v) - robot.momentum_regressor(start.m_before, start.v_before)) / T
        Y = momentum * used * change - kinetic * robot.kinetic_regressor(m, v)
        return pid_row(self, start, m, v, command, T, Y + gravity * robot.gravity_regressor(m))

    return {"row": row}


def instead_of_acceleration(self: Response, start: Any, v: Any, command: Any, T: Any, used: Any = 1) -> Any:
    """The momentum regressor of the velocity instead of its change."""
    robot, m = self.robot, start.q + T * v / 2
    Y = used * robot.momentum_regressor(m, v) - robot.kinetic_regressor(m, v) + robot.gravity_regressor(m)
    return pid_row(self, start, m, v, command, T, Y)


def pid_row(self: Response, start: Any, m: Any, v: Any, command: Any, T: Any, Y: Any) -> Any:
    """The row of a PID servo with these inertial columns."""
    e, ones = m - start.target - T * command / 2, ca.DM.ones(self.robot.n)
    return self.averaged.row(e, start.z + T * e / 2, ones, Y, v, self.robot.coulomb(v))


def other_joint(self: RowMeans, x: Any, row: Any, goal: Any) -> tuple[Any, Any, dict[str, Any]]:
    """The rows of all joints with the output of another joint."""
    row, goal, kept = MEANT(self, x, row, goal)
    return row, ca.vertcat(goal[1:], goal[0]), kept


def stored_elsewhere(self: Projection, x: Any, h: Any, g: Any) -> Any:
    """Rows stored with the output of another joint, and used again in the update."""
    lines = KEPT(self, x, h, g)
    return (lines[0], replace(lines[1], newest=ca.horzcat(lines[1].newest[1:], lines[1].newest[0])))


def updated_elsewhere(self: Projection, x: Any, h: Any, g: Any, by: Any) -> Any:
    theta, kept = UPDATED(self, x, h, g, by)
    return theta, {**kept, "goals": self._stored(x, x.goals, ca.vertcat(g[1:], g[0]))}


def before(self: SampledInverse, x: Any, last: LastSample) -> LastSample:
    return replace(last, y=last.command - x.v_before)


LAST, MEANT = SampledInverse._last, RowMeans.after
KEPT, UPDATED = Projection.kept, Projection.updated

LIES: dict[str, dict[Any, dict[str, Any]]] = {
    "y negated": {SampledInverse: sampled(lambda self, x, last: replace(last, y=-last.y))},
    "y doubled": {SampledInverse: sampled(lambda self, x, last: replace(last, y=2 * last.y))},
    "y of the sample before": {SampledInverse: sampled(before)},
    "columns crossed": {SampledInverse: sampled(crossed)},
    "a column scaled by 2": {SampledInverse: column(0, lambda of: 2 * of)},
    "z omitted": {SampledInverse: column(1, lambda of: 0)},
    "momentum of the other sign": {Response: regressors(-1, 1, 1)},
    "kinetic of the other sign": {Response: regressors(1, -1, 1)},
    "gravity dropped": {Response: regressors(1, 1, 0)},
    "velocity for acceleration": {Response: {"row": instead_of_acceleration}},
    "friction of the other sign": {SampledInverse: column(-1, lambda of: -of)},
    "drag of the other sign": {SampledInverse: column(-2, lambda of: -of)},
    "rows of another joint": {RowMeans: {"after": other_joint}},
    "stored rows of another joint": {Projection: {"kept": stored_elsewhere, "updated": updated_elsewhere}},
    "one side filtered": {SampledInverse: {"_last": one_side}},
}


def lying(monkeypatch: pytest.MonkeyPatch, lie: str) -> None:
    for of, methods in LIES[lie].items():
        for name, method in methods.items():
            monkeypatch.setattr(of, name, method)


@pytest.mark.parametrize("lie", list(LIES))
def test_rows_that_are_not_the_plants_are_not_explained(lie: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lying(monkeypatch, lie)
    claim = claim_of(dm.load(sampled_arm2(servo="pid", replay=2)).diagram)
    (part,) = [part for part in claim.parts if part.certificate.steps]
    item = explained(claim, compared(claim, part, part.certificate.steps[0]))
    assert isinstance(item, Checked)
    assert not item.holds
    assert "does not fall with the period" in item.name
    assert ("stored row of joint1" in item.name) is (lie == "stored rows of another joint")


@pytest.mark.parametrize("place", [3, 4])
def test_a_column_of_the_command_or_of_the_target_with_the_wrong_sign_is_not_explained(
    place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, method in column(place, lambda of: -of).items():
        monkeypatch.setattr(SampledInverse, name, method)
    found = verdict(P_PI, **P_PI_BOXES)
    assert found.outcome == "not_applicable"
    assert "motion does not fall with the period" in str(found.reason)


def test_without_coupling_the_rows_are_assumed_and_the_steps_are_proved() -> None:
    found = verdict(PID, dynamics="joints", **SQUARES)
    assert found.outcome == "proved", found.reason
    assert found.rows_assumed
    assert "that its rows follow from the plant is assumed" in str(found.headline)


@pytest.mark.parametrize("lie", ["y negated", "stored rows of another joint"])
def test_a_false_claim_of_rows_and_certificate_is_not_proved(lie: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lying(monkeypatch, lie)
    found = verdict()
    assert found.outcome == "not_applicable"
    reports = (
        "the identity holds, but a condition fails: inverse: what the rows of theta leave unexplained of the plant's"
    )
    assert found.reason.startswith(f"{reports} motion does not fall with the period: ")
    assert "row of joint2, " in found.reason
    assert found.reason.endswith(" of the data at T = 5, 2.5, 1.25, 0.625, 0.312 ms")


def test_rows_without_coupling_contain_the_plants_delay_and_take_its_rotors() -> None:
    graph = copy.deepcopy(sampled_arm2(dynamics="joints", replay=2))
    graph["blocks"]["arm"]["rotor"] = [0.3, 0.2]
    assert dm.load(graph).verify().outcome == "proved"
    graph["blocks"]["line"] = {"type": "transport_delay", "samples": 1}
    found = dm.load(graph).verify()
    assert found.outcome == "not_applicable"
    assert "its rows use a delay of 0 samples, and the plant delays commands by 1" in found.reason


def test_rows_of_a_pid_servo_do_not_fit_a_cascade() -> None:
    graph = copy.deepcopy(sampled_arm2())
    graph["blocks"]["servo"] = {"type": "p_pi_servo", "k_p": 20, "K_v": [60, 30], "K_i": [240, 120]}
    assert "inverse: its certificate reads K_I" in dm.load(graph).verify().reason
