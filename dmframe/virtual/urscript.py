"""URScript as Python: each function becomes a generator that yields where the robot's next cycle is to be awaited.

Names become ``f_name`` for functions, ``v_name`` for local variables and keys of a dictionary for global ones, so that
a script reaches nothing of Python's. A call of a function that the robot has goes through a table; one that it has not
is a fault when it is called, not when it is read, as programs name many that they never use.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

from dmframe.virtual.words import OPENING, ScriptError, Token, assigned, tokens


@final
@dataclass(frozen=True)
class Transpiled:
    """A script as Python.

    Parameters
    ----------
    name
        Of the program; empty for a line by itself.
    secondary
        It runs beside another program, and moves nothing.
    source
        Python, with a function ``main``.
    lines
        Of the script, by the lines of the source.
    """

    name: str
    secondary: bool
    source: str
    lines: tuple[int, ...]


@final
class _Reader:
    def __init__(self, text: str, known: frozenset[str], waiting: frozenset[str]) -> None:
        self._tokens, self._at = tokens(text), 0
        self._known, self._waiting = known, waiting
        self._own = self._declared()
        self._globals = set[str]()
        self._out, self._lines = list[str](), list[int]()
        self._scopes = [set[str]()]
        """Local variables of each function that is being read."""
        self._loops = 0

    def _declared(self) -> set[str]:
        pairs = zip(self._tokens, self._tokens[1:], strict=False)
        return {name.text for word, name in pairs if word.text in ("def", "thread") and word.kind == "word"}

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

    def _end_of_line(self) -> None:
        if self._next.kind == "newline":
            self._at += 1
        elif self._next.kind not in ("over", "word"):  # a keyword begins another
            raise self._fault("the end of the line")

    # statements

    def _put(self, depth: int, text: str, line: int) -> None:
        self._out.append("    " * depth + text)
        self._lines.append(line)

    def read(self) -> Transpiled:
        """The whole script."""
        while self._next.kind == "newline":
            self._at += 1
        name = ""
        whole, secondary = self._sees("def", "sec"), self._sees("sec")
        if whole:
            self._at += 1
            name = self._name()
            for end in ("(", ")", ":"):
                self._expect(end)
        plain, local, shared = assigned(self._tokens[self._at :])
        self._globals = plain | local | shared
        self._put(0, "def main():", self._next.line)
        self._body(1, ("end",) if whole else ("",))
        self._put(1, "if False: yield", self._next.line)
        if whole:
            self._expect("end")
        while self._next.kind == "newline":
            self._at += 1
        if self._next.kind != "over":
            raise self._fault("nothing after the program's end")
        return Transpiled(name, secondary, "\n".join(self._out) + "\n", tuple(self._lines))

    def _body(self, depth: int, ends: tuple[str, ...]) -> None:
        begun = len(self._out)
        while not (self._next.kind in ("word", "over") and self._next.text in ends):
            if self._next.kind == "over":
                raise self._fault("end")
            self._statement(depth)
        if len(self._out) == begun:
            self._put(depth, "pass", self._next.line)

    def _statement(self, depth: int) -> None:
        if self._next.kind == "newline":
            self._at += 1
            return
        line, word = self._next.line, self._next.text if self._next.kind == "word" else ""
        if depth > 90:
            raise ScriptError(f"line {line}: blocks within blocks, more than can be read")
        match word:
            case "def" | "thread":
                self._function(depth)
            case "if":
                self._branch(depth)
            case "while":
                self._at += 1
                condition = self._expression()
                self._expect(":")
                self._put(depth, f"while _true({condition}):", line)
                self._put(depth + 1, "_turn()", line)
                self._loops += 1
                self._body(depth + 1, ("end",))
                self._loops -= 1
                self._expect("end")
            case "global" | "local":
                self._at += 1
                self._assignment(depth, self._name())
            case "return":
                self._at += 1
                value = "None" if self._next.kind == "newline" else self._expression()
                self._put(depth, f"return {value}", line)
            case "break" | "continue":
                if not self._loops:
                    raise self._fault("a statement; this one stands in no loop")
                self._at += 1
                self._put(depth, word, line)
            case "halt":
                self._at += 1
                self._put(depth, "_halt()", line)
            case "kill" | "join":
                self._at += 1
                thread = self._expression()
                self._put(depth, f"_kill({thread})" if word == "kill" else f"(yield from _join({thread}))", line)
            case "enter_critical" | "exit_critical" | "pass":  # threads take turns at cycles alone
                self._at += 1
                self._put(depth, "pass", line)
            case _ if self._next.kind == "name" and self._tokens[self._at + 1].text == "=":
                self._assignment(depth, self._name())
            case _:
                self._element_or_call(depth, line)
        if word not in OPENING:
            self._end_of_line()

    def _element_or_call(self, depth: int, line: int) -> None:
        left = self._expression()
        if self._accept("="):
            if not left.startswith("_item("):
                raise ScriptError(f"line {line}: expected a variable or an element on the left of =")
            value = self._expression()
            self._put(depth, f"_put({left[len('_item(') : -1]}, {value})", line)
        else:
            self._put(depth, left, line)

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
        while self._sees("elif"):
            line = self._take().line
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
        line = self._take().line
        name, arguments = self._name(), set[str]()
        self._expect("(")
        given = list[str]()
        while not self._accept(")"):
            argument = self._name()
            arguments.add(argument)
            given.append(f"v_{argument}={self._expression()}" if self._accept("=") else f"v_{argument}")
            if not self._sees(")"):
                self._expect(",")
        self._expect(":")
        loops, self._loops = self._loops, 0
        plain, local, _ = assigned(self._tokens[self._at :])
        self._scopes.append(arguments | local | plain - self._globals)
        self._put(depth, f"def f_{name}({', '.join(given)}):", line)
        self._put(depth + 1, "_turn()", line)
        self._body(depth + 1, ("end",))
        self._put(depth + 1, "if False: yield", self._next.line)
        self._scopes.pop()
        self._loops = loops
        self._expect("end")

    # expressions

    def _expression(self) -> str:
        left = self._conjunction()
        while self._sees("or", "xor"):
            word = self._take().text
            right = self._conjunction()
            left = f"(_true({left}) or _true({right}))" if word == "or" else f"(_true({left}) != _true({right}))"
        return left

    def _conjunction(self) -> str:
        left = self._negation()
        while self._accept("and"):
            left = f"(_true({left}) and _true({self._negation()}))"
        return left

    def _negation(self) -> str:
        if self._accept("not"):
            return f"(not _true({self._negation()}))"
        left = self._sum()
        while self._sees("==", "!=", "<", ">", "<=", ">="):
            sign = self._take().text
            left = f"_compare({sign!r}, {left}, {self._sum()})"
        return left

    def _sum(self) -> str:
        left = self._product()
        while self._sees("+", "-"):
            sign = self._take().text
            left = f"_arithmetic({sign!r}, {left}, {self._product()})"
        return left

    def _product(self) -> str:
        left = self._unary()
        while self._sees("*", "/", "%"):
            sign = self._take().text
            left = f"_arithmetic({sign!r}, {left}, {self._unary()})"
        return left

    def _unary(self) -> str:
        if self._accept("-"):
            return f"_arithmetic('*', -1, {self._unary()})"
        if self._accept("+"):
            return self._unary()
        found = self._primary()
        while self._sees("["):
            self._at += 1
            index = self._expression()
            while self._accept(","):
                index = f"({index}, {self._expression()})"
            self._expect("]")
            found = f"_item({found}, {index})"
        return found

    def _primary(self) -> str:
        token = self._take()
        if token.kind == "number":
            return _number(token)
        if token.kind == "text":
            return repr(token.text[1:-1])
        if token.kind == "word" and token.text in ("True", "False"):
            return token.text
        if token.text == "run" and token.kind == "word":
            name = self._name()
            if name not in self._own:
                raise ScriptError(f"line {token.line}: run {name}: expected a thread of this script")
            return f"_run({name!r}, f_{name}({', '.join(self._arguments('v_'))}))"
        if token.text == "(":
            inner = self._expression()
            self._expect(")")
            return f"({inner})"
        if token.text == "[":
            return f"[{', '.join(self._until(']'))}]"
        if token.kind == "name" and token.text == "p" and self._accept("["):
            inside = list(self._until("]"))  # a variable may be called p, too
            if len(inside) in (1, 2):
                index = inside[0] if len(inside) == 1 else f"({', '.join(inside)})"
                return f"_item({self._variable('p')}, {index})"
            return f"_Pose([{', '.join(inside)}])"
        if token.kind == "name":
            return self._call(token) if self._sees("(") else self._variable(token.text)
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


def _number(token: Token) -> str:
    text = token.text
    if not (text.isdigit() or text.startswith("0x")):
        return repr(float(text))
    # Python reads a decimal of thousands of digits slowly, or not at all
    digits = text[2:] if text.startswith("0x") else text
    if len(digits.lstrip("0")) > DIGITS:
        raise ScriptError(f"line {token.line}: expected an integer of 32 bits, found one of {len(digits)} digits")
    return str(int(digits, 16 if text.startswith("0x") else 10))


DIGITS: Final = 10
"""Of an integer, which has 32 bits."""


def transpiled(text: str, known: frozenset[str], waiting: frozenset[str]) -> Transpiled:
    """A script as Python.

    Parameters
    ----------
    known, waiting
        Functions that the robot has, and those of them that take time.

    Raises
    ------
    ScriptError
        It is no URScript, or holds what is not understood; the text tells the line.
    """
    try:
        return _Reader(text, known, waiting).read()
    except RecursionError:
        raise ScriptError("script: expressions within expressions, more than can be read") from None
