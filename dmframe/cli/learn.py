"""``dmframe learn``: list the lessons of the course, write one as a notebook, or print it."""

from __future__ import annotations

import json
import os
import pydoc
import sys
from pathlib import Path

from dmframe.cli.options import whole
from dmframe.cli.streams import tell
from dmframe.common.columns import columns, page_width
from dmframe.common.errors import MissingError, OutputError, ValueFault
from dmframe.common.files import write_text
from dmframe.lessons import Lesson, lessons, notebook, readable


def list_lessons(*, as_json: bool) -> None:
    """Print number, time, title and question of each lesson."""
    found = _known()
    if as_json:
        keys = ("number", "name", "title", "question", "minutes")
        tell(json.dumps([{key: getattr(lesson, key) for key in keys} for lesson in found.values()], indent=2))
        return
    rows = [row for lesson in found.values() for row in _rows(lesson)]
    tell(f"{columns(rows, indent='')}\n\nopen one: dmframe learn {next(iter(found))}")


def _rows(lesson: Lesson) -> list[tuple[str, str, str]]:
    return [(str(lesson.number), f"{lesson.minutes} min", lesson.title), ("", "", lesson.question)]


def open_lesson(text: str, *, read: bool, force: bool) -> None:
    """Write a lesson as a notebook into the working folder, or print it, with a pager in a terminal."""
    known = _known()
    number = whole("learn", text)
    if number not in known:
        numbers = f"{min(known)} to {max(known)}"
        raise ValueFault(f"learn: expected a lesson from {numbers}, found {number}; `dmframe learn` lists them")
    lesson = known[number]
    if read:
        _show(readable(lesson, page_width()))
        return
    target = Path(f"lesson_{lesson.number:02}_{lesson.name}.ipynb")
    if target.exists() and not force:
        raise OutputError(f"{target}: expected a new file, found one; --force overwrites it")
    write_text(target, notebook(lesson), new=not force)
    tell(
        f"wrote {target}: {lesson.title}, {lesson.minutes} minutes\n"
        f"open it: jupyter lab {target}, or in an editor that runs notebooks\n"
        f"read it here: dmframe learn {lesson.number} --read"
    )


def _show(text: str) -> None:
    if sys.stdout.isatty():
        os.environ.setdefault("LESS", "FRX")  # as in git: quit if the text fits on the screen
        pydoc.pager(text)
    else:
        tell(text.rstrip("\n"))


def _known() -> dict[int, Lesson]:
    found = lessons()
    if not found:
        raise MissingError("learn: expected the lessons of the course, found none; reinstall dmframe")
    return found
