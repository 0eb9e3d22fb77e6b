"""``dmframe delay``: the delay to configure in the blocks, or the reason why there is none."""

from __future__ import annotations

import json
from typing import Any


def test_it_prints_what_to_configure_in_the_blocks(dmframe: Any) -> None:
    reported = dmframe("delay", "ur10_slow_probe")
    assert reported.status == 0
    assert "samples of 90 ms" in reported.out
    assert reported.out.endswith("delay: 0\n")


def test_motion_that_does_not_show_it_is_refused(dmframe: Any) -> None:
    reported = dmframe("delay", "ur10_slow_kinematic", "--json")
    assert reported.status == 1
    data = json.loads(reported.out)
    assert data["delay"] is None
    assert "does not determine it" in data["refused"]


def test_what_has_no_clock_has_no_delay(dmframe: Any) -> None:
    reported = dmframe("delay", "theorem_1")
    assert reported.status == 2
    assert "expected a graph with a clock" in reported.err


def test_what_the_graph_keeps_of_its_runs_does_not_count(dmframe: Any) -> None:
    late = ("--set", "reality={transport_delay: {samples: 1}}", "--set", "inverse.lasting=9", "--until", "9 s")
    for log in ("log.every=180 ms", "log.signals=[arm.x]"):
        reported = dmframe("delay", "ur10_slow_probe", *late, "--set", log)
        assert reported.out.endswith("delay: 1\n"), (log, reported)
