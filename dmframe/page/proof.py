"""The certificate of a page's claim, and the program that checks it in the reader's browser."""

from __future__ import annotations

import base64
import re
import zlib
from collections import Counter
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import product
from string import ascii_letters
from typing import Final, final

from dmframe.certify import Verdict
from dmframe.certify.published import certificate_text
from dmframe.config import BaseGraph

NODE: Final = "\nif (typeof module"
"""Start of the lines of `check.js` that run in Node alone."""


@final
@dataclass(frozen=True)
class Proof:
    """Certificate and checker, each deflated, in base64; empty without a proof.

    Parameters
    ----------
    certificate
        The certificate file.
    checker
        The text of `script`.
    script
        `check.js`, which the page's content security policy allows by its hash.
    """

    certificate: str = ""
    checker: str = ""
    script: str = ""


def proof_of(graph: BaseGraph, verdict: Verdict) -> Proof:
    """Proof of a graph that is proved; otherwise an empty one."""
    if verdict.claim is None or verdict.exact is None or verdict.outcome != "proved":
        return Proof()
    certificate = certificate_text(verdict, {"graph": graph.name}, graph.intervals())
    return Proof(packed(certificate), packed(checker_script()), checker_script())


@cache
def checker_script() -> str:
    """`check.js` for a page: without comments, spaces, and what Node alone runs, and with short names."""
    script, _, _ = files("dmframe.checker").joinpath("check.js").read_text("utf-8").partition(NODE)
    page = files("dmframe.page").joinpath("web/proof.js").read_text("utf-8")
    return shortened(script, frozenset(_WORD.findall(page)))


_TOKEN: Final = re.compile(r"""//[^\n]*|"[^"\n]*"|`[^`]*`|/\^[^\n]*?/(?=\.)|[A-Za-z_$][\w$]*|\d\w*|\s+|.""", re.DOTALL)
_WORD: Final = re.compile(r"[A-Za-z_$][\w$]*")
_CODE: Final = re.compile(r"(\$\{[^}]*\})")
_GIVEN: Final = frozenset(
    "const let class extends constructor return this new for of in if else while continue break throw try catch "
    "typeof instanceof null true false undefined switch case function yield static globalThis crypto getRandomValues "
    "Uint32Array Uint8Array Math min max abs ceil log2 round sqrt floor BigInt Number String Array Object keys values "
    "entries assign hasOwn fromEntries Map Set Error get set has add delete map filter flatMap flat forEach reduce "
    "every some find includes indexOf join split slice push length fill sort reverse test toString name message "
    "isArray isSafeInteger from splice asUintN "
    "as do is".split()
)
"""Names of the language and of its library that a script may use."""


def shortened(script: str, public: frozenset[str] = frozenset()) -> str:
    """A script without comments and spaces, and with names of one or two letters.

    Names that occur in a text stay, since they may be keys of data, and so do those of the language and `public` ones.
    The script has a semicolon after each statement, and regular expressions that begin with ``/^``.
    """
    tokens, spaced = list[str](), False
    for token in _TOKEN.findall(script):
        if not token.isspace() and not token.startswith("//"):
            if spaced and tokens and (_joins(tokens[-1], token) or tokens[-1] == token in ("+", "-")):
                tokens.append(" ")
            tokens.append(token)
        spaced = token.isspace()
    parts = [part for token in tokens for part in _parts(token)]
    texts = " ".join(text for is_code, text in parts if not is_code)
    inner = " ".join(text for is_code, code in parts if is_code for text in re.findall(r'"[^"]*"', code))
    kept = {*_WORD.findall(texts), *_WORD.findall(inner), *public, *_GIVEN}
    used = Counter(word for is_code, code in parts if is_code for word in _WORD.findall(code))
    long = [word for word, _ in used.most_common() if len(word) > 2 and word not in kept]
    words = (word for n in (1, 2) for word in map("".join, product(ascii_letters, repeat=n)))
    short = dict(zip(long, (word for word in words if word not in used and word not in kept), strict=False))

    def renamed(code: str) -> str:
        return _WORD.sub(lambda found: short.get(found[0], found[0]), code)

    return "".join(renamed(text) if is_code else text for is_code, text in parts)


def _joins(left: str, right: str) -> bool:
    return all(character.isalnum() or character in "_$" for character in (left[-1], right[0]))


def _parts(token: str) -> list[tuple[bool, str]]:
    """A token, or the texts and the code of a template, each with True if it is code."""
    if token[0] == "`":
        return [(k % 2 == 1, part) for k, part in enumerate(_CODE.split(token))]
    return [(token[0] != '"' and token[:2] != "/^", token)]


def packed(text: str) -> str:
    """Compress for DecompressionStream("deflate") of a browser."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()
