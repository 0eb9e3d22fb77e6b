"""Translation of URScript expressions to Python, by recursive descent.

A chain of operations, `a + b - c`, becomes one call with many arguments, so that the Python source grows linearly and
its nesting stays constant. `MOST_DEPTH` limits the nesting of the script.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from dmframe.virtual.words import ScriptError, Token, scopes, tokens

DIGITS: Final = 10
"""Maximum digits of an integer, which has 32 bits."""
MOST_DEPTH: Final = 40
"""Nesting depth of expressions, and of blocks."""


class Expressions:
    """Parser of a script's expressions.

    Parameters
    ----------
    known, waiting
        Functions of the robot, and those of them that take time.
    """

    def __init__(self, text: str, known: frozenset[str], waiting: frozenset[str]) -> None:
        self._tokens, self._at = tokens(text), 0
        self._known, self._waiting = known, waiting
        pairs = zip(self._tokens, self._tokens[1:], strict=False)
        self._own = {name.text for word, name in pairs if word.text in ("def", "thread") and word.kind == "word"}
        self._assigned, self._shared = scopes(self._tokens)
        self._scopes = [set[str]()]
        """Local variables of each enclosing function."""
        self._depth = 0

    # words

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _take(self) -> Token:
        token = self._next
        self._at += 1
        return token

    def _sees(self, *texts: str) -> bool:
        return self._next.text in texts and self._next.kind != "text"

    def _accept(self, text: str) -> bool:
        if self._sees(text):
            self._at += 1
            return True
        return False

    def _expect(self, text: str) -> None:
        if not self._accept(text):
            raise self._fault(repr(text))

    def _name(self) -> str:
        if self._next.kind != "name":
            raise self._fault("a name")
        return self._take().text

    def _fault(self, expected: str) -> ScriptError:
        found = {"over": "the end of the script", "newline": "the end of the line"}.get(
            self._next.kind, self._next.text
        )
        return ScriptError(f"line {self._next.line}: expected {expected}, found {found}")

    @contextmanager
    def _deeper(self, levels: int = 1) -> Iterator[None]:
        """Count nesting levels. Raises `ScriptError` if there are too many."""
        self._depth += levels
        if self._depth > MOST_DEPTH:
            raise ScriptError(f"line {self._next.line}: expressions are nested too deeply")
        yield
        self._depth -= levels

    # expressions

    def _expression(self) -> str:
        left, chains = self._conjunction(), 0
        while self._sees("or", "xor"):
            word, parts = self._next.text, [left]
            with self._deeper(chains := chains + 1):
                while self._accept(word):
                    parts.append(self._conjunction())
            left = _checked(parts, "or") if word == "or" else f"_xor({', '.join(parts)})"
        return left

    def _conjunction(self) -> str:
        parts = [self._negation()]
        while self._accept("and"):
            parts.append(self._negation())
        return parts[0] if len(parts) == 1 else _checked(parts, "and")

    def _negation(self) -> str:
        if self._accept("not"):
            with self._deeper():
                return f"(not _true({self._negation()}))"
        left, chain = self._sum(), 0
        while self._sees("==", "!=", "<", ">", "<=", ">="):
            sign = self._take().text
            with self._deeper(chain := chain + 1):
                left = f"_compare({sign!r}, {left}, {self._sum()})"
        return left

    def _sum(self) -> str:
        return self._chain(self._product, "+", "-")

    def _product(self) -> str:
        return self._chain(self._unary, "*", "/", "%")

    def _chain(self, operand: Callable[[], str], *signs: str) -> str:
        parts = [operand()]
        while self._sees(*signs):
            parts += [repr(self._take().text), operand()]
        return parts[0] if len(parts) == 1 else f"_arithmetic({', '.join(parts)})"

    def _unary(self) -> str:
        with self._deeper():
            if self._accept("-"):
                return f"_arithmetic(-1, '*', {self._unary()})"
            if self._accept("+"):
                return self._unary()
            found, places = self._place()
        return found if places is None else f"_item({found}, {places})"

    def _place(self) -> tuple[str, str | None]:
        """A value, and the indices of an element in it; None for the value itself."""
        found, places = self._primary()
        while self._accept("["):
            places.append(self._expression())
            while self._accept(","):
                places.append(self._expression())
            self._expect("]")
        return found, f"({', '.join(places)},)" if places else None

    def _primary(self) -> tuple[str, list[str]]:
        """A value; with the index, if it looks like a pose: `p[0]`."""
        token = self._take()
        if token.kind == "number":
            return _number(token), []
        if token.kind == "text":
            return repr(token.text[1:-1]), []
        if token.kind == "word" and token.text in ("True", "False"):
            return token.text, []
        if token.text == "run" and token.kind == "word":
            name = self._name()
            if name not in self._own:
                raise ScriptError(f"line {token.line}: run {name}: expected a thread of this script")
            return f"_run({name!r}, f_{name}({', '.join(self._arguments('v_'))}))", []
        if token.text == "(":
            inner = self._expression()
            self._expect(")")
            return f"({inner})", []
        if token.text == "[":
            return f"_list([{', '.join(self._until(']'))}])", []
        if token.kind == "name" and token.text == "p" and self._accept("["):
            inside = list(self._until("]"))  # a variable may also be named p
            return (self._variable("p"), inside) if len(inside) in (1, 2) else (f"_pose([{', '.join(inside)}])", [])
        if token.kind == "name":
            return (self._call(token) if self._sees("(") else self._variable(token.text)), []
        self._at -= 1
        raise self._fault("a value")

    def _call(self, token: Token) -> str:
        arguments = ", ".join(self._arguments("v_" if token.text in self._own else ""))
        if token.text in self._own:
            return f"(yield from f_{token.text}({arguments}))"
        if token.text in self._waiting:
            return f"(yield from _call[{token.text!r}]({arguments}))"
        return f"_call[{token.text!r}]({arguments})" if token.text in self._known else f"_missing({token.text!r})"

    def _variable(self, name: str) -> str:
        return f"v_{name}" if name in self._scopes[-1] else f"_read({name!r})"

    def _arguments(self, prefix: str = "") -> list[str]:
        self._expect("(")
        found = list[str]()
        while not self._accept(")"):
            if self._next.kind in ("name", "word") and self._tokens[self._at + 1].text == "=":
                name = self._take().text
                self._at += 1
                found.append(f"**{{{f'{prefix}{name}'!r}: {self._expression()}}}")
            else:
                found.append(self._expression())
            if not self._sees(")"):
                self._expect(",")
        return found

    def _until(self, end: str) -> Iterator[str]:
        while not self._accept(end):
            yield self._expression()
            if not self._sees(end):
                self._expect(",")


def _checked(parts: list[str], word: str) -> str:
    return f"({f' {word} '.join(f'_true({part})' for part in parts)})"


def _number(token: Token) -> str:
    text = token.text
    if not (text.isdigit() or text.startswith("0x")):
        found = float(text)
        return repr(found) if math.isfinite(found) else "1e999"  # as Python reads it
    # Python reads a decimal of thousands of digits slowly, or not at all
    digits = text[2:] if text.startswith("0x") else text
    if len(digits.lstrip("0")) > DIGITS:
        raise ScriptError(f"line {token.line}: expected an integer of 32 bits, found one of {len(digits)} digits")
    return str(int(digits, 16 if text.startswith("0x") else 10))
