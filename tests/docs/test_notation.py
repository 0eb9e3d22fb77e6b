"""The table of notation against every port, state and parameter of every registered block."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dmframe.block import AbstractBlock
from dmframe.catalogue import block_types
from dmframe.parameter import specs
from dmframe.units import compatible

PAGE = Path(__file__).parents[2] / "docs" / "notation.md"
BLOCKS = block_types()


def rows() -> dict[str, list[tuple[set[str], set[str], str]]]:
    """Name -> (units, shapes, meaning) of each row of the tables; one name may stand in both."""
    found = dict[str, list[tuple[set[str], set[str], str]]]()
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and len(cells) == 5 and cells[1].startswith("`"):
            units, shapes = ({"" if part == "-" else part for part in cell.split("; ")} for cell in cells[2:4])
            found.setdefault(cells[1].strip("`"), []).append((units, shapes, cells[4]))
    return found


def known(name: str, unit: str, shape: str) -> bool:
    return any(
        any(compatible(unit, told) for told in units) and shape.removeprefix("* ") in shapes
        for units, shapes, _ in rows().get(name, [])
    )


@pytest.mark.parametrize("block", BLOCKS.values(), ids=list(BLOCKS))
def test_every_port_and_state_stands_in_the_table_with_its_unit_and_shape(block: type[AbstractBlock]) -> None:
    items = [*block.inputs, *block.outputs, *block.states, *block.truth]
    missing = [
        f"{item.name} [{item.unit}] ({item.shape})" for item in items if not known(item.name, item.unit, item.shape)
    ]
    assert missing == []


@pytest.mark.parametrize("block", BLOCKS.values(), ids=list(BLOCKS))
def test_every_parameter_stands_in_the_table_with_its_unit_and_shape(block: type[AbstractBlock]) -> None:
    missing = [
        f"{name} [{spec.unit}] ({spec.shape})"
        for name, spec in specs(block).items()
        if not known(name, spec.unit, spec.shape)
    ]
    assert missing == []


def test_the_table_has_no_name_that_no_block_uses() -> None:
    used = {
        name
        for block in BLOCKS.values()
        for name in [*(i.name for i in (*block.inputs, *block.outputs, *block.states, *block.truth)), *specs(block)]
    }
    assert sorted(rows().keys() - used) == []


def test_every_row_says_what_it_means() -> None:
    assert all(re.search(r"[a-z]{2}", meaning) for told in rows().values() for _, _, meaning in told)
