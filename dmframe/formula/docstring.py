r"""The law that a block's docstring carries, held to the code: every displayed equation is evaluated and compared.

An equation's left side is an output, the rate of a state, S, :math:`\dot S`, or a new name that others use; a name
may also be defined in the text, ``:math:`e = q - q_r```. Where an option changes the law, the docstring may state the
laws of several options: each has to hold for one, and each output and rate that is stated at all for the defaults.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block import AbstractBlock
from dmframe.errors import BlockError
from dmframe.formula.alone import read_type, switched
from dmframe.formula.latex import Numbers, UnreadableLatexError, evaluate, name_in, said, tokens
from dmframe.formula.laws import POINTS, ReadBlock
from dmframe.formula.names import Symbol, symbol
from dmframe.formula.reading import differs
from dmframe.formula.robot import CONSTANTS, SIGNS

_DISPLAYED: Final = re.compile(r"^([ \t]*)\.\. math::[ \t]*(.*)$")
_INLINE: Final = re.compile(r":math:`([^`]*)`", re.DOTALL)
_TAG: Final = re.compile(r"\\tag\{[^}]*\}")


@final
@dataclass(frozen=True)
class Stated:
    """An equation of a docstring: its sides as words, and the line of its file."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    line: int
    displayed: bool
    source: str


def check_docstring(block: type[AbstractBlock]) -> list[BlockError]:
    """What the docstring of a block says that its code does not compute; each with file and line."""
    return list(_checked(block))


@functools.lru_cache(maxsize=256)
def _checked(block: type[AbstractBlock]) -> tuple[BlockError, ...]:
    equations = list(equations_of(block))
    if not any(item.displayed for item in equations):
        return ()
    file = Path(inspect.getsourcefile(block) or block.__name__).name
    return tuple(BlockError(f"{file}:{line}: {text}") for line, text in _Checker(block, equations).faults())


def equations_of(block: type[AbstractBlock]) -> Iterator[Stated]:
    """All equations of a docstring, displayed and in the text, in the order of the file."""
    text = block.__dict__.get("__doc__") or ""
    first = _first_line(block)
    lines = text.split("\n")
    place = 0
    while place < len(lines):
        head = _DISPLAYED.match(lines[place])
        if head is None:
            place += 1
            continue
        start, indent = place + 1, len(head[1])
        place += 1
        while place < len(lines) and (not lines[place].strip() or len(lines[place]) - len(lines[place].lstrip()) > indent):
            place += 1
        body = [(first + number, lines[number]) for number in range(start, place)]
        if head[2].strip():
            body.insert(0, (first + start - 1, head[2]))
        yield from _rows(body)
    for found in _INLINE.finditer(text):
        line = first + text[: found.start()].count("\n")
        for words, source in _parts(found[1]):
            yield from _equation(words, line, displayed=False, source=source)


def _first_line(block: type[AbstractBlock]) -> int:
    """The line on which the docstring begins."""
    lines, start = inspect.getsourcelines(block)
    return start + next((number for number, text in enumerate(lines) if '"""' in text), 0)


def _rows(body: Sequence[tuple[int, str]]) -> Iterator[Stated]:
    r"""Equations of a displayed group: rows end with ``\\`` or a blank line; one without a left side goes on."""
    rows: list[tuple[int, str]] = []
    fresh = True
    for line, text in body:
        bare = _TAG.sub("", text)
        if not bare.strip():
            fresh = True
            continue
        if fresh:
            rows.append((line, ""))
        pieces = _row_ends(bare)
        for number, piece in enumerate(pieces):
            if number:
                rows.append((line, ""))
            rows[-1] = (rows[-1][0] if rows[-1][1].strip() else line, rows[-1][1] + " " + piece)
        fresh = False
    joined = list[tuple[int, str]]()
    for line, row in (row for row in rows if row[1].strip()):
        left = row.partition("&")[0]
        if joined and "&" in row and not left.strip() and "=" not in row:
            joined[-1] = (joined[-1][0], joined[-1][1] + " " + row)
        else:
            joined.append((line, row))
    for line, row in joined:
        for words, source in _parts(row):
            yield from _equation(words, line, displayed=True, source=source)


def _row_ends(text: str) -> list[str]:
    r"""Split at ``\\`` outside of environments."""
    pieces, depth, start = list[str](), 0, 0
    for found in re.finditer(r"\\begin\{|\\end\{|\\\\", text):
        if found[0] == r"\\":
            if depth == 0:
                pieces.append(text[start : found.start()])
                start = found.end()
        else:
            depth += 1 if "begin" in found[0] else -1
    return [*pieces, text[start:]]


def _parts(text: str) -> Iterator[tuple[list[str], str]]:
    """Equations that stand side by side, apart by commas."""
    words, depth, part = tokens(_TAG.sub("", text)), 0, list[str]()
    for word in [*words, ","]:
        depth += {"(": 1, "{": 1, "[": 1, ")": -1, "}": -1, "]": -1}.get(word, 0)
        if word in (",", ";") and depth == 0:
            if part:
                yield part, " ".join(part)
            part = []
        else:
            part.append(word)


