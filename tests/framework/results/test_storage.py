"""V as a signal of a run: its value, its increase, the known reasons, and runs without V."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.results.along import StorageTrace, along
from dmframe.results.climb import climb_of
from dmframe.results.storage import Storage
from dmframe_plants.arm2.closed_form import jacobian

LOADED = """
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
POINT = np.array([1, 0.4, 0, 0, 0, 0, 0.16, 0, 0, 0.16])
"""1 kg, 0.4 m from the last joint: its mass, first moments and moments of inertia about that joint."""


@pytest.fixture(scope="module")
def sampled() -> dm.Run:
    return dm.load("arm2_joint").run("1 s")


@pytest.fixture(scope="module")
def continuous() -> dm.Run:
    return dm.load("pendulum").run("3 s")


def test_v_is_a_signal_of_the_run_and_that_of_the_proof(sampled: dm.Run) -> None:
    verdict = dm.load("arm2_joint").verify().verdict
    proved = along(verdict.claim, sampled.recording, float(verdict.kappa.chosen))
    np.testing.assert_allclose(sampled["V"], proved.V, rtol=1e-12)
    assert sampled["V"].dims == ("time",)
    parts = [sampled[f"V.{block}"] for block in ("task", "dynamics", "inverse", "arm")]
    np.testing.assert_allclose(sum(parts), sampled["V"], rtol=1e-12)
    assert {"V", "V_rate", "V_dissipation", "V.arm"} <= set(sampled.data)
    assert sampled["arm.q"].equals(sampled.data["arm.q"])


def test_dv_dt_as_it_is_claimed_is_the_slope_of_v_in_continuous_time(continuous: dm.Run) -> None:
    V, rate, time = np.asarray(continuous["V"]), np.asarray(continuous["V_rate"]), continuous.time
    slope = (V[2:] - V[:-2]) / (time[2:] - time[:-2])
    size = np.abs(rate).max()
    assert size > 0
    np.testing.assert_allclose(slope, rate[1:-1], atol=1e-3 * size)
    assert np.abs(slope - 0.99 * rate[1:-1]).max() > 1e-3 * size  # a change of one percent would be detected


def test_where_v_falls_all_the_time_there_is_no_notice(continuous: dm.Run) -> None:
    assert np.all(np.diff(continuous["V"]) <= 0)
    assert continuous.storage.notice == ""
    assert continuous.notices == continuous.recording.notices
    assert continuous.summary["storage"]["rise"] == 0
    assert continuous.summary["storage"]["cause"] == []


def test_a_rise_at_samples_is_reported_with_its_size_its_time_and_what_differs_from_the_claim(sampled: dm.Run) -> None:
    V = np.asarray(sampled["V"])
    rise, fall = max(V[k:].max() - V[k] for k in range(len(V))), V[0] - V.min()
    data = sampled.summary["storage"]
    assert data["rise"] == pytest.approx(rise, rel=1e-9)
    assert data["share"] == pytest.approx(rise / fall, rel=1e-9)
    assert V[sampled.time == data["until"]] - V[sampled.time == data["at"]] == pytest.approx(rise, rel=1e-9)
    assert data["rises"] == np.count_nonzero(np.diff(V) > 1e-11 * V[0])
    assert (data["cause"], data["cause_computed"]) == (["sampling"], False)
    (notice,) = [text for text in sampled.notices if text.startswith("V rose")]
    assert f"V rose by {rise:.3g} " in notice
    assert f"{100 * rise / fall:.3g} % of its fall" in notice
    assert "the certificate is for continuous time, and this run samples every 2 ms" in notice
    assert notice in str(sampled)


@pytest.mark.parametrize(("fraction", "noticed"), [(0.9e-3, False), (1.1e-3, True)])
def test_a_rise_that_hardly_changes_the_bound_on_the_errors_is_no_notice(
    sampled: dm.Run, fraction: float, noticed: bool
) -> None:
    time = np.arange(4.0)
    trace = StorageTrace(time, 1.0, np.array([2.0, 1.0, 1.0 + fraction, 1.0]), ())
    assert isinstance(sampled.storage, Storage)
    small = replace(sampled.storage, along=trace)
    assert ("V rose by" in small.notice) is noticed
    assert small.summary["share"] == pytest.approx(fraction)
    assert small.summary["cause"] == ["sampling"]
    unexplained = replace(small, recording=replace(small.recording, clock=None))
    assert "violated assumption" in unexplained.notice


