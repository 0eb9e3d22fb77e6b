r"""LaTeX formulas as MathML, split into terms with line-break opportunities: browsers do not break formulas.

Supported: the symbols of `symbols`, Greek letters, functions, accents, ``_ ^ '``, fractions, roots, pairs of bars,
``\left``, ``\text``, ``\mathrm``, ``\operatorname``, ``\mathbb``, ``\mathcal``, ``\underbrace``, matrices and cases.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Final, final

from dmframe.report.symbols import ACCENTS, ALPHABETS, BARS, FENCES, SCRIPTS, SYMBOLS, Item, Kind
from dmframe.report.tags import Html, joined, plain, tag

_TOKEN: Final = re.compile(r"\\(?:begin|end)\{\w+\*?\}|\\[a-zA-Z]+|\\.|\d+(?:\.\d+)?|\s+|.", re.DOTALL)
_DEPTH: Final = {"{": 1, "(": 1, "[": 1, "}": -1, ")": -1, "]": -1}
_BRACES: Final = {"{": 1, "}": -1}
LONG: Final = 120
"""Length [characters of LaTeX] above which a term may be broken inside its brackets."""
_ESCAPED: Final = (r"\_", r"\%", r"\#", r"\&", r"\$", r"\ ")
_SIGNS: Final = ("+", "-", "=", r"\ge", r"\le", r"\pm")


def breakable(latex: str, *, display: bool = False) -> Html:
    """Formula as one ``<math>`` a term, with line-break opportunities between them."""
    pieces = terms(latex)
    return joined((mathml(piece, display=display, joined=place > 0) for place, piece in enumerate(pieces)), "<wbr/>")


def terms(latex: str) -> list[str]:
    r"""Split a formula before signs outside brackets and at each ``\quad``; a long term inside ( ) too."""
    pieces = _cut(latex, _DEPTH)
    return [part for piece in pieces for part in (_cut(piece, _BRACES) if len(piece) > LONG else [piece])]


def _cut(latex: str, brackets: Mapping[str, int]) -> list[str]:
    pieces, current, depth, bars = list[str](), "", 0, False
    for token in _TOKEN.findall(latex):
        if token == "|":
            bars = not bars
        depth += (token == r"\left" or token.startswith(r"\begin")) - (token == r"\right" or token.startswith(r"\end"))
        depth += brackets.get(token, 0)
        outside = depth == 0 and not bars
        if outside and token in _SIGNS and current.strip() and not current.strip().endswith((*_SIGNS, "(", "^")):
            pieces.append(current.strip())
            current = ""
        elif outside and token in (r"\quad", r"\qquad"):
            pieces.append(f"{current.strip()} {token}")
            current = ""
            continue
        current += token
    return [piece for piece in [*pieces, current.strip()] if piece]


class UnsupportedLatexError(Exception):
    """LaTeX outside the supported commands, or with an unmatched bracket."""


_SIZES: Final = re.compile(r"\\[bB]igg?[lrm]?")
"""Sizes of brackets, which have no effect."""


def mathml(latex: str, *, display: bool = False, joined: bool = False) -> Html:
    """One formula as ``<math>``; LaTeX that is not supported becomes ``<code>``.

    `joined`: the formula continues a previous one, so a leading sign is an infix operator.
    """
    try:
        items = _Reader(latex).row("")
    except UnsupportedLatexError:
        return tag("code", plain(latex))
    return tag("math", _row(items, "ordinary" if joined else "opening"), displaystyle="true" if display else "false")


def _row(items: Sequence[Item], before: Kind = "opening") -> Html:
    """Elements in a row, with thin spaces around functions, and signs as prefix or infix operators."""
    out = list[Html]()
    for place, (markup, kind) in enumerate(items):
        form = ""
        if kind == "sign":
            form = "infix" if before in ("ordinary", "closing") else "prefix"
        elif kind == "relation" and place == 0:
            form = "infix"
        named = kind == "function" and before in ("ordinary", "closing", "function")
        if named or (before == "function" and kind in ("ordinary", "limits")):
            out.append(SYMBOLS[r"\,"].markup)
        out.append(Html(markup.replace("<mo", f'<mo form="{form}"', 1)) if form else markup)
        before = kind if kind != "space" else before
    return tag("mrow", *out)


def _one(items: Sequence[Item]) -> Html:
    return items[0].markup if len(items) == 1 else _row(items)


def _fenced(left: str, inside: Html, right: str) -> Item:
    """Between brackets of its height."""
    ends = ((left, "prefix"), (right, "postfix"))
    first, last = (
        tag("mo", plain(mark), fence="true", form=form, stretchy="true") if mark else Html("") for mark, form in ends
    )
    return Item(tag("mrow", first, inside, last))


def _capital(alphabet: str, letter: str) -> Item:
    """A capital of another alphabet."""
    for name in (f"{alphabet} {letter}", f"MATHEMATICAL {alphabet} {letter}"):
        try:
            return Item(tag("mi", plain(unicodedata.lookup(name))))
        except KeyError:
            continue
    raise UnsupportedLatexError(f"no {alphabet} {letter}")


@final
class _Reader:
    """Recursive-descent parser of one formula."""

    def __init__(self, latex: str) -> None:
        self._tokens, self._place = _TOKEN.findall(latex), 0

    def _next(self) -> str:
        """The next token that is not blank; empty at the end."""
        while self._place < len(self._tokens) and self._tokens[self._place].isspace():
            self._place += 1
        return self._tokens[self._place] if self._place < len(self._tokens) else ""

    def _take(self) -> str:
        token = self._next()
        if not token:
            raise UnsupportedLatexError("it ends too early")
        self._place += 1
        return token

    def row(self, *ends: str) -> list[Item]:
        """Elements up to one of these tokens, which is consumed."""
        items = list[Item]()
        while (token := self._next()) not in ends:
            if token in (r"\textstyle", r"\displaystyle"):
                self._take()
                style = "true" if token == r"\displaystyle" else "false"
                return [*items, Item(tag("mstyle", _row(self.row(*ends)), displaystyle=style))]
            items.append(self._scripted())
        self._place += 1
        return items

    def _scripted(self) -> Item:
        """An element with its subscript and superscript."""
        base = Item(tag("mrow")) if self._next() in ("_", "^") else self._atom()
        scripts = dict[str, Html]()
        while (mark := self._next()) in ("_", "^", "'"):
            self._take()
            place = "^" if mark == "'" else mark
            if place in scripts:
                raise UnsupportedLatexError(f"two scripts {place}")
            scripts[place] = tag("mo", Html("′")) if mark == "'" else self._index() if mark == "_" else self._argument()
        if not scripts:
            return base
        marks = "".join(mark for mark in "_^" if mark in scripts)
        name = SCRIPTS[marks][base.kind == "limits"]
        return Item(tag(name, base.markup, *(scripts[mark] for mark in marks)), base.kind)

    def _argument(self) -> Html:
        """A group in braces, one element, or one digit."""
        token = self._next()
        if token.isdigit():
            self._tokens[self._place : self._place + 1] = list(token)
        return self._atom().markup

    def _index(self) -> Html:
        """A subscript; a word of several letters is upright."""
        start = self._place
        if self._next() == "{":
            word = self._text()
            if len(word) > 1 and word.isalpha() and word.isascii():
                return tag("mtext", plain(word))
            self._place = start
        return self._argument()

    def _text(self) -> str:
        """The letters of an argument; empty if it contains a command."""
        if self._next() != "{":
            return self._take()
        depth, text = 0, ""
        while self._place < len(self._tokens):
            token = self._tokens[self._place]
            self._place += 1
            depth += _BRACES.get(token, 0)
            if depth == 0:
                return "" if "\\" in text else text[1:]
            text += token[1:] if token in _ESCAPED else token
        raise UnsupportedLatexError("a brace is not closed")

    def _words(self) -> str:
        text = self._text()
        if not text:
            raise UnsupportedLatexError("expected text without commands")
        return text

    def _atom(self) -> Item:
        token = self._take()
        if token in SYMBOLS:
            return SYMBOLS[token]
        if token == "{":
            return Item(_one(self.row("}")))
        if token[0].isdigit():
            return Item(tag("mn", plain(token)))
        if token.isalpha():
            return Item(tag("mi", plain(token)))
        if token in BARS:
            return self._bars(BARS[token])
        if token in ACCENTS:
            return Item(
                tag("mover", self._argument(), tag("mo", plain(ACCENTS[token]), stretchy="false"), accent="true")
            )
        if token.startswith(r"\begin"):
            return self._table(token[7:-1])
        return self._atom() if _SIZES.fullmatch(token) else self._command(token)

    def _command(self, token: str) -> Item:
        match token:
            case r"\frac":
                return Item(tag("mfrac", self._argument(), self._argument()))
            case r"\tfrac":
                return Item(tag("mstyle", tag("mfrac", self._argument(), self._argument()), displaystyle="false"))
            case r"\sqrt":
                return Item(tag("msqrt", self._argument()))
            case r"\left":
                opening, inside = self._delimiter(), _row(self.row(r"\right"))
                return _fenced(opening, inside, self._delimiter())
            case r"\underbrace":
                return Item(tag("munder", self._argument(), tag("mo", Html("⏟"), stretchy="true")), "limits")
            case r"\text":
                return Item(tag("mtext", plain(re.sub(r"^ | $", "\N{NO-BREAK SPACE}", self._words()))))
            case r"\mathrm":
                words = self._words()
                return Item(tag("mi", plain(words), mathvariant="normal" if len(words) == 1 else ""))
            case r"\operatorname":
                return Item(tag("mi", plain(self._words())), "function")
            case r"\mathbb" | r"\mathcal":
                return _capital(ALPHABETS[token], self._words())
            case _:
                raise UnsupportedLatexError(f"the command {token}")

    def _delimiter(self) -> str:
        r"""A bracket after ``\left`` or ``\right``; a point means none."""
        token = self._take()
        found = "" if token == "." else BARS.get(token) or token.removeprefix("\\")
        if found not in ("", *"()[]{}|‖"):
            raise UnsupportedLatexError(f"the bracket {token}")
        return found

    def _bars(self, mark: str) -> Item:
        """A norm or an absolute value; a bar without a partner is a sign."""
        start = self._place
        try:
            inside = _row(self.row(*(token for token, sign in BARS.items() if sign == mark)))
        except UnsupportedLatexError:
            self._place = start
            return Item(tag("mo", plain(mark)))
        return _fenced(mark, inside, mark)

    def _table(self, name: str) -> Item:
        """A matrix, or cases."""
        if name not in FENCES:
            raise UnsupportedLatexError(f"the environment {name}")
        rows, end = [list[Html]()], rf"\end{{{name}}}"
        while True:
            rows[-1].append(tag("mtd", _row(self.row("&", r"\\", end))))
            last = self._tokens[self._place - 1]
            if last == end:
                break
            if last == r"\\":
                rows.append([])
        left, right = FENCES[name]
        table = tag("mtable", *(tag("mtr", *row) for row in rows), columnalign="left" if name == "cases" else "")
        return _fenced(left, table, right)
