"""Lexer of URScript: the words of a script, the names that they assign, and the end of a program in a stream."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple, final

from dmframe.common.errors import DmframeError


@final
class ScriptError(DmframeError):
    """Invalid script, or a script that failed; the message has the line."""


class Token(NamedTuple):
    """Word of a script."""

    kind: str
    text: str
    line: int


_TOKEN: Final = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)|(?P<newline>\n)|(?P<number>0x[0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"""
    r"""|(?P<text>"[^"\n]*"|'[^'\n]*')|(?P<name>[A-Za-z_]\w*)|(?P<sign>[<>=!]=|[-+*/%<>=()\[\],:.;{}^])"""
)
_BINARY: Final = frozenset("or and xor not = == != < > <= >= + - * / % , ^".split())
"""A line that ends with one of these continues on the next."""
OPENING: Final = frozenset(("def", "thread", "sec", "if", "while"))
"""Keywords that `end` closes."""
_FUNCTIONS: Final = frozenset(("def", "thread", "sec"))
MOST_WORDS: Final = 20_000
"""Words of a script: more would delay the robot, and all its clients, by more than some tenths of a second."""
_PIECES: Final = 4 * MOST_WORDS
"""Words, spaces, comments and empty lines of a script."""
_WORDS: Final = OPENING | frozenset(
    "end elif else return break continue halt run kill join global local and or xor not True False "
    "enter_critical exit_critical pass".split()
)


def tokens(text: str) -> list[Token]:
    """Split a script into words; ``newline`` marks places where a statement may end."""
    found, place, line, depth, pieces = list[Token](), 0, 1, 0, 0
    while place < len(text):
        pieces += 1
        if len(found) > MOST_WORDS or pieces > _PIECES:
            raise ScriptError(f"line {line}: expected a script of no more than {MOST_WORDS} words, found a longer one")
        match = _TOKEN.match(text, place)
        if match is None:
            raise ScriptError(f"line {line}: expected URScript, found {text[place]!r}")
        kind, word = match.lastgroup or "", match.group()
        place = match.end()
        if kind == "newline" or word == ";":
            continues = depth > 0 or (found and found[-1].text in _BINARY and found[-1].kind != "text")
            if not continues and found and found[-1].kind != "newline":
                found.append(Token("newline", "\n", line))
        elif kind != "space":
            depth = max(0, depth + (word in "([{") - (word in ")]}")) if kind == "sign" else depth
            found.append(Token("word" if kind == "name" and word in _WORDS else kind, word, line))
        line += kind == "newline"
    found.append(Token("newline", "\n", line))
    return [*found, Token("over", "", line)]


Names = tuple[set[str], set[str]]


def scopes(words: Sequence[Token]) -> tuple[dict[int, Names], set[str]]:
    """Names that each function assigns, and that it declares local, by the index of its first word (-1: the program).

    The second result holds all names that are declared global.
    """
    found: dict[int, Names] = {-1: (set(), set())}
    shared, inner, opened = set[str](), [-1], list[bool]()
    for k, token in enumerate(words[:-1]):
        follows, (plain, local) = words[k + 1], found[inner[-1]]
        if token.kind == "word" and token.text in OPENING:
            opened.append(token.text in _FUNCTIONS)
            if opened[-1]:
                found[k] = (set(), set())
                inner.append(k)
        elif token.kind == "word" and token.text == "end" and opened:
            if opened.pop():
                inner.pop()
        elif token.kind == "word" and token.text == "global":
            shared.add(follows.text)
        elif token.kind == "word" and token.text == "local":
            local.add(follows.text)
        first = k == 0 or words[k - 1].kind == "newline" or words[k - 1].text == ":"
        if first and token.kind == "name" and follows.text == "=":
            plain.add(token.text)
    return found, shared


@final
class ScriptBuffer:
    """Buffer for a text that arrives in pieces; it scans each character once and returns whole programs."""

    def __init__(self) -> None:
        self.text = ""
        self._place, self._depth = 0, 0

    def take(self) -> str:
        """Remove and return the first complete program, or single line; empty if none is complete."""
        while (end := self.text.find("\n", self._place)) >= 0:
            found = _FIRST.match(self.text, self._place, end)
            first = found.group(1) if found else "#"
            self._place = end + 1
            if first.startswith("#"):
                continue
            self._depth += (first in OPENING) - (first == "end")
            if self._depth <= 0:
                whole, self.text = self.text[: self._place], self.text[self._place :]
                self._place, self._depth = 0, 0
                return whole
        return ""


_FIRST: Final = re.compile(r'\s*("[^"]*"|[A-Za-z_]\w*|\S)')
