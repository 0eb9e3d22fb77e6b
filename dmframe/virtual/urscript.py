"""Translation of URScript to Python: each function becomes a generator that yields to wait for the next cycle.

Functions are renamed to ``f_name``, local variables to ``v_name``, and global variables are keys of a dictionary, so
that a script cannot access Python objects. Functions of the robot are called through a table. An unknown function is an
error when it is called, not when it is translated, because programs name many functions that they never call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

from dmframe.virtual.expressions import MOST_DEPTH, Expressions
from dmframe.virtual.words import OPENING, ScriptError

MOST_BRANCHES: Final = 500
"""Branches of one `if`: Python nests each `elif` within the previous one."""
TOKENS: Final = 16
"""Words of a loop's or a function's body that count as one operation."""


@final
@dataclass(frozen=True)
class Transpiled:
    """Script translated to Python.

    Parameters
    ----------
    name
        Name of the program; empty for a single line.
    secondary
        True for a program that runs next to the main program, and must not move the robot.
    source
        Python source, with a function ``main``.
    lines
        Line of the script for each line of the source.
    words
        Number of words of the script.
    """

    name: str
    secondary: bool
    source: str
    lines: tuple[int, ...]
    words: int


@final
class _Reader(Expressions):
    """Parser of statements."""

    def __init__(self, text: str, known: frozenset[str], waiting: frozenset[str]) -> None:
        super().__init__(text, known, waiting)
        self._globals = set[str]()
        self._out, self._lines = list[str](), list[int]()
        self._loops = 0

    def _end_of_line(self) -> None:
        if self._next.kind == "newline":
            self._at += 1
        elif self._next.kind not in ("over", "word"):  # a keyword begins another statement
            raise self._fault("the end of the line")

    def _put(self, depth: int, text: str, line: int) -> None:
        self._out.append("    " * depth + text)
        self._lines.append(line)

    def read(self) -> Transpiled:
        """Translate the whole script."""
        while self._next.kind == "newline":
            self._at += 1
        name, first = "", self._at
        whole, secondary = self._sees("def", "sec"), self._sees("sec")
        if whole:
            self._at += 1
            name = self._name()
            for end in ("(", ")", ":"):
                self._expect(end)
        plain, local = self._assigned[first if whole else -1]
        self._globals = plain | local | self._shared
        self._put(0, "def main():", self._next.line)
        self._body(1, ("end",) if whole else ("",))
        self._put(1, "if False: yield", self._next.line)
        if whole:
            self._expect("end")
        while self._next.kind == "newline":
            self._at += 1
        if self._next.kind != "over":
            raise self._fault("nothing after the program's end")
        return Transpiled(name, secondary, "\n".join(self._out) + "\n", tuple(self._lines), len(self._tokens))

    def _body(self, depth: int, ends: tuple[str, ...]) -> None:
        first = len(self._out)
        while not (self._next.kind in ("word", "over") and self._next.text in ends):
            if self._next.kind == "over":
                raise self._fault("end")
            self._statement(depth)
        if len(self._out) == first:
            self._put(depth, "pass", self._next.line)

    def _statement(self, depth: int) -> None:
        if self._next.kind == "newline":
            self._at += 1
            return
        line, word = self._next.line, self._next.text if self._next.kind == "word" else ""
        if depth > MOST_DEPTH:
            raise ScriptError(f"line {line}: blocks are nested too deeply")
        match word:
            case "def" | "thread":
                self._function(depth)
            case "if":
                self._branch(depth)
            case "while":
                self._loop(depth)
            case "global" | "local":
                self._at += 1
                self._assignment(depth, self._name())
            case "return":
                self._at += 1
                value = "None" if self._next.kind == "newline" else self._expression()
                self._put(depth, f"return {value}", line)
            case "break" | "continue":
                if not self._loops:
                    raise self._fault("a loop around this statement")
                self._at += 1
                self._put(depth, word, line)
            case "halt":
                self._at += 1
                self._put(depth, "_halt()", line)
            case "kill" | "join":
                self._at += 1
                thread = self._expression()
                self._put(depth, f"_kill({thread})" if word == "kill" else f"(yield from _join({thread}))", line)
            case "enter_critical" | "exit_critical" | "pass":  # threads switch only at waits
                self._at += 1
                self._put(depth, "pass", line)
            case _ if self._next.kind == "name" and self._tokens[self._at + 1].text == "=":
                self._assignment(depth, self._name())
            case _:
                self._element_or_call(depth, line)
        if word not in OPENING:
            self._end_of_line()

    def _element_or_call(self, depth: int, line: int) -> None:
        first = self._at
        left = self._expression()
        if self._accept("="):
            value, end = self._expression(), self._at
            self._at = first
            whole, places = self._place()
            if places is None or not self._accept("="):
                raise ScriptError(f"line {line}: expected a variable or an element on the left of =")
            self._at = end
            self._put(depth, f"_put({whole}, {places}, {value})", line)
        else:
            self._put(depth, left, line)

    def _loop(self, depth: int) -> None:
        first = self._at
        self._at += 1
        condition = self._expression()
        self._expect(":")
        self._put(depth, f"while _true({condition}):", self._tokens[first].line)
        turn = self._turn(depth + 1)
        self._loops += 1
        self._body(depth + 1, ("end",))
        self._loops -= 1
        self._expect("end")
        self._counted(turn, first)

    def _turn(self, depth: int) -> int:
        """Emit a line for the operations of an iteration or a call, and return its index."""
        self._put(depth, "_turn(", self._next.line)
        return len(self._out) - 1

    def _counted(self, turn: int, first: int) -> None:
        """Complete that line after the body has been translated."""
        self._out[turn] += f"{1 + (self._at - first) // TOKENS})"

    def _assignment(self, depth: int, name: str) -> None:
        line = self._next.line
        self._expect("=")
        value = self._expression()
        place = f"v_{name}" if name in self._scopes[-1] else f"_g[{name!r}]"
        self._put(depth, f"{place} = _copy({value})", line)

    def _branch(self, depth: int) -> None:
        line = self._next.line
        self._at += 1
        self._put(depth, f"if _true({self._expression()}):", line)
        self._expect(":")
        self._body(depth + 1, ("elif", "else", "end"))
        branches = 1
        while self._sees("elif"):
            line = self._take().line
            branches += 1
            if branches > MOST_BRANCHES:
                raise ScriptError(f"line {line}: expected no more than {MOST_BRANCHES} branches of one if, found more")
            self._put(depth, f"elif _true({self._expression()}):", line)
            self._expect(":")
            self._body(depth + 1, ("elif", "else", "end"))
        if self._sees("else"):
            line = self._take().line
            self._expect(":")
            self._put(depth, "else:", line)
            self._body(depth + 1, ("end",))
        self._expect("end")

    def _function(self, depth: int) -> None:
        first, line = self._at, self._take().line
        name, arguments = self._name(), dict[str, None]()
        self._expect("(")
        given = list[str]()
        while not self._accept(")"):
            argument = self._name()
            arguments[argument] = None
            given.append(f"v_{argument}={self._expression()}" if self._accept("=") else f"v_{argument}")
            if not self._sees(")"):
                self._expect(",")
        self._expect(":")
        loops, self._loops = self._loops, 0
        plain, local = self._assigned[first]
        self._scopes.append(arguments.keys() | local | plain - self._globals)
        self._put(depth, f"def f_{name}({', '.join(given)}):", line)
        turn = self._turn(depth + 1)
        for argument in arguments:  # lists are passed by value
            self._put(depth + 1, f"v_{argument} = _copy(v_{argument})", line)
        self._body(depth + 1, ("end",))
        self._put(depth + 1, "if False: yield", self._next.line)
        self._counted(turn, first)
        self._scopes.pop()
        self._loops = loops
        self._expect("end")


def transpiled(text: str, known: frozenset[str], waiting: frozenset[str]) -> Transpiled:
    """Translate a script to Python.

    Parameters
    ----------
    known, waiting
        Functions of the robot, and those of them that take time.

    Raises
    ------
    ScriptError
        The text is not valid URScript, or uses a construct that is not supported; the message has the line.
    """
    try:
        return _Reader(text, known, waiting).read()
    except RecursionError:
        raise ScriptError("script: expressions are nested too deeply") from None
