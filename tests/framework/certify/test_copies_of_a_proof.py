"""A proof with parts in forked processes equals the proof in one process."""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import replace
from typing import Any

import pytest

from dmframe.certify import verify
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.prove.faults import InjectedFault

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="no copies elsewhere")
MODULE = importlib.import_module("dmframe.certify.verifier")


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if this process had no other thread, and every proof were long."""
    monkeypatch.setattr("dmframe.common.copies.threading.active_count", lambda: 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(MODULE, "LONG", 0)


@pytest.fixture(scope="module")
def diagram() -> Diagram:
    return Graph.read("arm2_joint").diagram


def test_the_verdict_is_the_same(diagram: Diagram) -> None:
    alone, shared = verify(diagram, seed=3), verify(diagram, seed=3, copies=True)
    assert shared.outcome == "proved"
    assert shared.test is not None
    assert (shared.test.seed, shared.test.trials, len(set(shared.test.primes))) == (3, 3, 3)
    for part in ("reason", "test", "controls", "conditions", "statements", "assumptions", "states", "fixed"):
        assert getattr(alone, part) == getattr(shared, part)


@LINUX
def test_copies_decide_what_no_other_part_needs(diagram: Diagram, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsteady(_: Any) -> str:
        return "" if os.getpid() == here else "done by a copy"

    here = os.getpid()
    monkeypatch.setattr(MODULE, "unsteady", unsteady)
    assert verify(diagram).outcome == "proved"
    verdict = verify(diagram, copies=True)
    assert (verdict.outcome, verdict.reason) == ("not_applicable", "done by a copy")


def test_a_fault_that_a_copy_does_not_refute_is_one_that_was_missed(
    diagram: Diagram, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MODULE, "inject_faults", lambda *_, **__: (InjectedFault(Text("gain doubled"), False),))
    verdict = verify(diagram, copies=True)
    assert (verdict.outcome, verdict.reason) == ("not_applicable", "seeded faults were not refuted: gain doubled")


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_point_at_which_something_is_left_refutes(
    diagram: Diagram, place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dmframe.prove.identity import Points

    of = Points.at
    monkeypatch.setattr(Points, "at", lambda self, k: replace(of(self, k), zero=k != place))
    monkeypatch.setattr(MODULE, "why_not_refuted", lambda *_: Text())
    monkeypatch.setattr(MODULE, "refute", lambda *_, **__: pytest.fail("as it should be"))
    with pytest.raises(pytest.fail.Exception, match="as it should be"):
        verify(diagram, copies=True)
