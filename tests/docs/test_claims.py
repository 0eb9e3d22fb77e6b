"""Claims with the status `tested` in CLAIMS.md are tested by `make test`, unless the row names `make thorough`."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import pytest

CLAIMS = Path(__file__).parents[2] / "CLAIMS.md"
THOROUGH = "in `make thorough`"


def unshown(rows: Sequence[str], tests: Collection[str]) -> list[str]:
    """Files and tests of rows with status ``tested`` that are not among the node ids `tests`."""
    names = {name.partition("[")[0] for name in tests}
    known = names | {name.partition("::")[0] for name in names}
    found = list[str]()
    for row in rows:
        *_, shown, status = (cell.strip() for cell in row.strip().strip("|").split(" | "))
        cited = [item for item in re.findall(r"`(tests/[^`]+\.py[^`]*)`", shown) if "benchmarks" not in item]
        if status.startswith("tested") and THOROUGH not in status:
            found += [item for item in cited if item not in known]
        elif status.startswith("tested;") and cited and not known.intersection(cited):
            found.append(", ".join(cited))
    return found


def test_make_test_shows_what_is_called_tested(request: pytest.FixtureRequest) -> None:
    if request.config.args != request.config.getini("testpaths"):
        pytest.skip("only a collection of all tests shows what is missing")
    rows = [line for line in CLAIMS.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][1:]
    assert unshown(rows, [item.nodeid for item in request.session.items]) == []


@pytest.mark.parametrize(
    ("row", "missing"),
    [
        ("| it holds | `tests/a.py::test_it` | tested |", []),
        ("| it holds | `tests/a.py`, `make mutants` | by command; a sample tested |", []),
        ("| it holds | `tests/b.py` | tested |", ["tests/b.py"]),
        ("| it holds | `tests/a.py`, `tests/b.py` | tested |", ["tests/b.py"]),
        ("| it holds | `tests/a.py::test_other` | tested where they are installed |", ["tests/a.py::test_other"]),
        ("| it holds | `tests/b.py` | tested in `make thorough` |", []),
        ("| it holds | `tests/a.py`, `tests/b.py` | tested; the second in `make thorough` |", []),
        ("| it holds | `tests/b.py` | tested; most in `make thorough` |", ["tests/b.py"]),
    ],
)
def test_a_claim_without_a_test_is_found(row: str, missing: list[str]) -> None:
    assert unshown([row], ["tests/a.py::test_it[1-x]"]) == missing
