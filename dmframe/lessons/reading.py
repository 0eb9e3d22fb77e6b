"""A lesson as plain text for a terminal: formulas in Unicode, cells indented, without solutions."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from typing import Final

from dmframe.common.columns import columns
from dmframe.common.names import LETTERS
from dmframe.formula.latex import in_unicode
from dmframe.lessons.lesson import Lesson, Piece
from dmframe.lessons.notebook import LINK, unlinked

_DISPLAYED: Final = re.compile(r"\$\$(.*?)\$\$", re.DOTALL)
_MARKED: Final = re.compile(r"(\$[^$]+\$|`[^`]+`)")
_BRACED: Final = r"\{((?:[^{}]|\{[^{}]*\})*)\}"
_EMPHASIS: Final = re.compile(r"(?<![\w*])(\*{1,2})(?=\S)(.+?)(?<=\S)\1(?![\w*])", re.DOTALL)
_ITEM: Final = re.compile(r"(?:[-*]|\d+\.) ")
_BLANK: Final = re.compile(r"\n\s*\n")
_DEEP: Final = "    "
_HALVES: Final = {"12": "½", "14": "¼", "34": "¾", "13": "⅓", "32": "3/2"}
_WORDS: Final = ("sin", "cos", "tan", "tanh", "arctan", "exp", "log", "max", "min")
_SIGNS: Final = {word: f"{word} " for word in _WORDS} | dict(
    pair.split(":")
    for pair in (
        "int:∫ oint:∮ sum:Σ partial:∂ nabla:∇ infty:∞ times:× circ:° dots:… ldots:… cdots:… sim:~ approx:≈ ne:≠ in:∈ "
        "ell:ℓ"
    ).split()
)
"""LaTeX commands of lessons, in addition to those of laws."""
_FIRST: Final = 0xE000
"""First of the private-use letters that temporarily replace words in a formula."""


def readable(lesson: Lesson, wide: int) -> str:
    """The lesson in lines of at most `wide` characters; code and long formulas keep their lines."""
    parts = [part for piece in lesson.pieces for part in _parts(piece, wide)]
    return "\n\n".join(parts) + "\n"


def _parts(piece: Piece, wide: int) -> Iterator[str]:
    if piece.kind == "prose":
        text = LINK.sub(r"\1 (\2)", unlinked(piece.text))
        for place, part in enumerate(_DISPLAYED.split(text)):
            if place % 2:
                yield _displayed(part)
            else:
                yield from (_block(block.strip("\n"), wide) for block in _BLANK.split(part) if block.strip())
    elif piece.kind == "live":
        words = ["dmframe", "page", piece.argument]
        words += [word for value in shlex.split(dict(piece.options).get("set", "")) for word in ("--set", value)]
        yield _DEEP + ("(a live page; open the notebook)" if piece.text else f"(a live page: {shlex.join(words)})")
    elif "solution" in piece.tags:
        yield f"{_DEEP}(the solution is in the notebook)"
    else:
        yield textwrap.indent(piece.text, _DEEP)


def _displayed(formula: str) -> str:
    """A displayed formula, line by line."""
    lines = [unicode_formula(line) for line in formula.split(r"\\")]
    return "\n".join(f"{_DEEP}{line}" for line in lines if line)


def unicode_formula(text: str) -> str:
    """Approximation of a formula in one line of Unicode."""
    kept = list[str]()

    def hold(words: str) -> str:
        kept.append(words)
        return chr(_FIRST + len(kept) - 1)

    text = re.sub(r"\\tag\{(\w+)\}", r"\\qquad (\1)", " ".join(text.split()))
    text = re.sub(r"\\(?:underbrace)\{(.*?)\}_\{.*?\}(?=[^}]|$)", r"\1", text)
    text = re.sub(r"\\(?:text|mathrm|operatorname)\{([^{}]*)\}", lambda found: hold(found[1]), text)
    text = re.sub(r"\\t?frac(\d)(\d)", lambda found: _HALVES.get(found[1] + found[2], f"{found[1]}/{found[2]}"), text)
    text = re.sub(rf"\\t?frac{_BRACED}{_BRACED}", lambda found: f"{_grouped(found[1])}/{_grouped(found[2])}", text)
    text = re.sub(rf"\\t?frac(\d){_BRACED}", lambda found: f"{found[1]}/{_grouped(found[2])}", text)
    text = re.sub(rf"\\sqrt{_BRACED}", lambda found: f"{hold('√')}({found[1]})", text)
    text = re.sub(r"\\q?quad", lambda _: hold("   "), text)
    text = re.sub(r"\\([A-Za-z]+)", lambda found: hold(_SIGNS[found[1]]) if found[1] in _SIGNS else found[0], text)
    found = re.sub(r"\\([A-Za-z]+)", lambda left: LETTERS.get(left[1], left[1]), in_unicode(text.replace("&", " ")))
    for place, words in enumerate(kept):
        found = found.replace(chr(_FIRST + place), words)
    found = re.sub(r"\bDelta ?", "Δ", re.sub(r"\^\{[-−]1\}", "⁻¹", found))
    return found.replace("{", "(").replace("}", ")").replace("^2", "²").replace("^°", "°").strip()


def _grouped(text: str) -> str:
    """In parentheses, if it is a sum."""
    return f"({text})" if re.search(r"[-+ ]", text.strip()) else text.strip()


def _plain(text: str) -> str:
    """Text without markup, with formulas in Unicode."""
    pieces = _MARKED.split(text)
    plain = "".join(_unmarked(piece) if place % 2 else piece for place, piece in enumerate(pieces))
    return _EMPHASIS.sub(r"\2", _EMPHASIS.sub(r"\2", plain))


def _unmarked(piece: str) -> str:
    return unicode_formula(piece.strip("$")) if piece.startswith("$") else piece.strip("`")


def _block(text: str, wide: int) -> str:
    """A heading, a table, a list or a paragraph."""
    if heading := re.fullmatch(r"(#+) (.*)", text):
        title = _plain(heading[2])
        return f"{title}\n{('=' if heading[1] == '#' else '-') * len(title)}"
    if text.startswith("|"):
        return _table(text.splitlines())
    items = list[list[str]]()
    for line in text.splitlines():
        if _ITEM.match(line) or not items:
            items.append([])
        items[-1].append(line.strip())
    return "\n".join(_wrapped(_plain(" ".join(item)), wide) for item in items)


def _table(lines: Sequence[str]) -> str:
    """Rows of cells; a bar in a formula or code does not end a cell."""
    rows = [[_plain(cell.strip()) for cell in _cells(line.strip().strip("|"))] for line in lines]
    rows = [row for row in rows if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]
    most = max(map(len, rows))
    return columns([row + [""] * (most - len(row)) for row in rows])


def _cells(line: str) -> list[str]:
    found = [""]
    for place, piece in enumerate(_MARKED.split(line)):
        first, *more = [piece] if place % 2 else piece.split("|")
        found[-1] += first
        found += more
    return found


def _wrapped(text: str, wide: int) -> str:
    item = _ITEM.match(text)
    return textwrap.fill(
        text, wide, subsequent_indent=" " * (item.end() if item else 0), break_on_hyphens=False, break_long_words=False
    )
