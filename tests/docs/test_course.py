"""Every lesson of the course runs from top to bottom and has its parts; its exercise has a hidden solution."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from dmframe.catalogue import graphs

COURSE = Path(__file__).parents[2] / "docs" / "course"
LESSONS = sorted(COURSE.glob("[0-9][0-9]_*.md"))
NAME = re.compile(r"(\d\d)_[a-z0-9_]+")
HEADER = re.compile(r"\A---\n(.*?)^---\n", re.MULTILINE | re.DOTALL)
FENCE = re.compile(r"^```\{([\w-]+)\}([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TAGS = re.compile(r"\A:tags: \[([^\]\n]*)\]\n+")
PARTS = ["Predict", "The graph", "Run it", "Watch it", "Change it", "Why", "Exercise", "What you have seen"]
"""Headings of a lesson, in this order; further headings may be in between."""


@dataclass(frozen=True)
class Cell:
    """A directive of a lesson: its first word, the rest of its line, its tags, its text, and its first line."""

    kind: str
    argument: str
    tags: tuple[str, ...]
    text: str
    line: int


def cells_of(text: str) -> Iterator[Cell]:
    for match in FENCE.finditer(text):
        kind, argument, body = match.groups()
        tags = TAGS.match(body)
        line = text[: match.start()].count("\n") + 1
        named = tuple(tag.strip() for tag in tags.group(1).split(",")) if tags else ()
        rest = body[tags.end() :] if tags else body
        yield Cell(kind, argument.strip(), named, rest, line + body[: len(body) - len(rest)].count("\n"))


def header_of(text: str) -> dict[str, Any]:
    found = HEADER.match(text)
    assert found, "a lesson begins with its header between two lines ---"
    data: dict[str, Any] = YAML(typ="safe").load(found.group(1))
    return data


def parts_of(text: str) -> dict[str, str]:
    """Headings of the second level, each with the text below it."""
    pieces = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)
    return dict(zip(pieces[1::2], pieces[2::2], strict=True))


def faults_of(text: str) -> list[str]:
    """Missing parts of a lesson."""
    header, parts, cells = header_of(text), parts_of(text), list(cells_of(text))
    lesson = header.get("lesson", {})
    solutions = [cell for cell in cells_of(parts.get("Exercise", "")) if "solution" in cell.tags]
    wanted = {
        "the header of a notebook": header.get("kernelspec", {}).get("name") == "python3"
        and header.get("jupytext", {}).get("text_representation", {}).get("format_name") == "myst",
        "a question": str(lesson.get("question", "")).endswith("?"),
        "a number of minutes": isinstance(lesson.get("minutes"), int) and 10 <= lesson["minutes"] <= 30,
        "one title": len(re.findall(r"^# [A-Z]", HEADER.sub("", _prose(text)), re.MULTILINE)) == 1,
        f"the headings {', '.join(PARTS)}, in this order": [name for name in parts if name in PARTS] == PARTS,
        "a live page to watch": any(cell.kind == "live" for cell in cells_of(parts.get("Watch it", ""))),
        "an experiment to change": any(cell.kind == "code-cell" for cell in cells_of(parts.get("Change it", ""))),
        "a formula": "$$" in parts.get("Why", ""),
        "a solution": bool(solutions),
        "a solution that is hidden": all({"hide-cell", "hide-input"} & set(cell.tags) for cell in solutions),
        "a solution that is tested": any("assert " in cell.text for cell in solutions),
        "a claim that is checked": any("check" in cell.tags and "assert " in cell.text for cell in cells),
        "checks that a reader does not see": all("remove-cell" in cell.tags for cell in cells if "check" in cell.tags),
        "cells in Python": {cell.argument for cell in cells if cell.kind == "code-cell"} == {"python"},
        "live pages of packaged graphs": all(cell.argument in graphs() for cell in cells if cell.kind == "live"),
        "no other directive": {cell.kind for cell in cells} <= {"code-cell", "live"},
    }
    return [what for what, there in wanted.items() if not there]


def _prose(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def run(text: str, where: str) -> None:
    """Run all cells in order, in one namespace; a failure names the line of the page."""
    names: dict[str, Any] = {}
    for cell in cells_of(text):
        if cell.kind == "code-cell":
            exec(compile("\n" * cell.line + cell.text, where, "exec", dont_inherit=True), names)


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda path: path.stem)
def test_a_lesson_runs_from_top_to_bottom(lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    with mpl.rc_context():
        run(lesson.read_text(encoding="utf-8"), str(lesson))
    assert Path.cwd().samefile(tmp_path)
    plt.close("all")


@pytest.mark.parametrize("lesson", LESSONS, ids=lambda path: path.stem)
def test_a_lesson_has_its_parts(lesson: Path) -> None:
    assert faults_of(lesson.read_text(encoding="utf-8")) == []


def test_lessons_are_numbered_without_a_gap_and_listed_in_order_with_their_titles() -> None:
    numbers = [int(match.group(1)) for path in LESSONS if (match := NAME.fullmatch(path.stem))]
    assert len(numbers) == len(LESSONS)
    assert numbers == list(range(len(numbers)))
    index = COURSE.joinpath("index.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| \[([^\]]+)\]\(([^)]+)\) \| (.+?) \|$", index, re.MULTILINE)
    assert [(int(number), target) for number, _, target, _ in rows] == list(enumerate(path.name for path in LESSONS))
    for (_, title, _, question), path in zip(rows, LESSONS, strict=True):
        text = path.read_text(encoding="utf-8")
        assert f"\n# {title}\n" in text
        assert question == header_of(text)["lesson"]["question"]


SOUND = """---
jupytext: {text_representation: {extension: .md, format_name: myst}}
kernelspec: {display_name: Python 3, language: python, name: python3}
lesson: {question: "Is one and one two?", minutes: 20}
---

