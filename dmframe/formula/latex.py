r"""Numeric evaluation of LaTeX formulas in docstrings, for comparison with the code.

The grammar: sums, products by juxtaposition or ``\cdot``, quotients, brackets, ``\frac``, ``|a|^2_W`` (bars of any
kind), ``\top``, ``^{-1}``, powers, ``bmatrix``, common functions, and names as in `dmframe.common.names`. A product is
evaluated from right to left; a column that is not its last factor means a diagonal matrix.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from keyword import iskeyword
from typing import Any, Final, final

import numpy as np

from dmframe.common.names import LETTERS, Symbol, unicode_symbol
from dmframe.formula.matrices import (
    Eye,
    Numbers,
    UnreadableLatexError,
    added,
    as_matrix,
    block_matrix,
    inverted,
    multiplied,
    scaled,
    stacked,
)

_TOKEN: Final = re.compile(r"\\[A-Za-z]+|\\.|\d+(?:\.\d+)?|[A-Za-z]|\S")
_BLANK: Final = (
    "\\ ",
    *r"\, \; \! \: \quad \qquad \left \right \middle \big \Big \bigl \bigr \Bigl \Bigr \cdot ~ &".split(),
)
_BARS: Final = dict.fromkeys(("\\lVert", "\\rVert", "\\lvert", "\\rvert", "\\Vert", "\\vert", "\\|"), "|")
"""Other delimiters of a norm."""
_ACCENTS: Final = ("hat", "bar", "tilde", "dot", "ddot")
_ALIAS: Final = {"varepsilon": "epsilon", "varphi": "phi", "vartheta": "theta"}
_FUNCTIONS: Final[Mapping[str, Callable[..., Numbers]]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "tanh": np.tanh, "exp": np.exp, "log": np.log,
    "sgn": np.sign, "abs": np.abs, "sqrt": np.sqrt, "min": np.minimum, "max": np.maximum,
    "floor": np.floor, "diag": lambda a: np.diagflat(a), "vec": lambda a: np.reshape(a, (-1, 1), order="F"),
    "clip": lambda a, v: np.clip(a, -v, v),
}  # fmt: skip
"""Functions by the word after the backslash, or in operatorname."""


def tokens(text: str) -> list[str]:
    """The words of a formula, without blanks."""
    inside = re.sub(
        r"\\begin\{[bp]matrix\}.*?\\end\{", lambda found: found[0].replace("&", "\\cell "), text, flags=re.DOTALL
    )
    return [_BARS.get(token, token) for token in _TOKEN.findall(inside) if token not in _BLANK]


Look = Callable[[Symbol], Numbers | None]
"""Returns the value of a name, or None."""
Call = Callable[[Symbol, Sequence[Numbers]], Numbers | None]
"""Returns the value of a function of the robot, J(q), or None."""


def evaluate(words: Sequence[str], look: Look, call: Call) -> Any:
    """The value of a formula. Raises `UnreadableLatexError`."""
    reader = LatexReader(words, look, call)
    value = reader.sum()
    if reader.rest():
        word, _, more = reader.rest().partition(" ")
        raise UnreadableLatexError(f"{word} is not understood here, before {more or 'the end'}")
    return value if isinstance(value, Eye) else as_matrix(value)


_IN_WORDS: Final = {"\\top": "ᵀ", "\\sqrt": "√", "\\ge": "≥", "\\le": "≤", "\\cdot": "·", "\\to": "→", "-": "−"}


_RELATIONS: Final = ("=", "+", "\\ge", "\\le", "\\to", "<", ">")


def in_unicode(text: str) -> str:
    """A short formula of a docstring's text for a terminal: names as symbols, the rest unchanged."""
    reader, out = LatexReader(tokens(text), lambda symbol: None, lambda symbol, arguments: None), ""
    while reader.rest():
        found, word = reader.named_or_word()
        spaced = found is not None and bool(re.search(r"[^\W_]$|[\u0300-\u036f)]$", out))
        binary = found is None and (word in _RELATIONS or (word == "-" and re.search(r"[\w\u0300-\u036f)]$", out)))
        text = unicode_symbol(found) if found is not None else _IN_WORDS.get(word, word)
        out += f" {text} " if binary else " " * spaced + text
    return re.sub(r" +", " ", out).replace("^ᵀ", "ᵀ").strip()


def name_in(words: Sequence[str]) -> tuple[Symbol, bool] | None:
    """The name on a left-hand side, and true for an initial value, ``w(0)``; None if it is more than a name."""
    reader = LatexReader(words, lambda symbol: None, lambda symbol, arguments: None)
    symbol = reader.symbol()
    return (symbol, symbol.start) if symbol is not None and not reader.rest() else None


