"""Limits of the torque demand by a supervisor: by hand, and at the end of a drive's range."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sampled_by_hand import rms

import dmframe as dm
from dmframe.catalogue import block_types
from dmframe.results.run import Run

T, MOST, K_P, K_I, QUIET, FORGET = 0.09, 1.0, 1.8, 1.2, 0.01, 2.0
PER_LAG = 1 + K_P * T / 2 + K_I * T**2 / 4


def weak(delay: int, **values: Any) -> Run:
    """The drive of the second joint provides 75 N m, and the path requires 81."""
    delays = {f"{name}.delay": delay for name in ("task", "inverse", "column", "supervisor")}
    late = {"transport_delay": {"samples": 1}} if delay else {}
    graph = dm.load("ur10_slow_supervised").set({**delays, **{f"supervisor.{k}": v for k, v in values.items()}})
    weak = graph.reality({**late, "torque_limits": {"torque": [100, 75, 100]}})
    return weak.run("30 s", progress=False, engine="interpreted")


def by_hand(recorded: Any, delay: int, *, forgets: bool = True) -> np.ndarray:
    """Interval of allowed commands at each sample, from the run's previous samples."""
    lag, used, sent = (recorded[f"{name}"] for name in ("column.lag", "supervisor.epsilon_used", "supervisor.dq_sent"))
    q, withheld = recorded["arm.q"], recorded["supervisor.withheld"]
    lead, total, cut = np.zeros(3), np.zeros(3), np.zeros(3, dtype=bool)
    found = []
    for k in range(len(q)):
        v = (q[k] - q[k - 1]) / T if k else np.zeros(3)
        keep = np.where((np.abs(used[k]) <= QUIET) & ~cut, 1 - T / FORGET if forgets else 1.0, 1.0)
        lead, total = keep * (lead + T * lag[k]), keep * (total + T * (lead + T * lag[k] / 2))
        ahead, sums = lead, total
        for u in sent[max(k - delay, 0) : k]:
            ahead, sums = ahead + T * (u - v), sums + T * (ahead + T * (u - v) / 2)
        demanded = K_P * ahead + K_I * (sums + T * ahead / 2)
        found.append([v - (MOST + demanded) / PER_LAG, v + (MOST - demanded) / PER_LAG])
        cut = withheld[k] != 0
    return np.array(found)


@pytest.fixture(scope="module", params=[0, 1])
def run(request: pytest.FixtureRequest) -> tuple[int, Run]:
    return request.param, weak(request.param)


def test_commands_are_cut_off_where_by_hand_they_are(run: tuple[int, Run]) -> None:
    delay, found = run
    recorded = found.recording
    sent, wished = recorded["supervisor.dq_sent"], recorded["supervisor.dq_sent"] + recorded["supervisor.withheld"]
    cut = recorded["supervisor.withheld"] != 0
    assert np.sum(cut) > 20
    assert not np.any(cut[:, [0, 2]])  # joints with sufficient drives are not limited

    def off(bounds: np.ndarray) -> float:
        expected = np.clip(np.clip(wished, bounds[:, 0], bounds[:, 1]), -3, 3)
        return float(np.max(np.abs(expected - sent)))

    assert off(by_hand(recorded, delay)) < 1e-6
    assert off(by_hand(recorded, delay, forgets=False)) > 1e-3
    if delay:
        assert off(by_hand(recorded, 0)) > 1e-3


def test_so_the_servo_does_not_wind_up_and_the_run_gives_the_reason(run: tuple[int, Run]) -> None:
    _, found = run
    assert found.error is not None
    assert np.max(found.error.norm[found.time > 2]) < 0.14  # [m], for a tool with an insufficient drive
    assert any("does not follow its command" in notice for notice in found.recording.notices)


def test_without_a_bound_it_does() -> None:
    recorded = weak(0, demand_max=None).recording
    assert np.max(np.abs(recorded["arm.x"] - recorded["path.x_d"])) > 0.3


def test_where_a_drive_suffices_nothing_is_cut_off() -> None:
    found = dm.load("ur10_slow_supervised").run("20 s", progress=False, engine="interpreted").recording
    assert not np.any(found["supervisor.withheld"])
    assert rms(np.asarray(found["arm.x"] - found["path.x_d"])) < 0.1


def test_without_a_bound_the_block_has_fewer_states() -> None:
    block = block_types()["sampled_supervisor"]
    given = {
        name: np.zeros(3) for name in ("q", "dq_r", "dq_column", "dq_full", "q_column", "q_full", "lag", "epsilon")
    }
    memory = {"errors": np.zeros((3, 10)), "sent": np.zeros((3, 1))}
    arm = dm.load("ur10_slow_supervised").robot
    bare, bound = (
        block(**options).evaluate({**given, "T": T}, memory, robot=arm) for options in ({}, {"demand_max": 1.0})
    )
    assert {"lead", "total", "cut"} == set(bound.next) - set(bare.next)
    assert set(bound.outputs) - set(bare.outputs) == {"withheld"}
