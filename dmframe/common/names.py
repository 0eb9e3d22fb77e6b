"""Names of the code as a reader writes them: ``a_d_hat``, ``ddq_ref``, ``K_star``, ``alpha_bar``."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from keyword import iskeyword
from typing import Final, NamedTuple, final


class Element(NamedTuple):
    """One element of a dimension of a shape, such as one dynamic parameter: its name in results, and its unit."""

    name: str
    unit: str = ""


LETTERS: Final = {
    name: letter
    for names, letters in (
        ("alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi", "αβγδεζηθικλμνξ"),
        ("pi rho sigma tau phi chi psi omega", "πρστφχψω"),
        ("Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega", "ΓΔΘΛΞΠΣΦΨΩ"),
    )
    for name, letter in zip(names.split(), letters, strict=True)
}
"""Greek letters, by their names in code and LaTeX."""

_NAMES: Final = {letter: name for name, letter in LETTERS.items()}

ACCENTS: Final = {"hat": "hat", "bar": "bar", "err": "tilde"}
"""Words of a name that are printed above its letter, by their LaTeX."""

_COMBINING: Final = {"hat": "\u0302", "bar": "\u0304", "tilde": "\u0303", "dot": "\u0307", "ddot": "\u0308"}
_START: Final = "(0)"


@final
@dataclass(frozen=True)
class Symbol:
    r"""A name taken apart: :math:`\dot{\hat a}_{d}` has the letter a, the accents hat and dot, the index d.

    Parameters
    ----------
    letter
        A letter, the name of a Greek one, or a word.
    accents
        LaTeX accents, the innermost first.
    index
        Words below.
    start
        It is the value at the start, ``w(0)``.
    """

    letter: str
    accents: tuple[str, ...] = ()
    index: tuple[str, ...] = ()
    start: bool = False


@cache
def symbol(name: str) -> Symbol:
    """Split a name. A name of words only, ``maker_gravity``, stays one word.

    A Greek letter is its name, and the underscore that makes a name of Python's keyword ``lambda`` is not printed.
    """
    start = name.endswith(_START)
    if "." in name:  # the label of a signal
        return Symbol(name)
    plain = name.removesuffix(_START)
    head, *tail = (plain.removesuffix("_") if iskeyword(plain.removesuffix("_")) else plain).split("_")
    head = _NAMES.get(head, head)
    above = [ACCENTS[word] for word in tail if word in ACCENTS]
    below = tuple(word for word in tail if word not in ACCENTS)
    dots = re.match(r"d{1,2}", head)
    if dots and (len(head[dots.end() :]) == 1 or head[dots.end() :] in LETTERS):
        head, above = head[dots.end() :], [*above, "dot" if dots.end() == 1 else "ddot"]
    numbered = re.fullmatch(r"([A-Za-z])(\d+)", head)
    if numbered:
        head, below = numbered[1], (numbered[2], *below)
    if len(head) > 1 and head not in LETTERS and not above:
        return Symbol("_".join([head, *below]), start=start)
    return Symbol(head, tuple(above), below, start)


def latex_name(name: str, accent: str = "") -> str:
    """A name as LaTeX, with another accent on top."""
    taken = _accented(symbol(name), accent)
    text = _latex_letter(taken.letter)
    for accent in taken.accents:
        text = rf"\{accent}{{{text}}}"
    if taken.index:
        text = f"{text}_{{{','.join(map(_latex_word, taken.index))}}}"
    return text + _START * taken.start


def _latex_letter(letter: str) -> str:
    if letter in LETTERS:
        return rf"\{letter}"
    word = letter.replace("_", r"\_")
    return letter if len(letter) == 1 else rf"\mathrm{{{word}}}"


def _latex_word(word: str) -> str:
    if word == "star":
        return r"\star"
    return _latex_letter(word) if not word.isdigit() else word


def _accented(symbol: Symbol, accent: str) -> Symbol:
    """With one accent more; the dot of a dot is two dots."""
    if not accent:
        return symbol
    if accent == "dot" and symbol.accents[-1:] == ("dot",):
        return replace(symbol, accents=(*symbol.accents[:-1], "ddot"))
    return replace(symbol, accents=(*symbol.accents, accent))


def unicode_name(name: str, accent: str = "") -> str:
    """A name for a terminal or a drawing, with another accent on top: ``q̇_ref``, ``τ_dc``, ``â_d``."""
    return unicode_symbol(_accented(symbol(name), accent))


def unicode_symbol(taken: Symbol) -> str:
    """A name that is taken apart, for a terminal or a drawing."""
    text = LETTERS.get(taken.letter, taken.letter) + "".join(_COMBINING[accent] for accent in taken.accents)
    if taken.index:
        text += "_" + ",".join(LETTERS.get(word, "⋆" if word == "star" else word) for word in taken.index)
    return unicodedata.normalize("NFC", text) + _START * taken.start


def distinct(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of different names that print alike: one symbol would have two meanings."""
    seen = dict[str, str]()
    printed = ((unicode_name(name), name) for name in names)  # alpha and its letter too
    return [(seen[key], name) for key, name in printed if key in seen or seen.setdefault(key, name) != name]


def look_alikes(name: str) -> str:
    """The letters of a name that are neither Latin nor Greek ones of `LETTERS`: some look like those."""
    return "".join(letter for letter in name if not letter.isascii() and letter not in LETTERS.values())
