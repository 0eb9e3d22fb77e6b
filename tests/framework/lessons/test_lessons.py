"""Lessons: found, parsed, converted to notebooks, and printed for a terminal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dmframe.common.errors import ValueFault
from dmframe.lessons import Lesson, lessons, notebook, readable
from dmframe.lessons.reading import unicode_formula

HEADER = """---
kernelspec: {name: python3}
lesson:
  question: Does it fall?
  minutes: 20
---
"""
BODY = r"""
# What $V$ does

It *falls*, **always**, see [another page](../how_to/x.md) and [the web](https://example.org); `a|b` is code.

$$
\dot V &= -\tfrac12 |\sigma|^2 \tag{3} \\
S &\ge 0
$$

- one item that is longer than the page is wide, so that it goes on in the next line
- another

| sign | means |
|---|---|
| $|x|$ | its `a|b` |

```{code-cell} python
:tags: [remove-cell, check]

assert False
```

```{code-cell} python
:tags: [hide-cell, solution]

answer = 42
```

```{code-cell} python
print("```")
x = 1
```

```{live} pendulum
:set: dynamics.Gamma=20 clock='2 ms'
```

```{live} mine
dmframe: 1
```

```text
plain
```
"""


@pytest.fixture
def course(tmp_path: Path) -> Path:
    (tmp_path / "03_falls.md").write_text(HEADER + BODY, encoding="utf-8")
    (tmp_path / "11_last.md").write_text(HEADER.replace("20", "5") + "# The last\n", encoding="utf-8")
    (tmp_path / "index.md").write_text("# The course\n", encoding="utf-8")
    return tmp_path


@pytest.fixture
def lesson(course: Path) -> Lesson:
    return lessons(course)[3]


def test_lessons_are_the_numbered_pages_with_title_question_and_minutes(course: Path) -> None:
    found = lessons(course)
    assert list(found) == [3, 11]
    first = found[3]
    assert (first.number, first.name, first.title) == (3, "falls", "What $V$ does")
    assert (first.question, first.minutes) == ("Does it fall?", 20)
    assert lessons(course / "none") == {}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("# Title\n", "01_bad.md: expected a header with lesson: {question: ..., minutes: ...}"),
        (HEADER.replace("minutes", "hours") + "# T\n", "01_bad.md: expected a header with lesson"),
        ("---\na: [\n---\n# T\n", "01_bad.md: expected a header with lesson"),
        (HEADER + "no title\n", "01_bad.md: expected a title"),
    ],
)
def test_a_lesson_without_its_header_or_title_is_reported(tmp_path: Path, text: str, fault: str) -> None:
    (tmp_path / "01_bad.md").write_text(text)
    with pytest.raises(ValueFault) as message:
        lessons(tmp_path)
    assert str(message.value).startswith(fault)


def test_a_notebook_holds_the_text_and_the_cells_but_not_the_checks(lesson: Lesson) -> None:
    data = json.loads(notebook(lesson))
    assert (data["nbformat"], data["nbformat_minor"]) == (4, 5)
    assert data["metadata"]["kernelspec"]["name"] == "python3"
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in data["cells"]]
    assert cells[0][0] == "markdown"
    assert "see another page and [the web](https://example.org)" in cells[0][1]
    assert [text for kind, text in cells if kind == "code"] == [
        "answer = 42",
        'print("```")\nx = 1',
        "import dmframe as dm\n\ndm.load('pendulum').set({'dynamics.Gamma': '20', 'clock': '2 ms'}).page()",
        'import dmframe as dm\n\ndm.load("""\ndmframe: 1\n""").page()',
    ]
    assert cells[-1] == ("markdown", "```\nplain\n```")
    assert "assert False" not in notebook(lesson)
    assert len({cell["id"] for cell in data["cells"]}) == len(cells)
    assert all(cell["outputs"] == [] for cell in data["cells"] if cell["cell_type"] == "code")


def test_a_solution_is_folded_in_the_notebook_and_not_printed(lesson: Lesson) -> None:
    cells = json.loads(notebook(lesson))["cells"]
    folded = [cell for cell in cells if cell["metadata"].get("jupyter") == {"source_hidden": True}]
    assert ["".join(cell["source"]) for cell in folded] == ["answer = 42"]
    assert folded[0]["metadata"]["tags"] == ["hide-cell", "solution"]
    page = readable(lesson, 80)
    assert "(the solution is in the notebook)" in page
    assert "42" not in page


def test_a_terminal_gets_plain_text_within_its_width(lesson: Lesson) -> None:
    page = readable(lesson, 50)
    text = "It falls, always, see another page and the web\n(https://example.org); a|b is code."
    assert page.startswith(f"What V does\n===========\n\n{text}\n")
    assert "\n    V̇ = −½|σ|²   (3)\n    S ≥ 0\n" in page
    assert "- one item that is longer than the page is wide,\n  so that it goes on in the next line\n- another" in page
    assert "\n  sign  means\n  |x|   its a|b\n" in page
    assert '\n    print("```")\n    x = 1\n' in page
    assert "(a live page: dmframe page pendulum --set dynamics.Gamma=20 --set 'clock=2 ms')" in page
    assert "(a live page; open the notebook)" in page
    assert max(len(line) for line in page.splitlines() if not line.startswith("    ")) <= 50


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (r"\tfrac{d}{dt}(x - x_d)", "d/d t(x − x_d)"),
        (r"\frac{w \tau_{dc}}{w_I}", "(w τ_dc)/w_I"),
        (r"\tfrac1{\bar\alpha}|s|^2", "1/ᾱ|s|²"),
        (r"\sqrt{\omega^2 + 1}", "√(ω² + 1)"),
        (r"\int d \quad \text{for all } s", "∫d   for all s"),
        (r"\underbrace{a^\top b}_{\text{supply}} - d", "aᵀ b − d"),
        (r"\Delta q + \Gamma^{-1}", "Δq + Γ⁻¹"),
        (r"30^\circ", "30°"),
    ],
)
def test_formulas_of_lessons_are_printed_in_unicode(formula: str, text: str) -> None:
    assert unicode_formula(formula) == text


@pytest.mark.parametrize("number", sorted(lessons()))
def test_each_lesson_of_the_course_can_be_opened_and_read(number: int) -> None:
    found = lessons()[number]
    cells = json.loads(notebook(found))["cells"]
    for cell in cells:
        if cell["cell_type"] == "code":
            compile("".join(cell["source"]), found.path.name, "exec")
    prose = [line for line in readable(found, 100).splitlines() if not line.startswith("    ")]
    assert len(cells) > 10
    assert [line for line in prose if "$" in line or "\\" in line or "**" in line] == []


def test_the_course_is_there() -> None:
    assert list(lessons()) == list(range(11))
