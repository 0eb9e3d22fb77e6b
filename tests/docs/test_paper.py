"""The paper's table: complete, true to the blocks, and fresh."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from dmframe.catalogue import block_types, graphs

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def paper() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_paper", ROOT / "docs" / "make_paper.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_paper"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_its_script_writes(paper: ModuleType) -> None:
    text = paper.PAGE.read_text(encoding="utf-8")
    assert paper.fill(text) == text, "stale; run: python docs/make_paper.py"


def test_the_staleness_test_would_notice(paper: ModuleType) -> None:
    text = paper.PAGE.read_text(encoding="utf-8")
    assert paper.fill(text.replace("| (45) |", "| (46) |", 1)) == text


def test_every_equation_has_one_row(paper: ModuleType) -> None:
    numbered = [number for row in paper.ROWS for number in paper.numbers(row.what)]
    assert sorted(numbered) == list(range(1, 61))


def test_ranges_of_numbers_are_read_as_they_are_written(paper: ModuleType) -> None:
    assert paper.numbers("eqs. (5), (8)-(10) and (3)") == {3, 5, 8, 9, 10}
    assert paper.numbers("Theorem 4") == set()


def test_properties_theorems_and_remarks_have_rows(paper: ModuleType) -> None:
    told = {row.what for row in paper.ROWS}
    assert {f"Theorem {k}" for k in range(1, 5)} | {f"Property {k}" for k in range(1, 5)} | {
        "Remark 2",
        "Remark 5",
    } <= told


def test_a_row_without_a_source_claims_nothing(paper: ModuleType) -> None:
    open_rows = [row for row in paper.ROWS if row.says == paper.NOT_GIVEN]
    assert open_rows
    assert all(not (row.blocks or row.files or row.tests or row.graphs) for row in open_rows)


def test_what_a_block_cites_stands_in_the_row_of_that_number(paper: ModuleType) -> None:
    rows = {number: row for row in paper.ROWS for number in paper.numbers(row.what)}
    lost = [
        f"{block} cites ({number})"
        for block in paper.block_types()
        for number in sorted(paper.citations(block))
        if block not in rows[number].blocks
    ]
    assert lost == []
    assert paper.citations("pi_inverse") == {12, 14, 16}


def test_every_block_of_a_row_exists_and_every_given_row_has_one(paper: ModuleType) -> None:
    assert {block for row in paper.ROWS for block in row.blocks} <= block_types().keys()
    assert all(row.blocks or row.files for row in paper.ROWS if row.says != paper.NOT_GIVEN)


def test_files_tests_and_graphs_of_the_page_are_there(paper: ModuleType) -> None:
    for row in paper.ROWS:
        for target in (*row.files, *row.tests):
            path, _, name = target.partition("::")
            text = ROOT.joinpath(path).read_text(encoding="utf-8")
            assert not name or re.search(rf"^\s*(?:def|class) {name}\b", text, re.MULTILINE), target
        assert set(row.graphs) <= graphs().keys()


def test_every_row_that_a_block_states_has_a_graph(paper: ModuleType) -> None:
    for line, row in zip(list(paper.lines())[2:], paper.ROWS, strict=True):
        assert line.split(" | ")[-1].strip(" |") != "none yet", row.what
