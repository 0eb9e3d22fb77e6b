"""The two drawings of docs/explanation/how_it_works.md, compared with the calls of a proof and of a run."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.catalogue import graphs
from tests.page_code import page_file

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "explanation" / "how_it_works.md"
PACKAGE = Path(dm.__file__).parent
FILE = re.compile(r"(?:[\w.]+/)*[\w.]+\.py|\w+/(?=[,\s]|$)")


def drawings() -> list[list[tuple[bool, list[str]]]]:
    """Rows of each drawing: whether it is a separate step, and its files; a name without a folder has the last one."""
    text = PAGE.read_text(encoding="utf-8")
    found = []
    for drawing in re.findall(r"^```text\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        rows = list[tuple[bool, list[str]]]()
        for line in drawing.splitlines():
            files, folder = list[str](), ""
            for name in FILE.findall(line):
                folder, _, _ = name.rpartition("/") if "/" in name else (folder, "", "")
                files.append(name if "/" in name else f"{folder}/{name}")
            if files:
                rows.append((not line.lstrip().startswith("|"), files))
        found.append(rows)
    return found


PROOF, LOOP = drawings()


def calls(work: Callable[[], Any]) -> list[str]:
    """Files of dmframe in the order of the calls into them, without calls during imports."""
    found, importing, above = list[str](), 0, f"{PACKAGE}/"

    def profile(frame: Any, event: str, _: Any) -> None:
        nonlocal importing
        code = frame.f_code
        if code.co_name == "<module>":
            importing += (event == "call") - (event == "return")
        elif event == "call" and not importing and code.co_filename.startswith(above):
            name = code.co_filename.removeprefix(above)
            if not found or found[-1] != name:
                found.append(name)

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return found


def matching(files: list[str], called: list[str]) -> Iterator[int]:
    """Places of the calls into these files or folders."""
    return (k for k, name in enumerate(called) if any(name == file or name.startswith(file) for file in files))


@pytest.fixture(scope="module")
def proof() -> list[str]:
    graph = dm.load("pendulum")
    return calls(graph.verify)


def test_every_file_of_the_drawings_exists() -> None:
    files = [file for rows in (PROOF, LOOP) for _, files in rows for file in files]
    assert len(files) > 60
    places = [(ROOT if file == "blocks/" else PACKAGE) / file for file in files]
    assert [str(place) for place in places if not (place.exists() or place.with_suffix(".py").exists())] == []


def first_calls(rows: list[tuple[bool, list[str]]], called: list[str]) -> list[int]:
    """Place of the first call into each step's first file, except for the verifier's, which calls all others."""
    steps = [files[0] for step, files in rows if step and files[0].startswith(("certify/", "prove/"))]
    return [next(matching([file], called)) for file in steps if file != "certify/verifier.py"]


def test_a_proof_enters_the_steps_of_the_drawing_in_its_order(proof: list[str]) -> None:
    first = first_calls(PROOF, proof)
    assert len(first) == 5
    assert first == sorted(first)
    steps = [row for row in PROOF if row[0]]
    for k in range(1, len(first)):  # a drawing with two steps in the other order is detected
        swapped = first_calls([*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]], proof)
        assert swapped != sorted(swapped)


def test_a_proof_enters_every_file_of_the_drawing(proof: list[str]) -> None:
    refuted = {"prove/reals.py", "prove/refute.py"}
    by_the_command = {"remembered/recorder.py", "remembered/store.py", "remembered/front.py", "report/", "cli/"}
    data_alone = {"certify/verdict.py"}
    drawn = {file for _, files in PROOF for file in files} - {"blocks/"} - refuted - by_the_command - data_alone
    assert {file for file in drawn if not any(matching([file], proof))} == set()


def test_a_refutation_takes_the_branch_of_the_drawing(tmp_path: Path, proof: list[str]) -> None:
    right = page_file("docs/tutorial/first_block.md", "damping.py")
    (tmp_path / "damping.py").write_text(right.replace("-p.k * x.y", "p.k * x.y"), encoding="utf-8")
    text = graphs()["pendulum"].read_text(encoding="utf-8").rstrip()
    block = 'damping: {type: "damping.py:Damping", beta: 2, k: 5}'
    (tmp_path / "damped.yaml").write_text(f"{text}\n  {block}\n", encoding="utf-8")
    graph = dm.load(tmp_path / "damped.yaml")
    called = calls(lambda: graph.verify().outcome)
    assert graph.verify().outcome == "refuted"
    (branch,) = (
        [file for file in files if file.startswith("prove/")] for _, files in PROOF if "prove/reals.py" in files
    )
    first = [next(matching([file], called)) for file in ("prove/identity.py", *branch)]
    assert first == sorted(first)
    assert not any(matching(branch, proof))


def test_every_module_that_the_verifier_calls_is_on_the_page() -> None:
    source = (PACKAGE / "certify" / "verifier.py").read_text(encoding="utf-8")
    modules = re.findall(r"^from dmframe\.((?:certify|prove)\.\w+) import", source, re.MULTILINE)
    assert len(modules) > 20
    page = PAGE.read_text(encoding="utf-8")
    files = {file for _, files in PROOF for file in files} | set(re.findall(r"\w+/\w+\.py", page))
    assert {f"{module.replace('.', '/')}.py" for module in modules} - files == set()


def test_a_run_passes_the_steps_of_the_drawing_in_its_order() -> None:
    called = calls(lambda: dm.load("arm2_joint").run("0.1 s", engine="compiled", progress=False))
    place = -1
    for files in (files for step, files in LOOP if step):
        place = next((k for k in matching(files, called) if k > place), -1)
        assert place >= 0, files
