"""Write docs/notation.md: the meaning of each name of a port, state, parameter or true value of the blocks.

    python docs/make_notation.py

Symbols, units, shapes and blocks come from the code; only the meaning in words and the paper's symbol are in
`notation.yaml`. ``tests/docs`` fails where the page is stale, where a name has no meaning or a meaning no name, and
where one symbol has two meanings.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from dmframe.block import AbstractBlock
from dmframe.block.parameter import specs
from dmframe.catalogue import block_types
from dmframe.common.names import distinct, unicode_name
from dmframe.common.units import compatible
from dmframe.formula.robot import CONSTANTS, SIGNS

ROOT = Path(__file__).parents[1]
PAGE, WORDS = ROOT / "docs" / "notation.md", ROOT / "docs" / "notation.yaml"
LETTERS = ("n", "m", "p", "k", "h")
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"
ANY = "*"
"""The unit of a port with several units."""
FUNCTIONS = {"norm", "clip", "beyond", "tanh", "sign", "atan", "abs", "diag", "min", "max", "S", "V", "I"}
FUNCTIONS |= {"heavy", "links", "tool", "behind", "floor", "exp", "at_time", "with_mass"}
"""Signs of a printed law that are neither a name nor a quantity of the robot."""


@dataclass(frozen=True)
class Meaning:
    """Hand-written part of a name: its meaning, the paper's symbol, and the reason for several units or meanings."""

    means: str
    paper: str = ""
    because: str = ""


@dataclass
class Entry:
    """Part of a name from the code; units, shapes and blocks in the order in which they are found."""

    name: str
    units: list[str] = field(default_factory=list)
    shapes: list[str] = field(default_factory=list)
    given_by: list[str] = field(default_factory=list)
    read_by: list[str] = field(default_factory=list)
    parameter: bool = True

    def add(self, unit: str, shape: str, block: str, *, read: bool) -> None:
        """One port, state, true value or parameter of this name."""
        known = any(unit == other or (ANY not in (unit, other) and compatible(unit, other)) for other in self.units)
        for items, item in ((self.shapes, shape), (self.read_by if read else self.given_by, block)):
            if item not in items:
                items.append(item)
        if not known:
            self.units.append(unit)


def meanings() -> dict[str, Meaning]:
    """The words, by name, in the order of the page."""
    stated: Mapping[str, Any] = YAML(typ="safe").load(WORDS.read_text(encoding="utf-8"))
    return {name: Meaning(**given) if isinstance(given, dict) else Meaning(given) for name, given in stated.items()}


def entries() -> dict[str, Entry]:
    """All names of the catalogue."""
    found = dict[str, Entry]()
    for block, kind in block_types().items():
        for items, read in ((kind.outputs, False), (kind.states, False), (kind.inputs, True), (kind.truth, True)):
            for item in items:
                entry = found.setdefault(item.name, Entry(item.name))
                entry.add(item.unit, item.shape, block, read=read)
                entry.parameter = False
        for name, spec in specs(kind).items():
            found.setdefault(name, Entry(name)).add(spec.unit, spec.shape, block, read=False)
    return found


def signs() -> set[str]:
    """What a law prints that is no port, state, parameter or true value."""
    return FUNCTIONS | set(SIGNS.values()) | set(CONSTANTS.values())


def faults(found: Mapping[str, Entry], given: Mapping[str, Meaning]) -> Iterator[str]:
    """Where the code and the words differ, and where one symbol would have two meanings."""
    yield from (f"{name} has no meaning in notation.yaml" for name in found if name not in given)
    yield from (f"{name} has a meaning, and no block has it" for name in given if name not in found)
    yield from (f"{one} and {other} print alike" for one, other in distinct(sorted(found.keys() | signs())))
    calls = dict[str, str]()
    for name, meaning in given.items():
        first = calls.setdefault(meaning.paper or name, name)
        if first != name:
            yield f"the paper calls {first} and {name} alike"
    for name in sorted(found.keys() & given.keys()):
        yield from _meant_twice(found[name], given[name])


def _meant_twice(entry: Entry, meaning: Meaning) -> Iterator[str]:
    several = {
        f"units: {', '.join(unit or '-' for unit in entry.units)}": len(entry.units) > 1,
        "meanings": ";" in meaning.means,
        "kinds: a sign in print too": entry.name in signs(),
    }
    letters = {word for shape in entry.shapes for word in shape.split()}
    if entry.name in letters | set(LETTERS):
        yield f"{entry.name} is the letter of a size too"
    if not any(several.values()) and meaning.because:
        yield f"{entry.name}: a reason is given, but it has one unit and meaning"
    if not meaning.because:
        unexplained = [which for which, true in several.items() if true]
        yield from (f"{entry.name} has several {which}, without a reason" for which in unexplained)


def clashes(kind: type[AbstractBlock], found: Mapping[str, Entry]) -> Iterator[str]:
    """Names of a block's options and of parts of its law with another meaning in the table."""
    own = {port.name for port in kind.outputs}
    options = kind.model_fields.keys() - specs(kind).keys()
    yield from (f"the option {name} is a name too" for name in sorted(options & found.keys()))
    for name in dict.fromkeys(re.findall(r'\bnamed\(\s*"(\w+)"', inspect.getsource(kind))):
        others = found.keys() | signs()
        if name not in own and (name in others or any(name in pair for pair in distinct(sorted({name, *others})))):
            yield f"a part of the law is called {name}, and so is another quantity"


def lines() -> Iterator[str]:
    """Both tables."""
    given, found = meanings(), entries()
    for title, parameters in (("Signals, states and true values", False), ("Parameters", True)):
        ends = ["blocks"] if parameters else ["given by", "read by"]
        head = ["symbol", "name", "unit", "shape", "meaning", "in the paper", *ends]
        yield from (f"## {title}", "", _row(head), "|" + "---|" * len(head))
        for name, meaning in given.items():
            if name in found and found[name].parameter == parameters:
                yield _row(_cells(found[name], meaning))
        yield ""
    yield from ("## Names with several units or meanings", "")
    yield from (f"- `{name}`: {meaning.because}" for name, meaning in given.items() if meaning.because)


def _cells(entry: Entry, meaning: Meaning) -> list[str]:
    ends = [entry.given_by] if entry.parameter else [entry.given_by, entry.read_by]
    units, shapes = ("; ".join(item or "-" for item in items) for items in (entry.units, entry.shapes))
    blocks = [", ".join(f"`{block}`" for block in sorted(end)) for end in ends]
    return [unicode_name(entry.name), f"`{entry.name}`", units, shapes, meaning.means, meaning.paper, *blocks]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |"


def fill(page: str) -> str:
    """The page with its tables put in."""
    before, _, rest = page.partition(BEGIN)
    return "\n".join([before + BEGIN, "", *lines(), "", END]) + rest.partition(END)[2]


if __name__ == "__main__":
    if wrong := list(faults(entries(), meanings())):
        sys.exit("\n".join(wrong))
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
