"""Every fenced ``console``, ``python`` and ``yaml`` snippet of the README and the docs has the documented result.

A page's snippets run in order, in one empty folder. A snippet whose first line is ``# name.ext`` is that file. Other
Python runs. Other YAML is a study, a graph, or some keys to be merged into ur10_fast, and must build. A console snippet
contains commands after ``$``, and their output: ``...`` in a line matches any text, and as a line any lines.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from dmframe.catalogue import graphs
from dmframe.cli import main
from dmframe.common import plotting
from dmframe.config.document import read_document, read_file
from dmframe.graph.graph import Graph
from dmframe.results import estimate_figure
from dmframe.study import proof

ROOT = Path(__file__).parents[2]
COURSE = ROOT / "docs" / "course"  # notebooks, which test_course.py runs
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.joinpath("docs").rglob("*.md"))]
PAGES = [page for page in PAGES if COURSE not in page.parents]
FENCE = re.compile(r"^```([^`\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# ([\w/]+\.\w+)\n")
OTHERS = ("dmframe-study:", "dmframe-race:")
DIRECTIVE = re.compile(r"\{(?:live|toctree)\}")
"""Fences that the site replaces; building the site runs them."""
PLAIN = {"text", "sh", "mermaid"}
"""Fences that no test runs: the two commands for a new machine."""


@dataclass
class Page:
    """State that the snippets of one page share."""

    folder: Path
    names: dict[str, Any] = field(default_factory=dict)


def snippets(page: Path) -> list[tuple[int, str, str]]:
    text = page.read_text(encoding="utf-8")
    return [(text[: m.start()].count("\n") + 1, m.group(1), m.group(2)) for m in FENCE.finditer(text)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_snippet_does_what_the_page_states(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    for module in (plotting, estimate_figure):  # figures are drawn; their layout has tests of its own
        monkeypatch.setattr(module, "settle", lambda figure: figure.set_layout_engine("none"))
    monkeypatch.setattr(proof, "MOST", 1)  # one of a study's settings is decided; no page prints more of it
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    shared = Page(tmp_path)
    for line, language, text in snippets(page):
        where = f"{page.relative_to(ROOT)}:{line}"
        match language:
            case "console":
                run_console(text, where)
            case "python":
                run_python(text, shared, where)
            case "yaml":
                build_yaml(text, shared)
            case _ if DIRECTIVE.match(language):
                pass
            case _:
                written(text, shared)
                assert language in PLAIN, f"{where}: expected console, python, yaml or {sorted(PLAIN)}"


def written(text: str, shared: Page) -> bool:
    named = FILE.match(text)
    if named:
        path = shared.folder / named.group(1)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return named is not None


def run_python(text: str, shared: Page, where: str) -> None:
    if not written(text, shared):
        exec(compile(text, where, "exec", dont_inherit=True), shared.names)  # a reader's own file has no __future__


def build_yaml(text: str, shared: Page) -> None:
    if any(text.startswith(begin) or f"\n{begin}" in text for begin in OTHERS):
        assert written(text, shared), "the first line of a study or a race is its file's name"
        return  # the page's next command reads it
    data = read_document(text, "snippet.yaml").data
    written(text, shared)
    if "dmframe" not in data:
        below = read_file(graphs()["ur10_fast"]).data
        data = {**below, **data, "blocks": {**below["blocks"], **data.get("blocks", {})}}
    as_text = json.dumps(data, ensure_ascii=False)  # JSON is YAML
    _ = Graph.of(read_document(as_text, str(shared.folder / "snippet.yaml"))).diagram


def run_console(text: str, where: str) -> None:
    status = 0
    for command, wanted in commands(text):
        if command == "echo $?":
            assert wanted == [str(status)], f"{where}: status {status} of the command before `$ {command}`"
            status = 0
            continue
        assert status == 0, f"{where}: status {status} before `$ {command}`"
        status, printed = run_command(command)
        if wanted:
            assert matches(wanted, printed.rstrip().splitlines()), f"{where}: `$ {command}` printed\n{printed}"
    assert status == 0, f"{where}: the last command's status is {status}"


def commands(text: str) -> list[tuple[str, list[str]]]:
    found = list[tuple[str, list[str]]]()
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif found and found[-1][0].endswith("\\") and not found[-1][1]:
            found[-1] = (found[-1][0][:-1] + line.strip(), [])
        else:
            found[-1][1].append(line)
    return found


def matches(wanted: list[str], printed: list[str]) -> bool:
    """True if the lines match, ``...`` any number of them; blanks that align columns may differ in number."""
    places = {0}  # numbers of printed lines that may be matched already
    for line in wanted:
        if line.strip() == "...":
            places = set(range(min(places, default=len(printed) + 1), len(printed) + 1))
        elif line.strip():
            shape = _line(line)
            places = {k + 1 for k in places if k < len(printed) and re.fullmatch(shape, printed[k])}
        else:
            places |= {k + 1 for k in places if k < len(printed) and not printed[k].strip()}
    return len(printed) in places


def _line(line: str) -> str:
    pieces = [r"[ ]+".join(re.escape(word) for word in re.split(" +", piece)) for piece in line.rstrip().split("...")]
    return ".*".join(pieces) + "[ ]*"


def run_command(command: str) -> tuple[int, str]:
    """`dmframe` in this process, which is faster than a new one; other commands in a shell."""
    words = shlex.split(command)
    if words[0] != "dmframe" or {"|", ">", "<", "&&"} & set(words):
        done = subprocess.run(
            ["bash", "-c", command], capture_output=True, text=True, timeout=120, check=False, stdin=subprocess.DEVNULL
        )
        return done.returncode, done.stdout + done.stderr
    printed, before = io.StringIO(), sys.argv
    sys.argv = words
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed), pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = before
    return int(end.value.code or 0), printed.getvalue()


def test_the_runner_finds_a_wrong_output() -> None:
    with pytest.raises(AssertionError, match="printed"):
        run_console("$ dmframe --version\ndmframe 99\n", "here")


def test_the_runner_finds_a_failing_command() -> None:
    with pytest.raises(AssertionError, match="status is 2"):
        run_console("$ dmframe check nosuch\n", "here")


def test_the_runner_takes_a_wanted_failure() -> None:
    run_console("$ dmframe check nosuch\ndmframe: nosuch: ...\n$ echo $?\n2\n", "here")


def test_the_runner_takes_dots_for_any_lines() -> None:
    run_console("$ dmframe graphs\n...\npendulum  ...\n...\n", "here")


def test_a_long_output_that_differs_at_its_end_is_reported_without_an_endless_search() -> None:
    lines = [f"a line with some words {k}" for k in range(400)]
    assert matches(["...", "a line with some words 399"], lines)
    assert not matches(["...", "some other line", "...", "the end"], lines)
    assert not matches(["a line with some words"], lines[:1])


def test_the_docs_are_there() -> None:
    assert len(PAGES) > 10
