"""The paper's table: complete, in agreement with the blocks, and up to date."""

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
    sys.modules["make_paper"] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_its_script_writes(paper: ModuleType) -> None:
    text = paper.PAGE.read_text(encoding="utf-8")
    assert paper.fill(text) == text, "stale; run: python docs/make_paper.py"


def test_the_staleness_test_would_notice(paper: ModuleType) -> None:
    text = paper.PAGE.read_text(encoding="utf-8")
    assert paper.fill(text.replace("| (45) |", "| (46) |", 1)) == text


def test_every_equation_has_a_row_of_its_own(paper: ModuleType) -> None:
    assert [row.number for row in paper.rows() if row.number[0] == "("] == [f"({k})" for k in range(1, 61)]


def test_ranges_of_numbers_are_read_as_they_are_written(paper: ModuleType) -> None:
    assert paper.numbers("eqs. (5), (8)-(10) and (3)") == {3, 5, 8, 9, 10}
    assert paper.numbers("Theorem 4") == set()


def test_properties_theorems_remarks_and_assumptions_have_rows(paper: ModuleType) -> None:
    numbers = [row.number for row in paper.rows()]
    assert len(numbers) == len(set(numbers))
    wanted = {f"Theorem {k}" for k in range(1, 5)} | {f"Property {k}" for k in range(1, 5)}
    wanted |= {f"Remark {k}" for k in (1, 2, 3, 4, 6)} | {"Remark 5, 1)", "(44)", "Section V"}
    wanted |= {"Assumption: the task", "Assumption: K_I_hat > 0", "Assumption: J_hat", "Section IV-A, last remark"}
    assert wanted <= set(numbers)


def test_a_row_states_where_it_is_or_why_it_is_nowhere(paper: ModuleType) -> None:
    unused = [row for row in paper.rows() if row.unused]
    assert [row.number for row in unused] == ["Remark 4"]  # of laws from other papers
    for row in paper.rows():
        assert len(row.states) > 8, row.number
        assert not re.search(r"not (given|used)|TODO|\?\?", row.states), row.number
        stated = bool(row.blocks or row.files or row.docs)
        assert stated == (not row.unused), row.number
    assert "none yet" not in "\n".join(paper.lines())


def test_errata_name_what_was_found_and_a_test_of_it(paper: ModuleType) -> None:
    errata = paper.PAGE.read_text(encoding="utf-8").partition("## Errata")[2].partition("\n## ")[0]
    rows = [line for line in errata.splitlines() if line.startswith("| ")][1:]
    assert [line.split(" | ")[0].strip("| ") for line in rows] == ["Section IV-A, last remark"]
    assert all("](../tests/blocks/test_" in line for line in rows)
    found = [row.number for row in paper.rows() if "*Erratum*" in row.states]
    assert found == ["Section IV-A, last remark"]


def test_a_deviation_of_a_damaged_copy_is_not_called_an_erratum(paper: ModuleType) -> None:
    text = paper.PAGE.read_text(encoding="utf-8")
    readings = text.partition("## Readings of our copy")[2].partition("\n## ")[0]
    assert "| (41) |" in readings
    assert "| (41) |" not in text.partition("## Errata")[2].partition("\n## ")[0]


def test_the_row_of_a_number_lists_the_blocks_that_cite_it(paper: ModuleType) -> None:
    rows = {number: row for row in paper.rows() for number in paper.numbers(row.number)}
    lost = [
        f"{block} cites ({number})"
        for block in paper.block_types()
        for number in sorted(paper.citations(block))
        if block not in rows[number].blocks
    ]
    assert lost == []
    assert paper.citations("pi_inverse") == {12, 14, 16}


def test_every_block_of_a_row_exists(paper: ModuleType) -> None:
    assert {block for row in paper.rows() for block in row.blocks} <= block_types().keys()


def test_files_tests_and_graphs_of_the_page_are_there(paper: ModuleType) -> None:
    for row in paper.rows():
        for target in (*row.files, *row.tests, *(f"docs/{page}" for page in row.docs)):
            path, _, name = target.partition("::")
            text = ROOT.joinpath(path).read_text(encoding="utf-8")
            assert not name or re.search(rf"^\s*(?:def|class) {name}\b", text, re.MULTILINE), target
        assert set(row.graphs) <= graphs().keys()
