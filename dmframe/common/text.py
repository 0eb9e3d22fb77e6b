"""Sentences of words, formulas and labels: plain for JSON, Unicode for a terminal, marked for HTML and Markdown.

A *marked text* has formulas in LaTeX between dollar signs and labels between backticks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Any, Final, Protocol, final

from dmframe.common.names import latex_name, unicode_name


class Formula(Protocol):
    """A formula in the code's names, in Unicode and in LaTeX, such as `dmframe.formula.Formula`."""

    @property
    def text(self) -> str:
        """In the code's names."""

    @property
    def unicode(self) -> str:
        """For a terminal."""

    @property
    def latex(self) -> str:
        """As LaTeX, without dollar signs."""


@final
@dataclass(frozen=True)
class Written:
    """A formula that is written in its three dialects, not read from an expression."""

    text: str
    unicode: str
    latex: str


@final
@dataclass(frozen=True)
class Label:
    """A name of the graph or of a file, such as ``inverse.w``; it is set as code."""

    text: str


Piece = str | Formula | Label


@final
class Text(str):
    """A sentence: its words, formulas and labels, in order.

    As a `str` it is plain, with formulas in the code's names: this is what JSON holds and what comparisons read. An
    f-string makes a plain `str` of it, without the formulas; ``Text("weight of ", name, " > 0")`` keeps them.
    """

    pieces: tuple[Piece, ...]

    def __new__(cls, *pieces: Piece) -> Text:
        """Join the pieces."""
        flat = [
            inner
            for piece in pieces
            for inner in (piece.pieces if isinstance(piece, Text) else (piece,))
            if inner != ""
        ]
        made = super().__new__(cls, "".join(piece if isinstance(piece, str) else piece.text for piece in flat))
        made.pieces = tuple(flat)
        return made

    def __getnewargs__(self) -> Any:
        """The pieces of a copy."""
        return self.pieces

    @property
    def unicode(self) -> str:
        """For a terminal."""
        return self._rendered(str, str, lambda formula: formula.unicode)

    @property
    def latex(self) -> str:
        """As one formula, with the words as text."""
        return self._rendered(_words, _words, lambda formula: formula.latex)

    @property
    def marked(self) -> str:
        """As a marked text."""
        return self._rendered(str, "`{}`".format, lambda formula: f"${formula.latex}$")

    def _rendered(
        self, words: Callable[[str], str], label: Callable[[str], str], formula: Callable[[Formula], str]
    ) -> str:
        return "".join(
            words(piece.replace("<=", "≤").replace(">=", "≥"))
            if isinstance(piece, str)
            else label(piece.text)
            if isinstance(piece, Label)
            else formula(piece)
            for piece in self.pieces
        )


def _words(words: str) -> str:
    escaped = re.sub(r"([#$%&_{}])", r"\\\1", words)
    return rf"\text{{{escaped}}}"


def text_of(text: str) -> Text:
    """A text unchanged; a plain `str` is words only."""
    return text if isinstance(text, Text) else Text(text)


def joined(pieces: Sequence[Piece], between: str = ", ", last: str = "") -> Text:
    """The pieces, separated; the last one by `last`."""
    found = list[Piece]()
    for place, piece in enumerate(pieces):
        found += [last if last and place == len(pieces) - 1 else between] * bool(place) + [piece]
    return Text(*found)


def listed_text(pieces: Sequence[Piece]) -> Text:
    """``a, b and c``."""
    return joined(pieces, last=" and ")


def name_of(name: str) -> Written:
    """A name of the code as a formula."""
    return Written(name, unicode_name(name), latex_name(name))


def around(of: Text, text: str, latex: str = "", unicode: str = "") -> Text:
    """A formula formed of another one, which replaces each ``{}``; dialects that are left out are as `text`."""
    return Text(
        Written(
            text.replace("{}", of), (unicode or text).replace("{}", of.unicode), (latex or text).replace("{}", of.latex)
        )
    )


def square_of(of: Text, weight: str = "") -> Text:
    """The square of the norm of a vector, with the letter of its weight."""
    below = f"_{weight}" if weight else ""
    return around(of, f"|{{}}|{below}^2", f"|{{}}|^2{below}", f"|{{}}|²{below}")


def sentence(template: str, **given: Piece) -> Text:
    """Words with a piece instead of each ``{name}``; a name without an argument is printed as a formula: ``{V}``."""
    pieces = list[Piece]()
    for words, name, _, _ in Formatter().parse(template):
        pieces.append(words)
        if name:
            pieces.append(given[name] if name in given else DV if name == DV.text else name_of(name))
    return Text(*pieces)


V: Final = name_of("V")
DV: Final = Written("dV/dt", unicode_name("V", "dot"), r"\dot V")
DISSIPATION: Final = "the dissipation"
"""What dV/dt equals with the opposite sign; the name of the sum of its terms."""
KAPPA: Final = name_of("kappa")
UNNAMED: Final = Text()