@final
class LatexReader:
    """Reads words from left to right."""

    def __init__(self, words: Sequence[str], look: Look, call: Call) -> None:
        self._words, self._place, self._look, self._call = list(words), 0, look, call

    def rest(self) -> str:
        """The words that have not been read."""
        return " ".join(self._words[self._place :])

    def named_or_word(self) -> tuple[Symbol | None, str]:
        """The next name, or else the next word."""
        start = self._place
        found = self.symbol()
        if found is None:
            self._place = start
            return None, self._take()
        return found, ""

    def _next(self) -> str:
        return self._words[self._place] if self._place < len(self._words) else ""

    def _take(self) -> str:
        word = self._next()
        self._place += 1
        return word

    def _expect(self, word: str) -> None:
        if self._take() != word:
            raise UnreadableLatexError(f"{word} is missing before {self.rest() or 'the end'}")

    def sum(self) -> Any:
        """Terms with their signs."""
        total: Any = None
        while True:
            sign = 1.0
            if self._next() in ("+", "-"):
                sign = -1.0 if self._take() == "-" else 1.0
            elif total is not None:
                return total
            term = scaled(sign, self.product())
            total = term if total is None else added(total, term)

    def product(self) -> Any:
        """Factors side by side, and quotients."""
        factors = [self.factor()]
        while self._next() not in _ENDS:
            if self._next() == "/":
                self._take()
                factors.append(inverted(self.factor()))
            else:
                factors.append(self.factor())
        value = factors[-1]
        for factor in reversed(factors[:-1]):
            value = multiplied(factor, value)
        return value

    def factor(self) -> Any:
        """A base with its exponents and indices."""
        word = self._next()
        if word == "|":
            return self._norm()
        return self._raised(self._base())

    def _raised(self, value: Any) -> Any:
        while self._next() in ("^", "'"):
            if self._take() == "'":
                raise UnreadableLatexError("a prime has no meaning here; write \\top or \\dot")
            power = self._group()
            if power in (["\\top"], ["T"]):
                value = as_matrix(value).T
            elif power == ["-", "1"]:
                value = inverted(value, matrix=True)
            elif len(power) == 1 and power[0].isdigit():
                value = as_matrix(value) ** int(power[0])
            else:
                raise UnreadableLatexError(f"the exponent {' '.join(power)} is not understood")
        return value

    def _group(self) -> list[str]:
        r"""The words in braces, or one word; ``\dot q`` and the like count as one."""
        if self._next() != "{":
            word = self._take()
            if not word:
                raise UnreadableLatexError("it ends too early")
            if word.startswith("\\") and word[1:] in (*_ACCENTS, "mathrm", "bm", "mathbf"):
                return [word, *self._braced()]
            return [word]
        return self._braced()[1:-1]

    def _braced(self) -> list[str]:
        """The group, with its braces."""
        if self._next() != "{":
            return [self._take()]
        depth, start = 0, self._place
        while True:
            word = self._take()
            if not word:
                raise UnreadableLatexError("a brace is not closed")
            depth += {"{": 1, "}": -1}.get(word, 0)
            if depth == 0:
                return self._words[start : self._place]

    def _of(self, words: Sequence[str]) -> Any:
        return evaluate(words, self._look, self._call)

    def _base(self) -> Any:
        word = self._next()
        if re.fullmatch(r"\d+(?:\.\d+)?", word):
            return np.array([[float(self._take())]])
        if word in ("(", "[", "\\{"):
            close = {"(": ")", "[": "]", "\\{": "\\}"}[self._take()]
            parts = [self.sum()]
            while self._next() == ",":
                self._take()
                parts.append(self.sum())
            self._expect(close)
            return parts[0] if len(parts) == 1 else stacked(parts)
        if word == "{":
            return self._of(self._group())
        if word in ("\\frac", "\\tfrac", "\\dfrac"):
            self._take()
            above, below = self._of(self._digit()), self._of(self._digit())
            return multiplied(inverted(below), above)
        if word == "\\begin":
            return self._bmatrix()
        function = self._function()
        if function is not None:
            return function
        return self._named()

    def _digit(self) -> list[str]:
        r"""An argument of \tfrac: each digit of ``12`` is one argument."""
        word = self._next()
        if word.isdigit() and len(word) > 1:
            self._words[self._place : self._place + 1] = list(word)
        return self._group()

    def _function(self) -> Any:
        start, word = self._place, self._next()
        if word in ("\\operatorname", "\\mathrm"):
            self._take()
            word = "\\" + "".join(self._group())
        elif word.startswith("\\"):
            self._take()
        name = word[1:]
        if not word.startswith("\\") or name not in _FUNCTIONS:
            self._place = start
            return None
        if self._next() == "(":
            return _FUNCTIONS[name](*self._arguments())
        if self._next() == "{":
            return _FUNCTIONS[name](self._of(self._group()))
        return _FUNCTIONS[name](self.factor())

    def _arguments(self) -> list[Numbers]:
        self._expect("(")
        found = [as_matrix(self.sum())]
        while self._next() == ",":
            self._take()
            found.append(as_matrix(self.sum()))
        self._expect(")")
        return found

    def _named(self) -> Any:
        first = self._place
        symbol = self.symbol()
        if symbol is None:
            raise UnreadableLatexError(f"{''.join(self._words[first : self._place]) or 'the end'} is not understood")
        value = self._look(symbol)
        if self._next() == "(":
            start = self._place
            try:
                arguments = self._arguments()
                found = self._call(symbol, arguments)
            except UnreadableLatexError:
                found = None
            if found is not None:
                return found
            self._place = start
        if value is not None:
            return value
        if symbol == Symbol("I"):
            return Eye(1.0)
        name = spelled(symbol)
        hint = f"; in code it is {name}_, since {name} is a word of Python" if iskeyword(name) else ""
        raise UnreadableLatexError(f"the name {name} is unknown{hint}")

    def symbol(self) -> Symbol | None:
        """A name with its accents, index and start."""
        word = self._take()
        accents = list[str]()
        while word.startswith("\\") and word[1:] in _ACCENTS:
            accents.insert(0, word[1:])
            inner = self._group()
            if len(inner) > 1:
                found = LatexReader(inner, self._look, self._call).symbol()
                if found is None:
                    return None
                index, word = list(found.index), found.letter
                accents = [*found.accents, *accents]
                return self._rest_of_name(word, accents, index)
            word = inner[0]
        return self._rest_of_name(word, accents, [])

    def _rest_of_name(self, word: str, accents: list[str], index: list[str]) -> Symbol | None:
        letter = _ALIAS.get(word.removeprefix("\\"), word.removeprefix("\\"))
        if word in ("\\mathrm", "\\operatorname"):
            letter = "".join(self._group()).replace("\\_", "_")
        elif (
            (word.startswith("\\") and letter not in LETTERS)
            or not letter.replace("_", "").isalnum()
            or letter.isdigit()
        ):
            return None
        if letter == "Delta" and self._next() and self._next() not in _ENDS:
            inner = self.symbol()  # the difference of something is one name
            return None if inner is None else Symbol(f"Delta {inner.letter}", inner.accents, inner.index, inner.start)
        while self._next() in ("_", "^"):
            if self._next() == "^" and self._words[self._place + 1 : self._place + 2] not in (["+"], ["*"], ["\\star"]):
                break
            mark = self._take()
            index += ["^+" if mark == "^" and item in "+*" else item for item in _index(self._group())]
        start = self._words[self._place : self._place + 3] == ["(", "0", ")"]
        if start:
            self._place += 3
        if tuple(accents[-2:]) == ("dot", "dot"):
            accents[-2:] = ["ddot"]
        return Symbol(letter, tuple(accents), tuple(index), start)

    def _norm(self) -> Any:
        """|a|, |a|^2, |a|^2_W."""
        self._expect("|")
        inner = list[str]()
        while self._next() != "|":
            if not self._next():
                raise UnreadableLatexError("a norm is not closed")
            inner.append(self._take())
        self._take()
        vector, weight, squared = as_matrix(self._of(inner)), None, False
        while self._next() in ("^", "_"):
            if self._take() == "^":
                squared = self._group() == ["2"]
            else:
                weight = self._of(self._group())
        if weight is not None and not squared:
            raise UnreadableLatexError("a weighted norm is written with its square, |a|^2_W")
        form = vector.T @ as_matrix(multiplied(1.0 * np.ones((1, 1)) if weight is None else weight, vector))
        return form if squared else np.sqrt(form)

    def _bmatrix(self) -> Numbers:
        self._take()
        if self._group() not in (list("bmatrix"), list("pmatrix")):
            raise UnreadableLatexError("bmatrix is the only supported environment")
        words = self._words[self._place :]
        end = words.index("\\end") if "\\end" in words else len(words)
        self._place += end
        self._expect("\\end")
        self._group()
        rows = [_split(row, "\\cell") for row in _split(words[:end], "\\\\")]
        return block_matrix([[self._of(cell) for cell in row] for row in rows])


_ENDS: Final = ("", "+", "-", ")", "]", "\\}", ",", "=", "}")


def _index(words: list[str]) -> list[str]:
    r"""``d,nominal`` of ``{d,\mathrm{nominal}}``."""
    text = "".join(word for word in words if word not in ("{", "}", "\\mathrm", "\\text"))
    return [item.removeprefix("\\") for item in text.split(",")]


def spelled(symbol: Symbol) -> str:
    """A name for a message."""
    text = "_".join([symbol.letter, *symbol.index]).replace("_^", "^")
    for accent in symbol.accents:
        text = rf"\{accent}{{{text}}}"
    return text


def _split(words: Sequence[str], mark: str) -> list[list[str]]:
    parts: list[list[str]] = [[]]
    for word in words:
        if word == mark:
            parts.append([])
        else:
            parts[-1].append(word)
    return parts
