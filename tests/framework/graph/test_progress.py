"""The step that a waiting command shows in a terminal, and nowhere else."""

from __future__ import annotations

import io
import sys

import pytest

import dmframe as dm
from dmframe.graph.progress import progress_line


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_live_page_shows_its_steps_in_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.page.page.content_of", lambda *_: {"rivals": []})  # steps that take seconds
    monkeypatch.setattr("dmframe.page.page.assembled", lambda *_: "a page")
    graph = dm.load("pendulum")
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert graph.page(periods=False).html == "a page"
    shown = [line.strip() for line in terminal.getvalue().split("\r")]
    steps = [line.partition(": ")[2] for line in shown if ": " in line]
    assert steps == ["proving", "compiling the loop for a browser"]
    assert not shown[-1]  # the line is removed
    monkeypatch.setattr(sys, "stderr", other := io.StringIO())
    graph.page(periods=False)
    assert other.getvalue() == ""


def test_steps_are_kept_as_lines_on_request_but_not_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", other := io.StringIO())
    clock = iter([0.0, 0.0, 9.0, 11.0, 11.0])
    monkeypatch.setattr("dmframe.graph.progress.time.monotonic", lambda: next(clock))
    with progress_line("log.csv", kept=True) as say:
        for step in ("one", "two", "three"):
            say(step)
    assert other.getvalue() == "log.csv: one\nlog.csv: three\n"
    with progress_line("log.csv", kept=True, quiet=True) as say:
        say("four")
    assert "four" not in other.getvalue()