def _equation(words: list[str], line: int, *, displayed: bool, source: str) -> Iterator[Stated]:
    """One equation, or a chain a = b = c as two."""
    sides: list[list[str]] = [[]]
    depth = 0
    for word in words:
        depth += {"(": 1, "{": 1, ")": -1, "}": -1}.get(word, 0)
        if word == "=" and depth == 0:
            sides.append([])
        else:
            sides[-1].append(word)
    if len(sides) == 1:
        if displayed:
            yield Stated((), tuple(sides[0]), line, displayed, source)
        return
    for right in sides[1:]:
        yield Stated(tuple(sides[0]), tuple(right), line, displayed, source)


@final
class _Config:
    """A block with some options, in numbers at random points."""

    def __init__(self, read: ReadBlock) -> None:
        self.read = read
        self.points = [_point(read, seed) for seed in range(POINTS)]


@final
@dataclass(frozen=True)
class _Point:
    """Numbers of names, of rates and of energies, at one point; and the robot's functions there."""

    names: Mapping[Symbol, Numbers]
    rates: Mapping[Symbol, Numbers]
    computed: frozenset[Symbol]
    """Names whose numbers the code computes, so that an equation can be held to them."""
    robot: Any


def _point(read: ReadBlock, seed: int) -> _Point:
    """All that a docstring of this block may name."""
    values = read.reading.values(read.signs, seed)
    names = {symbol(name): np.atleast_2d(np.asarray(value)) for name, value in values.items() if isinstance(name, str)}
    names |= {symbol(CONSTANTS[name]): names[symbol(CONSTANTS[name])] for name in CONSTANTS if CONSTANTS[name] in values}
    names |= {symbol(name): np.zeros(read.model.inputs[name].shape) for name in read.reading.zero}
    definitions = read.signs.naming.definitions
    defined = read.reading.of_signs(read.signs, [expression for _, expression in definitions.values()]).at(values)
    outputs, rates = read.model.equations.outputs, read.model.equations.rates
    run = read.reading.of_running().at(values)
    made = {symbol(name): value for name, value in zip([*definitions, *outputs], [*defined, *run], strict=False)}
    energy = _energies(read, values)
    rate = {symbol(name): value for name, value in zip(rates, run[len(outputs) :], strict=True)}
    rate |= {Symbol("S"): energy[1]} if energy else {}
    made |= {Symbol("S"): energy[0]} if energy else {}
    known = {key for key, value in made.items() if key not in names}
    return _Point({**made, **names, **{k: v for k, v in made.items() if k in known}}, rate, frozenset(known), read)


def _energies(read: ReadBlock, values: Mapping[str, Any]) -> tuple[Numbers, Numbers] | None:
    """S and what the certificate claims of its rate."""
    stated = read.scalars
    if not stated.storage and not stated.dissipation:
        return None
    signs = read.scalar_signs
    storage = sum((ca.SX(term.value) for term in stated.storage), ca.SX(0)) / 2
    claim = ca.SX(stated.supply) - sum((ca.SX(term.value) for term in stated.dissipation), ca.SX(0))
    claim += sum((ca.SX(term.value) for term in stated.excess), ca.SX(0))
    if stated.consumes is not None:
        claim += stated.consumes.value
    first, second = read.reading.of_signs(signs, [storage, claim]).at(values)
    return first, second


@final
class _Checker:
    """One block's docstring against its code, with the options in which each equation holds."""

    def __init__(self, block: type[AbstractBlock], equations: Sequence[Stated]) -> None:
        self.block, self.equations = block, equations

    def configs(self) -> Iterator[_Config]:
        """The block with its options at their defaults, then one by one."""
        plain = read_type(self.block)
        if plain is not None:
            yield _Config(plain)
        for _, values in switched(self.block):
            read = read_type(self.block, **values)
            if read is not None:
                yield _Config(read)

    def faults(self) -> Iterator[tuple[int, str]]:
        """Lines and what is wrong there."""
        open_equations = [item for item in self.equations]
        told = dict[Stated, str]()
        stated, holding, first = set[Any](), set[Any](), True
        for config in self.configs():
            for item in list(open_equations):
                verdict = _Try(config, self.equations).of(item)
                if first and verdict.key is not None:
                    stated.add(verdict.key)
                    if verdict.holds:
                        holding.add(verdict.key)
                if verdict.holds:
                    open_equations.remove(item)
                else:
                    told[item] = verdict.text if item not in told or verdict.differs else told[item]
            if first:
                self._missing = {key: text for key, text in ((k, k) for k in stated - holding)}
            first = False
            if not open_equations:
                break
        if first:
            return  # a block that cannot stand without a graph is checked where it stands in one
        for item in self.equations:
            if item in open_equations and told.get(item):
                yield item.line, told[item]
