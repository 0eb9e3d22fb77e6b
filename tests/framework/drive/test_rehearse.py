"""A rehearsal decides whether a controller may drive a robot; a real drive requires it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DriveError
from dmframe.drive import records, rehearse, robots
from dmframe.drive.error_bounds import Measured
from dmframe.drive.rehearse import Condition, conditions, rehearsed
from dmframe.drive.robots import Kind

IDEAL = Condition("nothing, the ideal robot", {})


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def tried(graph: dm.Graph, seconds: float, *more: Condition) -> Any:
    return rehearsed(graph, seconds=seconds, engine="interpreted", tried=[IDEAL, *more])


def test_a_delay_is_tolerated_by_one_graph_and_not_by_another() -> None:
    late = Condition("3 samples of delay, 24 ms", {"delay": 3})
    borne = tried(dm.load("ur10_fast"), 1.0, late)
    assert borne.passed
    assert borne.sentence == "ur10_fast passes for 1 s; a rehearsal with runs of 40 s is required to drive a robot."
    whole = replace(borne, seconds=40.0)
    assert whole.sentence.startswith("ur10_fast passes the rehearsal and may drive a robot. It was not tested on")
    found = tried(dm.load("panda_full").set({"dynamics.Gamma": 30}), 3.0, late)
    assert not found.passed
    assert found.sentence.startswith(
        "panda_full may not drive a robot: it fails with 3 samples of delay, 24 ms (stopped "
    )
    assert found.outcomes[0].why == ""
    assert "command too fast" in found.outcomes[1].why


def test_a_condition_that_is_not_required_is_reported_only() -> None:
    graph = dm.load("panda_full").set({"dynamics.Gamma": 30})
    found = tried(graph, 3.0, Condition("3 samples", {"delay": 3}, needed=False))
    assert found.passed
    assert found.outcomes[1].why.startswith("stopped after 2.")
    assert "no, not required" in str(found)
    assert [item["borne"] for item in found.summary["conditions"]] == [True, False]


@pytest.mark.parametrize(
    ("second", "last", "message"),
    [
        (0.006, 0.006, ""),
        (0.006, 0.0061, "the error is above 6 mm"),
        (0.002, 0.0039, ""),
        (0.0019, 0.0039, "the error grows, from 1.9 mm in the second quarter"),
        (0.002, np.nan, "the error is above 6 mm"),
    ],
)
def test_an_error_that_is_too_large_or_that_grows_is_not_tolerated(second: float, last: float, message: str) -> None:
    ideal = Measured("x - x_d", "m", 0.002, 0.002, 0.002, 0.2, "")
    assert rehearse._why(replace(ideal, second=second, last=last), ideal) == message


def test_steps_of_the_longest_tick_are_as_short_as_those_of_the_clocks() -> None:
    graph = dm.load("panda_full")
    still, jittered = (
        robots.simulated_robot(graph, 1.0, "interpreted", **options)._step for options in ({}, {"jitter": 0.002})
    )
    assert still.length == 0.001
    assert jittered.substeps == 12
    assert max(np.diff(jittered.instants.rows(0, 200)[:, 0])) / jittered.substeps <= still.length


def test_a_jitter_does_not_make_the_integrator_diverge_where_the_loop_does_not() -> None:
    # its steps are close to the stability limit of rk4 for this robot, which those of the longest sample would exceed
    found = tried(dm.load("panda_full"), 4.0, Condition("a jitter of 2 ms", {"jitter": 0.002}))
    assert found.passed
    ideal, jittered = (item.error for item in found.outcomes)
    assert jittered == pytest.approx(ideal, rel=0.1)


def test_a_controller_that_is_late_by_far_shows_it() -> None:
    found = tried(dm.load("ur10_fast"), 2.0, Condition("late", {"delay": 20}))
    ideal, late = (item.error for item in found.outcomes)
    assert ideal is not None
    assert late is not None
    assert late > 2 * ideal


def test_delay_jitter_lost_samples_payload_and_slider_are_all_tried() -> None:
    found = [condition.options for condition in conditions(0.008, 40.0, 1.0, 1.0)]
    assert {key for options in found for key in options} == {
        "delay",
        "jitter",
        "lost",
        "payload",
        "scaling",
        "slowed_from",
    }
    assert [options["delay"] for options in found if set(options) == {"delay"}] == [1, 2, 3]


def test_a_real_robot_is_driven_after_a_passed_rehearsal_and_with_an_acceleration_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = robots.KINDS["sim"].make
    monkeypatch.setitem(robots.KINDS, "real", Kind(real=True, make=lambda rest, *others: make("", *others)))
    graph, file = dm.load("ur10_fast"), tmp_path / "arm.yaml"
    file.write_text("dmframe-limits: 1\nacceleration: 15 rad/s^2\n")

    def go(**options: Any) -> Any:
        return graph.drive("real:host", until="0.08 s", engine="interpreted", ramp="0.02 s", **options)

    with pytest.raises(DriveError, match="expected an acceleration limit for a real robot"):
        go(rehearsed=False)
    with pytest.raises(DriveError, match="of exactly this graph, found none; run dmframe rehearse with the same graph"):
        go(limits=file)
    assert go(limits=file, rehearsed=False).recording.time.size > 1
    monkeypatch.setattr(rehearse, "conditions", lambda *_: [IDEAL])
    monkeypatch.setattr(rehearse, "LONGEST", 0.4)
    assert records.store(graph.rehearse(limits=file, engine="interpreted", ramp="0.02 s"))
    assert go(limits=file).recording.time.size > 1
    assert go(shadow=True).notices[0] == "robot: real:host, shadow drive: no command was sent"
