"""V of the sampled law along a run: compared with NumPy, with faults, and the report if an assumption fails."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from sampled_arm2 import sampled_arm2
from sampled_by_hand import Array, Plant, SampledLaw, closed_loop
from test_sampled_by_hand import K_D, K_I, K_P, PATH, START, T, inertial, ur10

import dmframe as dm
from dmframe.certify import verify
from dmframe.common.errors import DmframeError
from dmframe.report.measured import measure
from dmframe.results.along import StorageTrace
from dmframe.results.claimed import claimed_along
from dmframe.simulate import Log, Recording, simulate

TICKS = 60
PI = {"type": "pi_servo", "K_P": [60, 30], "K_I": [120, 60]}


@dataclass
class Watched(SampledLaw):
    """The hand-written law, which stores its estimates and the rows of each sample."""

    estimates: list[Array] = field(default_factory=list)
    rows: list[list[tuple[Array, Array]]] = field(default_factory=list)

    def learn(self, h: Array, g: Array, free: Array) -> None:
        used = [(h, g, free), *self.ring, (h, g, free)]
        self.estimates.append(self.theta.copy())
        self.rows.append([(row * learns[:, None], y * learns) for row, y, learns in used])
        super().learn(h, g, free)


def arm2(**inverse: Any) -> dict[str, Any]:
    return sampled_arm2(**inverse)


def run_of(data: dict[str, Any], *overrides: tuple[str, Any]) -> dm.Run:
    return dm.load(yaml.safe_dump(data)).set(dict(overrides)).run(judge=False)


def along_of(run: dm.Run, **changed: Any) -> StorageTrace:
    """V along a run with a modified recording."""
    recording = replace(run.recording, **changed)
    return claimed_along(recording, {}, run.graph.start)[1]


@pytest.fixture(scope="module")
def short() -> dm.Run:
    return run_of(arm2())


@pytest.mark.parametrize("tau", [2.0, None])
def test_v_its_constants_and_its_residual_are_those_of_numpy(tau: float | None) -> None:
    law = Watched(ur10(), T, tau=tau)
    closed_loop(law, Plant(law.arm, START, K_D, K_P, K_I), PATH, TICKS)
    w, n = 1 / K_D, 3
    true = np.column_stack(
        [K_P / K_D, K_I / K_D, np.zeros(n), np.outer(w, inertial(law.arm)), w * law.arm.B, w * law.arm.D]
    )
    pulls, weights = np.zeros(n), np.zeros(n)
    for h, y in (row for rows in law.rows for row in rows):
        size = law.nu + np.sum(h**2 * law.Gamma, axis=1)
        pulls += h[:, 2] * (y - np.sum(h * true, axis=1)) / size
        weights += h[:, 2] ** 2 / size
    true[:, 2] = pulls / weights
    used = np.any([h != 0 for rows in law.rows for h, _ in rows], axis=0)
    V = [np.sum(((theta - true) ** 2 / law.Gamma)[used]) / 2 for theta in law.estimates]
    allowed = []
    for rows in law.rows:
        sizes = [law.nu + np.sum(h**2 * law.Gamma, axis=1) for h, _ in rows]
        etas = [y - np.sum(h * true, axis=1) for h, y in rows]
        allowed.append(sum(np.sum(eta**2 / size) for eta, size in zip(etas, sizes, strict=True)) / 2)
    assert np.all(np.diff(V) <= np.array(allowed)[:-1] + 1e-10)

    graph = dm.load("ur10_slow_sampled").set({"task.damping": 0, "inverse.filtered": tau is not None})
    mine = graph.run(f"{(TICKS - 1) * T} s", judge=False)
    # sampling instant k + 1 of the hand-written law is its k-th update
    np.testing.assert_allclose(np.asarray(mine["V"])[1:], V, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(mine["V_residual"])[1:], allowed, rtol=2e-3, atol=1e-8)
    np.testing.assert_allclose(mine.storage.along.constants["inverse.offset"], true[:, 2], rtol=1e-4, atol=1e-7)


def test_without_a_filter_the_constant_is_where_the_integrator_of_the_servo_started() -> None:
    run = run_of(arm2(filtered=False))
    i, k_I = run.recording["servo.i"][0], np.array([40, 20]) / np.array([60, 30])
    np.testing.assert_allclose(run.storage.along.constants["inverse.offset"], k_I * i, rtol=0.02)
    assert np.abs(k_I * i).max() > 0.1


@pytest.mark.parametrize(
    "inverse",
    [
        {},
        {"filtered": False},
        {"estimator": "least_squares"},
        {"servo": "pi"},
        {"servo": "pi", "estimator": "least_squares", "retention": 1},
    ],
)
def test_v_rises_at_no_sample_by_more_than_its_claim_allows(inverse: dict[str, Any]) -> None:
    data = arm2(**inverse)
    if inverse.get("servo") == "pi":
        data["blocks"]["servo"] = PI
    run = run_of(data)
    found = run.storage.along
    assert found.residual.shape == found.V.shape
    assert found.beyond == 0
    assert np.all(np.diff(run["V"]) <= np.asarray(run["V_residual"])[:-1] + 1e-6 * np.asarray(run["V"])[:-1])
    assert found.notes == ()
    assert np.abs(found.steps).max() > 1e-3  # the robot moves


def test_an_update_of_the_wrong_sign_and_one_that_is_too_long_are_seen(short: dm.Run) -> None:
    assert short.storage.along.beyond == 0
    theta = short.recording["inverse.theta"]
    for factor in (-1.0, 2.5):
        states = {**short.recording.states, "inverse.theta": theta[0] + factor * (theta - theta[0])}
        assert along_of(short, states=states).beyond > 10, factor


def test_a_gain_that_is_not_the_one_of_the_law_is_seen(short: dm.Run) -> None:
    graph = dm.load(yaml.safe_dump(arm2(inertia_size=0.5, k_P_size=5.0)))
    assert along_of(short, diagram=graph.diagram).beyond > 0


def test_a_law_that_does_not_use_its_rows_is_seen(short: dm.Run) -> None:
    draw = np.random.default_rng(0)
    states = dict(short.recording.states)
    theta = states["inverse.theta"]
    states["inverse.theta"] = theta[0] + 1e-3 * np.cumsum(draw.standard_normal(theta.shape), axis=0)
    run = dm.Run(short.graph, replace(short.recording, states=states))
    assert run.storage.along.beyond > 10
    many = run.storage.along.beyond
    assert f"V rose by more at {many} samples, so this run violates one of its assumptions" in run.storage.notice
    assert run.summary["storage"]["cause"] == ["assumption"]
    assert run.summary["storage"]["beyond"] == many


@pytest.mark.parametrize("inverse", [{"average": 3, "stride": 2}, {"estimator": "least_squares"}])
def test_states_that_are_not_kept_are_recomputed_with_what_each_sample_drew(inverse: dict[str, Any]) -> None:
    graph = dm.load(
        yaml.safe_dump({**arm2(**inverse), "reality": {"encoder": {"step": "1e-4 rad", "noise": "1e-4 rad"}}})
    )
    experiment = graph
    labels = tuple(variable.label for variable in experiment.diagram.loop.variables)

    def recorded(log: Log) -> Recording:
        return simulate(experiment.diagram, 2.0, clock=0.04, start=experiment.start, log=log)

    whole = claimed_along(recorded(Log(signals=labels)), {}, experiment.start)[1]
    plain = recorded(Log())
    missing = set(labels) - set(plain.states)
    assert missing & {"inverse.rows", "inverse.gathered"}
    found = claimed_along(plain, {}, experiment.start)[1]
    np.testing.assert_allclose(found.V, whole.V, rtol=1e-9)
    np.testing.assert_allclose(found.residual, whole.residual, rtol=1e-9, atol=1e-15)
    assert plain.instants is not None
    for wrong in ({"start": plain.start + 1e-3}, {"instants": replace(plain.instants, seed=1)}):
        other = claimed_along(replace(plain, **wrong), {}, experiment.start)[1]
        assert not np.allclose(other.residual, whole.residual, rtol=1e-3), wrong


def test_a_run_that_does_not_keep_every_sample_has_no_v_and_gives_the_reason() -> None:
    run = run_of({**arm2(), "log": {"every": "80 ms"}})
    with pytest.raises(
        DmframeError, match=r"expected a run that records inverse\.rows.* or a simulation that records every"
    ):
        run["V"]


def test_a_constant_that_no_sample_determines_is_named() -> None:
    run = run_of(arm2(u_max=1e-6))  # each command is clipped, and the estimates are constant
    (note,) = run.storage.along.notes
    assert note.startswith("no sample of the run determines inverse.offset[1] and inverse.offset[2]")
    assert note in run.storage.notice
    assert not np.any(np.diff(run["V"]))


def test_a_constant_outside_its_box_is_named_and_v_rises_beyond_its_claim() -> None:
    run = run_of(arm2(filtered=False, offset_box=[-1e-3, 1e-3]))
    assert len(run.storage.along.notes) == 2
    assert "inverse.theta[3] identified from the run, -0.41" in run.storage.notice
    assert run.storage.along.beyond > 0


def test_a_known_value_outside_its_box_takes_v_away() -> None:
    run = run_of(arm2(k_P_box=[0.2, 1.5]))
    with pytest.raises(DmframeError, match="a condition of the claim fails: inverse: true value of theta inside its"):
        run["V"]


def test_v_is_in_the_files_and_states_with_which_constants(short: dm.Run, tmp_path: Path) -> None:
    short.save(tmp_path / "mine", plots=True)
    assert (tmp_path / "mine" / "storage.svg").exists()
    V, constants = short["V"], short.summary["storage"]["constants"]["inverse.offset"]
    shown = ", ".join(f"{value:.6g}" for value in constants)
    assert f"inverse.offset = [{shown}]" in V.attrs["long_name"]
    assert f"V is evaluated with inverse.offset = [{shown}]" in short.storage.notice
    np.testing.assert_allclose(short["V.inverse"], V)
    assert [term.of for term in short.storage.along.terms] == ["theta_1 - theta_1_true", "theta_2 - theta_2_true"]
    parts = [term.values for term in short.storage.along.terms]
    np.testing.assert_allclose(np.sum(parts, axis=0), V)


def test_a_report_shows_v_and_with_which_constants(short: dm.Run) -> None:
    experiment = short.graph
    diagram = experiment.diagram
    found = measure(experiment, verify(diagram, start=experiment.start))
    assert found.sentence.startswith("The theorem is in discrete time and covers the estimates")
    assert "$V$ is evaluated with inverse.offset = [" in found.sentence
    assert "At no sample did it rise by more than its theorem allows." in found.sentence
    assert found.numbers["beyond"] == 0
    assert found.numbers["V_start"] == pytest.approx(float(short["V"][0]), rel=1e-9)
    assert "<svg" in found.figure
