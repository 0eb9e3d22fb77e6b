"""``dmframe learn`` and ``dmframe explain``."""

from __future__ import annotations

import json
import pydoc
import sys
from pathlib import Path
from typing import Any

import pytest

from dmframe.cli.arguments import lesson_numbers
from dmframe.cli.learn import _show
from dmframe.lessons import lesson, lessons


def test_the_lessons_are_listed_with_number_time_title_and_question(dmframe: Any) -> None:
    reported = dmframe("learn")
    assert reported.status == 0
    first = lessons()[0]
    assert reported.out.splitlines()[0].split("  ") == ["0", f" {first.minutes} min", first.title]
    assert first.question in reported.out
    assert reported.out.endswith("open one: dmframe learn 0\n")
    listed = json.loads(dmframe("learn", "--json").out)
    assert [item["number"] for item in listed] == list(lessons())
    assert set(listed[0]) == {"number", "name", "title", "question", "minutes"}


def test_a_lesson_is_opened_as_a_notebook_and_never_over_another_file(dmframe: Any, tmp_path: Path) -> None:
    found = lessons()[3]
    target = f"lesson_03_{found.name}.ipynb"
    reported = dmframe("learn", "3")
    assert reported.status == 0
    assert reported.out.startswith(
        f"wrote {target}: {found.title}, {found.minutes} minutes\nopen it: jupyter lab {target}"
    )
    assert json.loads((tmp_path / target).read_text())["metadata"]["title"] == found.title
    (tmp_path / target).write_text("mine")
    again = dmframe("learn", "3")
    assert (again.status, again.err) == (
        2,
        f"dmframe: {target}: expected a new file, found one; --force overwrites it\n",
    )
    assert (tmp_path / target).read_text() == "mine"
    assert dmframe("learn", "3", "--force").status == 0
    assert (tmp_path / target).read_text() != "mine"


def test_a_lesson_is_printed_and_nothing_is_written(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("learn", "3", "--read")
    assert reported.out.startswith(f"{lessons()[3].title}\n===")
    assert max(len(line) for line in reported.out.splitlines() if not line.startswith("  ")) <= 80
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (("learn", "77"), "learn: expected a lesson from 0 to 10, found 77; `dmframe learn` lists them\n"),
        (("learn", "three"), "learn three: expected a whole number"),
        (("learn", "--read"), "--read: it has no effect without a lesson; name one"),
        (("learn", "3", "--json"), "--json: it has no effect with a lesson"),
        (("learn", "3", "--read", "--force"), "--force: it has no effect with --read"),
    ],
)
def test_values_that_make_no_sense_are_refused(dmframe: Any, words: tuple[str, ...], fault: str) -> None:
    reported = dmframe(*words)
    assert reported.status == 2
    assert reported.err.startswith(f"dmframe: {fault}")


def test_an_installation_without_a_course_reports_it(
    dmframe: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(lesson, "HOMES", (tmp_path / "none",))
    reported = dmframe("learn")
    assert (reported.status, reported.err) == (
        2,
        "dmframe: learn: expected the lessons of the course, found none; reinstall dmframe\n",
    )


def test_a_shell_completes_numbers_with_titles() -> None:
    assert [number for number, _ in lesson_numbers("1")] == ["1", "10"]
    assert lesson_numbers("3") == [("3", lessons()[3].title)]


def test_a_terminal_reads_page_by_page_and_a_pipe_does_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    paged = list[str]()
    monkeypatch.setattr(pydoc, "pager", paged.append)
    _show("text\n")
    assert (paged, capsys.readouterr().out) == ([], "text\n")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    _show("text\n")
    assert (paged, capsys.readouterr().out) == (["text\n"], "")


def test_explain_prints_sentences_or_data(dmframe: Any) -> None:
    reported = dmframe("explain", "pendulum", "--set", "inverse.w_P=3")
    assert reported.status == 0
    text = " ".join(reported.out.split())
    assert "It estimates K_P/K_D by w_P [1/s], initially 3; true value 3." in text
    assert "Verdict: proved (dmframe verify pendulum --set inverse.w_P=3)." in text
    assert "\x1b" not in reported.out
    data = json.loads(dmframe("explain", "pendulum", "--json").out)
    assert data["order"] == ["path", "task", "model", "dynamics", "inverse", "servo", "arm"]
    assert dmframe("explain", "pendulumm").err == "dmframe: pendulumm: unknown graph; did you mean pendulum?\n"
