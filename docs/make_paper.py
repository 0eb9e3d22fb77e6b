"""Fill the table of docs/paper.md: each numbered equation, property, theorem, remark -> block or file -> test -> graph.

    python docs/make_paper.py

The statement of each equation and its blocks are in `paper_rows.yaml`; tests and graphs that are missing there are
looked up. ``tests/docs`` fails if the page is stale, if a block cites an equation and is missing in its row, and if
a row names a block, file, test or graph that does not exist.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PAGE, TABLE = ROOT / "docs" / "paper.md", ROOT / "docs" / "paper_rows.yaml"
BLOCKS, GRAPHS, TESTS = (ROOT / part for part in ("blocks/dmframe_blocks", "blocks/dmframe_blocks/graphs", "tests"))
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
KNOWN_ANSWERS = "tests/blocks/test_known_answers.py"


SHORT = {"E": "tests/blocks/test_paper_equations.py", "T": "tests/blocks/test_theorems.py"}


@dataclass(frozen=True)
class Row:
    """A row of the paper's table; files, tests and docs are ``path`` or ``path::name``, docs below `docs/`."""

    number: str
    states: str
    blocks: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    graphs: tuple[str, ...] = ()
    docs: tuple[str, ...] = ()
    unused: str = ""


def rows() -> tuple[Row, ...]:
    """The table's data, in the order of the paper."""
    stated = YAML(typ="safe").load(TABLE.read_text(encoding="utf-8"))
    return tuple(Row(**{key: _value(key, value) for key, value in row.items()}) for row in stated)


def _value(key: str, value: Any) -> Any:
    if not isinstance(value, list):
        return value
    return tuple(re.sub(r"^([A-Z])::", lambda m: f"{SHORT[m[1]]}::", item) for item in value)


def block_types() -> list[str]:
    """Every packaged block, by the name of its file."""
    return sorted(path.stem for path in BLOCKS.glob("*.py") if not path.stem.startswith("_"))


def citations(block: str) -> set[int]:
    """The equation numbers of the paper that a block's page cites."""
    text = (BLOCKS / f"{block}.py").read_text(encoding="utf-8")
    page = re.search(r"\[WangTAC2020\]_ (.*?)\n *\"\"\"", text, re.DOTALL)
    return numbers(page[1]) if page else set()


def numbers(text: str) -> set[int]:
    """``(5), (8)-(10)`` -> 5, 8, 9, 10."""
    found = set[int]()
    for first, last in re.findall(r"\((\d+)\)(?:\s*-\s*\((\d+)\))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def graphs_of(blocks: Sequence[str]) -> list[str]:
    """Packaged graphs that contain all these blocks; without one, those that contain the first."""
    used = {
        path.stem: set(re.findall(r"type: (\w+)", path.read_text(encoding="utf-8"))) for path in GRAPHS.glob("*.yaml")
    }
    for wanted in (set(blocks), set(blocks[:1])):
        found = sorted((name for name, types in used.items() if wanted <= types), key=_rank)
        if found:
            return found[:2]
    return []


def _rank(name: str) -> tuple[bool, bool, str]:
    return not name.startswith("theorem"), not re.search(r"_(tracking|regulation)_", name), name


def tests_of(row: Row) -> list[str]:
    """For each block a test that names it, first a known answer."""
    return list(dict.fromkeys(test for block in row.blocks if (test := _test_of(block))))


def _test_of(block: str) -> str:
    named = [test for test, texts in _tests().items() if any(re.search(rf"\b{block}\b", text) for text in texts)]
    return min(named, key=lambda test: not test.startswith(KNOWN_ANSWERS), default="")


_FOUND = dict[str, list[str]]()


def _tests() -> Mapping[str, list[str]]:
    """Each test of `tests/blocks`, as ``path::name``, with the texts in its body."""
    if not _FOUND:
        for path in sorted(TESTS.joinpath("blocks").glob("test_*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                    texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
                    _FOUND[f"{path.relative_to(ROOT).as_posix()}::{node.name}"] = [
                        t for t in texts if isinstance(t, str)
                    ]
    return _FOUND


def _link(target: str) -> str:
    path, _, name = target.partition("::")
    shown = name or path.rpartition("/")[2]
    return f"[`{shown}`](../{path})" if not path.startswith("docs/") else f"[`{shown}`]({path.removeprefix('docs/')})"


def lines() -> Iterator[str]:
    """The table."""
    yield "| number | statement | block, file, page | test | graph |"
    yield "|---|---|---|---|---|"
    for row in rows():
        where = [_link(f"blocks/dmframe_blocks/{block}.py::{block}") for block in row.blocks]
        where += [_link(file) for file in (*row.files, *(f"docs/{page}" for page in row.docs))]
        tests = [_link(test) for test in row.tests or tests_of(row)]
        graphs = [f"`{name}`" for name in row.graphs or (graphs_of(row.blocks) if row.blocks else [])]
        missing = "-" if row.unused else "none yet"
        cells = [row.unused or ", ".join(where) or missing, *(", ".join(cell) or missing for cell in (tests, graphs))]
        yield "| " + " | ".join([row.number, row.states.replace("|", "\\|"), *cells]) + " |"


def fill(page: str) -> str:
    """The page with its table put in."""
    before, _, rest = page.partition(BEGIN)
    return "\n".join([before + BEGIN, *lines(), END]) + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
