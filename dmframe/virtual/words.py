"""The words of a script, which names they assign, and when it is complete."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple, final

from dmframe.errors import DmframeError


@final
class ScriptError(DmframeError):
    """A script that cannot be read, or that failed while it ran; the text tells the line."""


class Token(NamedTuple):
    """A word of a script: its kind, its text and its line."""

    kind: str
    text: str
    line: int


_TOKEN: Final = re.compile(
    r"""(?P<space>[ \t\r]+|\#[^\n]*)|(?P<newline>\n)|(?P<number>0x[0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"""
    r"""|(?P<text>"[^"\n]*"|'[^'\n]*')|(?P<name>[A-Za-z_]\w*)|(?P<sign>[<>=!]=|[-+*/%<>=()\[\],:.;{}^])"""
)
_BINARY: Final = frozenset("or and xor not = == != < > <= >= + - * / % , ^".split())
"""A line that ends with one of these goes on in the next."""
OPENING: Final = frozenset(("def", "thread", "sec", "if", "while"))
"""What `end` closes."""
_WORDS: Final = OPENING | frozenset(
    "end elif else return break continue halt run kill join global local and or xor not True False "
    "enter_critical exit_critical pass".split()
)


def tokens(text: str) -> list[Token]:
    """The words of a script; ends of lines where a statement may end."""
    found, place, line, depth = list[Token](), 0, 1, 0
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            raise ScriptError(f"line {line}: expected URScript, found {text[place]!r}")
        kind, word = match.lastgroup or "", match.group()
        place = match.end()
        if kind == "newline" or word == ";":
            goes_on = depth > 0 or (found and found[-1].text in _BINARY and found[-1].kind != "text")
            if not goes_on and found and found[-1].kind != "newline":
                found.append(Token("newline", "\n", line))
        elif kind != "space":
            depth = max(0, depth + (word in "([{") - (word in ")]}")) if kind == "sign" else depth
            found.append(Token("word" if kind == "name" and word in _WORDS else kind, word, line))
        line += kind == "newline"
    found.append(Token("newline", "\n", line))
    return [*found, Token("over", "", line)]


def assigned(words: Sequence[Token]) -> tuple[set[str], set[str], set[str]]:
    """Of the block that begins here: assigned plainly, declared local; declared global, also within functions."""
    plain, local, shared, depth = set[str](), set[str](), set[str](), list[str]()
    for k, token in enumerate(words[:-1]):
        follows, inner = words[k + 1], {"def", "thread"} & set(depth)
        if token.kind == "word" and token.text in OPENING:
            depth.append(token.text)
        elif token.kind == "word" and token.text == "end":
            if not depth:
                break
            depth.pop()
        elif token.text == "global" and token.kind == "word":
            shared.add(follows.text)
        elif token.text == "local" and token.kind == "word" and not inner:
            local.add(follows.text)
        first = k == 0 or words[k - 1].kind == "newline" or words[k - 1].text == ":"
        if first and token.kind == "name" and follows.text == "=" and not inner:
            plain.add(token.text)
    return plain, local, shared


def complete(text: str) -> int:
    """How many characters of what has arrived are a whole program, or a line by itself; 0 where more must come."""
    depth, place = 0, 0
    for line in text.splitlines(keepends=True):
        if not line.endswith("\n"):
            return 0
        place += len(line)
        words = re.findall(r'"[^"]*"|[A-Za-z_]\w*|#.*|\S', line)
        first = words[0] if words else "#"
        if first.startswith("#"):
            continue
        depth += (first in OPENING) - (first == "end")
        if depth <= 0:
            return place
    return 0
