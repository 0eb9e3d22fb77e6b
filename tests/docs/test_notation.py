"""The tables of notation: generated from the code, complete, and with one meaning for each symbol."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.naming import named
from dmframe.block.port import Input, Output
from dmframe.catalogue import block_types

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def notation() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_notation", ROOT / "docs" / "make_notation.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_notation"] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_its_script_writes(notation: ModuleType) -> None:
    text = notation.PAGE.read_text(encoding="utf-8")
    assert notation.fill(text) == text, "stale; run: python docs/make_notation.py"


def test_every_name_has_one_meaning_and_every_meaning_a_name(notation: ModuleType) -> None:
    assert list(notation.faults(notation.entries(), notation.meanings())) == []


@pytest.mark.parametrize("block", block_types().values(), ids=list(block_types()))
def test_options_and_parts_of_a_law_take_no_name_of_another_thing(
    notation: ModuleType, block: type[AbstractBlock]
) -> None:
    assert list(notation.clashes(block, notation.entries())) == []


def test_every_port_and_state_has_a_row_of_the_page_with_its_unit(notation: ModuleType) -> None:
    rows = {cells[1]: cells for line in notation.lines() if len(cells := line.split(" | ")) > 5}
    items = [item for kind in block_types().values() for item in (*kind.inputs, *kind.outputs, *kind.states)]
    compact = {(item.name, item.unit or "-") for item in items if not re.search(r"[/*^]", item.unit)}
    assert len(compact) > 30
    assert [pair for pair in compact if pair[1] not in rows[f"`{pair[0]}`"][2].split("; ")] == []


def test_every_meaning_is_in_words(notation: ModuleType) -> None:
    assert [name for name, reported in notation.meanings().items() if not re.search(r"[a-z]{2}", reported.means)] == []


def _set(name: str, **changes: str) -> Callable[[Any, Any], None]:
    def change(found: Any, reported: Any) -> None:
        reported[name] = replace(reported[name], **changes)

    return change


def _second(name: str, like: str) -> Callable[[Any, Any], None]:
    def change(found: Any, reported: Any) -> None:
        found[name], reported[name] = replace(found[like], name=name), replace(reported[like], because="")

    return change


FAULTS: dict[str, tuple[Callable[[Any, Any], Any], str]] = {
    "no meaning": (lambda _, reported: reported.pop("u"), "u has no meaning in notation.yaml"),
    "no name": (lambda found, _: found.pop("u"), "u has a meaning, and no block has it"),
    "two units": (lambda found, _: found["u"].units.append("A"), "u has several units: V, A, without a reason"),
    "no reason": (_set("K_P", because=""), "K_P has several meanings, without a reason"),
    "two meanings": (_set("u", means="voltage; control"), "u has several meanings, without a reason"),
    "needless reason": (_set("u", because="it may"), "u: a reason is given, but it has one unit and meaning"),
    "alike in print": (_second("K1", "K_1"), "K1 and K_1 print alike"),
    "a function's name": (_second("clip", "u"), "clip has several kinds: a sign in print too, without a reason"),
    "a size's letter": (_second("k", "u"), "k is the letter of a size too"),
    "alike in the paper": (_set("u", paper="Gamma_d"), "the paper calls u and Gamma alike"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_reported(notation: ModuleType, case: str) -> None:
    change, text = FAULTS[case]
    found, reported = deepcopy(notation.entries()), notation.meanings()
    change(found, reported)
    assert text in list(notation.faults(found, reported))


class Confused(AbstractBlock):
    """An option and a part of the law with names that others have."""

    inputs = (Input("u", "n", "V"),)
    outputs = (Output("y", "n", "V"),)

    direct: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """A law."""
        return Equations(outputs={"y": named("w", u.u) + named("K1", u.u) + named("fresh", u.u) + named("y", u.u)})


def test_a_confused_block_is_reported(notation: ModuleType) -> None:
    assert list(notation.clashes(Confused, notation.entries())) == [
        "the option direct is a name too",
        "a part of the law is called w, and so is another quantity",
        "a part of the law is called K1, and so is another quantity",
    ]
