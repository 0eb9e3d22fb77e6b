"""V of each packaged graph along its own run, at its own clock, as stated in `docs/explanation/proved.md`."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Final

import pytest

import dmframe as dm
from dmframe.results.storage import SLIGHT

PAGE: Final = Path(__file__).parents[3] / "docs/explanation/proved.md"
CHEAP: Final = ("filtered_regulation_pid", "pd_torque", "pendulum", "ur10_camera")
"""Runs of a second; the others, with the decision of their conditions, take up to a minute."""


@cache
def stated() -> dict[str, float]:
    """Increase of V in percent of its decrease, by graph."""
    section = PAGE.read_text("utf-8").split("## V along a run")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|[^|]*\|[^|]*\| ([\d.e-]+) \|", section, re.MULTILINE)
    (text,) = re.findall(r"graphs in continuous time \((.*?)\): V never rises", section, re.DOTALL)
    falling = re.findall(r"`(\w+)`", text)
    return dict.fromkeys(falling, 0.0) | {name: float(share) for name, share in rows}


def rises_as_stated(name: str) -> None:
    run = dm.load(name).run(judge=False)
    fraction = run.storage.along.climb.fraction
    assert fraction is not None
    # two digits are stated; with fused multiplications the run differs by rounding
    assert 100 * fraction == pytest.approx(stated()[name], rel=0.06, abs=1e-6)
    assert bool(run.storage.notice) is (stated()[name] > 100 * SLIGHT or bool(run.storage.along.jumps))
    assert run.storage.along.beyond == 0


@pytest.mark.parametrize("name", CHEAP)
def test_v_of_a_short_run_rises_as_the_page_states(name: str) -> None:
    rises_as_stated(name)


@pytest.mark.parametrize("name", sorted(set(stated()) - set(CHEAP)))
def test_v_of_a_long_run_rises_as_the_page_states(name: str) -> None:
    rises_as_stated(name)


def test_graphs_that_the_page_does_not_list_have_no_v() -> None:
    for name in sorted(set(dm.graphs()) - set(stated())):
        assert dm.load(name).run("1 s", judge=False).summary["storage"]["reason"], name


def test_graphs_in_continuous_time_are_those_of_which_v_never_rises() -> None:
    listed = [name for name in stated() if dm.load(name).clock is None]
    assert {stated()[name] for name in listed} == {0.0}
    assert len(stated()) > 40


def test_a_faster_clock_takes_the_rise_of_the_tuned_graph_away() -> None:
    run = dm.load("ur10_fast_tuned").set(clock="1 ms").run(judge=False)
    found = re.search(r"clock of 1 ms the\s+rise\s+is\s+([\d.]+) %", PAGE.read_text("utf-8"))
    assert found is not None
    assert 100 * run.storage.along.climb.fraction == pytest.approx(float(found[1]), rel=0.06)  # type: ignore[operator]