def test_v_is_in_the_files_of_a_run(sampled: dm.Run, tmp_path: Path) -> None:
    sampled.save(tmp_path / "mine", plots=False)
    data = json.loads((tmp_path / "mine" / "summary.json").read_text())
    assert data["storage"] == sampled.summary["storage"]
    assert data["notices"] == list(sampled.notices)
    import xarray

    with xarray.open_dataset(tmp_path / "mine" / "signals.nc", engine="h5netcdf") as signals:
        np.testing.assert_array_equal(signals["V"], sampled["V"])
        assert signals["V"].dims == ("time",)
        assert "V.dynamics" in signals


def test_a_graph_without_v_gives_the_reason() -> None:
    run, reason = dm.load("ur10_fast_kinematic").run("1 s"), "a kinematic_command has no certificate"
    with pytest.raises(DmframeError, match=r"run\['V'\]: expected a graph with a certificate, found none: .*" + reason):
        run["V"]
    data = run.summary["storage"]
    assert reason in data["reason"]
    assert {data[key] for key in ("start", "rise", "share")} == {None}
    assert "V" not in run.data


def test_a_condition_that_fails_takes_v_away() -> None:
    run = dm.load("pendulum").set({"inverse.K_c": 0.1, "inverse.tie": "position"}).run("0.1 s")
    with pytest.raises(DmframeError, match="a condition of the claim fails: "):
        run["V"]


def test_an_unknown_name_below_v_is_refused_with_the_known_ones(sampled: dm.Run) -> None:
    with pytest.raises(DmframeError, match=r"run\['V.amr'\]: .*did you mean V.arm"):
        sampled["V.amr"]


def test_a_step_of_the_load_is_no_rise_of_the_loop_and_its_jump_is_what_the_load_adds() -> None:
    run = dm.load(LOADED).run()
    climb, (first, second) = run.storage.along.climb, run.storage.along.jumps
    assert [first.time, second.time] == pytest.approx([0.2, 0.6])
    kappa = run.storage.along.kappa
    for jump, mass in ((first, 1.0), (second, -1.0)):
        k = int(np.flatnonzero(run.time == jump.time)[0])
        q, estimate = run.recording["arm.q"][k], run.recording["dynamics.a_d_hat"][k, :10]
        J, sigma = jacobian(q), run.recording["inverse.sigma"][k]
        before, after = (0 * POINT, POINT) if mass > 0 else (POINT, 0 * POINT)
        added = mass * np.sum((J @ sigma) ** 2) + np.sum((estimate - after) ** 2 - (estimate - before) ** 2)
        assert jump.change == pytest.approx(kappa / 2 * added, rel=1e-6)
    raw = np.asarray(run["V"])
    assert (raw - np.minimum.accumulate(raw)).max() > 0.1 * abs(first.change)  # V itself increases
    assert climb.rise == 0
    assert "steps of a source raised V by" in run.storage.notice


def test_rounding_of_the_states_moves_v_by_less_than_its_bound(sampled: dm.Run) -> None:
    bound, V, draw = sampled.storage.along.rounding, np.asarray(sampled["V"]), np.random.default_rng(1)
    states = {
        label: np.nextafter(rows, np.where(draw.random(rows.shape) < 0.5, -np.inf, np.inf))
        for label, rows in sampled.recording.states.items()
    }
    assert (bound < 1e-9 * V).all()  # it does not hide a detectable change
    moved = dm.Run(sampled.graph, replace(sampled.recording, states=states))
    assert np.all(np.abs(np.asarray(moved["V"]) - V) <= bound)
    assert np.any(np.asarray(moved["V"]) != V)


def test_the_climb_is_the_largest_rise_above_an_earlier_value() -> None:
    time, none = np.arange(6.0), np.zeros(0)
    climb = climb_of(time, np.array([5.0, 1.0, 2.0, 1.5, 4.0, 0.0]), none)
    assert (climb.rise, climb.since, climb.until, climb.fall, climb.rises) == (3.0, 1.0, 4.0, 5.0, 2)
    assert climb.fraction == pytest.approx(0.6)
    grown = climb_of(time[:2], np.array([1.0, 3.0]), none)
    assert (grown.rise, grown.fraction) == (2.0, None)


def test_what_rounding_explains_is_no_rise() -> None:
    time, V = np.arange(3.0), np.array([2.0, 1.0, 1.0 + 1e-12])
    assert climb_of(time, V, np.full(3, 1e-12)).rise == 0
    assert climb_of(time, V, np.full(3, 1e-12)).rises == 0
    assert climb_of(time, V, np.full(3, 1e-13)).rises == 1


def test_a_run_that_diverged_is_looked_at_up_to_there() -> None:
    time, V = np.arange(4.0), np.array([2.0, 1.0, 3.0, np.inf])
    climb = climb_of(time, V, np.zeros(0))
    assert (climb.rise, climb.end, climb.steps) == (2.0, 3.0, 2)
    assert climb_of(time, np.full(4, np.nan), np.zeros(0)).rise == 0
