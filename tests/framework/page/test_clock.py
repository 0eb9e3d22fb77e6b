"""Statements of a page on its clock: limits of the loop near its set-point, and where V increased in the run."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_node import WEB, answered, content_of_graph

import dmframe as dm
from dmframe.analysis.period import sampled_radius
from dmframe.page.periods import Periods, stable_periods
from dmframe.results.climb import climb_of

FILE, MOVED = {"p": False, "run": False}, {"p": True, "run": False, "at": []}


@cache
def clocked() -> dict[str, Any]:
    """A page's data, with those on its clock."""
    return content_of_graph(dm.load("arm2_joint"), periods=True)


def said(data: dict[str, Any], *ticks: float, moved: dict[str, Any] = FILE, web: Path = WEB) -> list[dict[str, Any]]:
    questions = [{"p": data["p"], "moved": moved, "run": {"tick": tick, "every": 1}} for tick in ticks]
    answers: list[dict[str, Any]] = answered(data, judged=questions, web=web)["answers"]
    return answers


def test_the_bounds_of_a_page_are_where_the_sampled_loop_becomes_unstable() -> None:
    graph, periods = dm.load("arm2_joint"), clocked()["periods"]
    least = min(periods["rest"], periods["moving"])
    below, above = (sampled_radius(graph.diagram, part * least) for part in (0.99, 1.01))
    assert below is not None
    assert above is not None
    assert below <= 1 + 1e-9 < above


def test_beyond_the_bounds_the_verdict_is_not_green_and_reports_it() -> None:
    data = clocked()
    least = min(data["periods"]["rest"], data["periods"]["moving"])
    inside, beyond = said(data, data["clock"], 1.01 * least)
    assert (inside["state"], beyond["state"]) == ("proved", "clock")
    assert inside["headline"] == "Proved in continuous time"
    assert beyond["headline"].endswith("unstable near its set-point")
    assert f"stable up to {1000 * data['periods']['rest']:.3g} ms at rest" in inside["sentences"][0]


def test_a_page_that_does_not_look_at_its_clock_would_be_noticed(tmp_path: Path) -> None:
    web = tmp_path / "web"
    shutil.copytree(WEB, web)
    right = (web / "verdict.js").read_text("utf-8")
    assert right.count("tick > Math.min(rest, moving)") == 1
    (web / "verdict.js").write_text(right.replace("tick > Math.min(rest, moving)", "false"), "utf-8")
    assert said(clocked(), 1.0, web=web)[0]["state"] == "proved"
    assert said(clocked(), 1.0)[0]["state"] == "clock"


def test_at_other_numbers_the_bounds_are_not_known() -> None:
    inside, beyond = said(clocked(), 0.002, 1.0, moved=MOVED)
    assert "whether that is fast enough is not known at these values" in inside["sentences"][0]
    assert beyond["state"] == "clock"


@pytest.mark.parametrize(
    ("periods", "says"),
    [(None, "was not computed"), (Periods(reason="no goal").data, "is not known: no goal")],
)
def test_bounds_that_were_not_found_are_reported_as_unknown(periods: Any, says: str) -> None:
    (found,) = said({**clocked(), "periods": periods}, 1.0)
    assert says in " ".join(found["sentences"])


def test_without_a_clock_and_over_samples_no_bound_is_looked_for() -> None:
    pendulum = dm.load("pendulum")
    assert stable_periods(pendulum.diagram, None, pendulum.verify().verdict) is None


def test_a_run_that_diverges_is_not_green() -> None:
    question = {"p": clocked()["p"], "moved": FILE, "run": {"tick": 0.002, "every": 1, "divergence": {"time": 1}}}
    (found,) = answered(clocked(), judged=[question])["answers"]
    assert (found["state"], found["headline"]) == (
        "fails",
        "This run is not as proved: sampled every 2 ms, it diverges",
    )


@pytest.mark.parametrize(("fraction", "state"), [(0.04, "proved"), (0.3, "clock"), (0.6, "fails"), (None, "fails")])
def test_the_words_of_a_verdict_follow_the_rise_of_v(fraction: float | None, state: str) -> None:
    climb = {"rise": 1.0, "rises": 7, "steps": 9, "fraction": fraction, "jumps": []}
    question = {"p": clocked()["p"], "moved": FILE, "run": {"tick": 0.002, "every": 1, "climb": climb}}
    (found,) = answered(clocked(), judged=[question])["answers"]
    assert found["state"] == state
    if state != "proved":
        assert "sampled every 2 ms, V rises" in found["headline"]


def test_a_step_of_a_source_starts_a_new_v() -> None:
    V = [4.0, 3.0, 2.0, 6.0, 5.0, 5.5]
    question = {"V": V, "rounding": [0.0] * 6}
    plain, restarted = answered({}, climbs=[question, {**question, "restarts": [3]}])["answers"]
    assert (plain["rise"], plain["rises"], plain["fraction"]) == (4.0, 2, 2.0)
    assert (restarted["rise"], restarted["rises"], restarted["fraction"]) == (0.5, 1, 0.5 / 3)
    assert restarted["jumps"] == [3]


def test_where_v_rose_is_counted_as_a_run_counts_it() -> None:
    draw = np.random.default_rng(0)
    V = [np.cumsum(draw.normal(-0.1, 1.0, 50)) + 100 for _ in range(4)] + [np.array([3.0, 2.0, 2.0 + 1e-15])]
    wrong = [np.zeros(50)] * 2 + [np.full(50, 0.4)] * 2 + [np.full(3, 1e-14)]
    pairs = [{"V": values.tolist(), "rounding": off.tolist()} for values, off in zip(V, wrong, strict=True)]
    answers = answered({}, climbs=pairs)["answers"]
    for found, values, off in zip(answers, V, wrong, strict=True):
        expected = climb_of(np.arange(float(values.size)), values, off)
        assert (found["rises"], found["steps"]) == (expected.rises, expected.steps)
        assert found["rise"] == pytest.approx(expected.rise, rel=1e-12)
        assert found["fraction"] == pytest.approx(expected.fraction, rel=1e-12)
    assert answers[-1]["rises"] == 0
