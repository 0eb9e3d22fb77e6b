"""Diagrams and verdicts that tests of this folder share: those of equal content alone, and none under a patch."""

from __future__ import annotations

import pytest

import dmframe as dm
from dmframe_blocks.pid_inverse import PidInverse


def test_equal_graphs_share_diagram_and_verdict_and_others_do_not() -> None:
    first = dm.load("pendulum")
    assert dm.load("pendulum").diagram is first.diagram
    assert dm.load("pendulum").verify().verdict is first.verify().verdict
    other = first.set({"inverse.K_c": 2})
    assert other.diagram is not first.diagram
    assert other.diagram.loop.p_values.tolist() != first.diagram.loop.p_values.tolist()
    assert first.verify(seed=1).verdict is not first.verify().verdict


def test_under_a_patch_everything_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    first = dm.load("pendulum")
    verdict = first.verify().verdict
    monkeypatch.setenv("ANYTHING", "1")  # an environment variable is no patch of the code
    assert dm.load("pendulum").diagram is first.diagram
    monkeypatch.delattr(PidInverse, "certificate")
    again = dm.load("pendulum")
    assert again.diagram is not first.diagram
    assert again.verify().verdict.outcome != verdict.outcome
