"""Times and rates outside of plausible ranges: a forgotten unit."""

from __future__ import annotations

from typing import Any

import pytest

import dmframe as dm
from dmframe.catalogue import graphs
from dmframe.config.plausible import implausible
from dmframe.graph.doubts import doubts


@pytest.mark.parametrize("name", graphs())
def test_no_packaged_graph_has_an_implausible_time(name: str) -> None:
    assert implausible(dm.load(name)) == ()


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("ur10_fast", {"clock": 8}, "clock is 8 s, expected 50 µs to 500 ms; for 8 ms write `clock: 8 ms`"),
        ("ur10_fast", {"clock": "8 us"}, "clock is 8 µs, expected 50 µs to 500 ms"),
        ("ur10_fast", {"duration": 300000}, "duration is 300000 s, 3.47 days"),
        ("ur10_fast_sampled", {"inverse.tau": 400}, "inverse.tau is 400 s, expected at most 60 s; for 400 ms write"),
        (
            "ur10_fast",
            {"inverse.K_c": 300},
            "inverse.K_c is 300 1/s, 2.4 in a sample of 8 ms; expected at most 250 1/s",
        ),
        ("ur10_fast", {"path.rate": 360}, "path.rate is 360 rad/s, 2.88 in a sample of 8 ms"),
        ("pendulum_kinematic", {"path.rate": 360}, ""),
        ("ur10_fast", {"servo.K_P": 1e6}, ""),
    ],
)
def test_an_implausible_time_is_named_with_its_range(name: str, values: dict[str, Any], text: str) -> None:
    found = implausible(dm.load(name).set(values))
    assert found[0].startswith(text) if text else found == ()


def test_verify_and_run_say_it_below_the_headline_and_in_json() -> None:
    graph = dm.load("pendulum").set(clock=8)
    found = graph.verify()
    assert (
        str(found).splitlines()[1] == "  notice: clock is 8 s, expected 50 µs to 500 ms; for 8 ms write `clock: 8 ms`"
    )
    assert found.summary["notices"] == list(implausible(graph))
    assert doubts(graph, graph.simulate())[0] == implausible(graph)[0]