# Why one and one is two

## Predict
## The graph
## Run it

```{code-cell} python
two = 1 + 1
```

```{code-cell} python
:tags: [remove-cell, check]

assert two == 2
```

## Watch it

```{live} pendulum
```

## Change it

```{code-cell} python
three = two + 1
```

## Why

$$1 + 1 = 2$$

## Exercise

```{code-cell} python
:tags: [hide-cell, solution]

assert three == 3
```

## What you have seen
"""


def test_a_sound_lesson_has_no_fault_and_runs() -> None:
    assert faults_of(SOUND) == []
    run(SOUND, "sound")


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("format_name: myst", "format_name: light", "the header of a notebook"),
        ("two?", "two", "a question"),
        ("minutes: 20", "minutes: 90", "a number of minutes"),
        ("# Why one and one is two\n", "", "one title"),
        ("## Run it", "## Run", "the headings"),
        ("## Watch it\n", "", "the headings"),
        ("{live} pendulum", "{live} nosuch", "live pages of packaged graphs"),
        ("```{live} pendulum\n```", "", "a live page to watch"),
        ("three = two + 1\n```", "three = two + 1\n```\n\n```{figure} a.png\n```", "no other directive"),
        ("$$1 + 1 = 2$$", "", "a formula"),
        (", solution]", "]", "a solution"),
        ("hide-cell, ", "", "a solution that is hidden"),
        ("assert three == 3", "three", "a solution that is tested"),
        ("remove-cell, ", "", "checks that a reader does not see"),
        ("assert two == 2", "two", "a claim that is checked"),
        ("{code-cell} python\ntwo", "{code-cell} julia\ntwo", "cells in Python"),
    ],
)
def test_a_lesson_that_lacks_something_is_reported(old: str, new: str, fault: str) -> None:
    assert old in SOUND
    assert any(found.startswith(fault) for found in faults_of(SOUND.replace(old, new)))


@pytest.mark.parametrize("claim", ["assert two == 2", "assert three == 3"])
def test_a_false_claim_stops_a_lesson_at_its_line(claim: str) -> None:
    false = SOUND.replace(claim, claim + " + 1")
    with pytest.raises(AssertionError) as caught:
        run(false, "false")
    assert caught.traceback[-1].lineno + 1 == false[: false.index(claim)].count("\n") + 1
