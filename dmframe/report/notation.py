r"""Formulas in code notation, ``J'(x - x_d)/2 - sigma/gamma``, as LaTeX or Unicode, alone and within sentences.

A *marked text* is a sentence with formulas between dollar signs and code between backticks, the source of HTML and
Markdown. A terminal shows the same formulas in Unicode.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from dmframe.formula import PrintedLaw
from dmframe.names import LETTERS, latex_name, unicode_name

_DOTS: Final = {1: r"\dot", 2: r"\ddot"}
_SIGNS: Final = {">=": r"\ge ", "<=": r"\le ", "*": r"\,", "~": r"\sim "}
_UNICODE_SIGNS: Final = {">=": "≥", "<=": "≤", "-": "−", "*": "·"}
_ARTICLES: Final = frozenset({"a", "A", "I", "s"})
_TOKEN: Final = re.compile(
    r"(?P<rate>\bd(?P<of>[A-Z])/dt\b)|(?P<over>/dt\b)|(?P<name>[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*)(?P<primes>'*)|"
    r"(?P<comma>,)|(?P<weighted>\|_(?P<by>[A-Z])\^2)|(?P<number>\d+(?:\.\d+)?)|(?P<close>\))(?P<after>'*)|(?P<sign>>=|<=|[-+/*^|(=<>])|(?P<blank>\s+)"
)

_LABEL: Final = re.compile(r"\b[\w-]+\.\w+:\d+|\\[A-Za-z]+[^:\s]*|\b(d )?[A-Za-z]\w*\.[A-Za-z]\w*(?(1)/dt)")
"""``inverse.w``, ``d inverse.w/dt``, ``my_block.py:12`` and LaTeX of a block author."""


def signal_latex(text: str, laws: Mapping[str, PrintedLaw]) -> str:
    """Signal of a statement as LaTeX, looked up among the formulas of the laws by its text."""
    known = _known(laws)
    if text in known:
        return known[text]
    inner = re.fullmatch(r"d\((.*)\)/dt", text)
    if inner:
        return rf"\tfrac{{d}}{{dt}} ({signal_latex(inner[1], laws)})"
    of_block = re.fullmatch(r"(.*) \((\w+)\)", text)
    if of_block and of_block[2] in laws:
        return rf"{signal_latex(of_block[1], laws)} \;\text{{({_escaped(of_block[2])})}}"
    return latex(text)


def _known(laws: Mapping[str, PrintedLaw]) -> dict[str, str]:
    """LaTeX of the vectors and norms in the terms of the certificates, by their text."""
    formulas = [formula for law in laws.values() for formulas in law.driven for formula in formulas]
    for law in laws.values():
        for term in (*law.storage, *law.dissipation, *law.excess):
            formulas += [term.vector, *([term.by] if term.by is not None else [])]
    return {formula.text: formula.latex for formula in formulas}


def in_unicode(text: str) -> str:
    """Formula in code notation as Unicode; other text is unchanged."""
    pieces, place = list[str](), 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            pieces.append(text[place])
            place += 1
            continue
        pieces.append(_unicode_piece(token))
        place = token.end()
    return "".join(pieces).replace("^2", "²")


def _unicode_piece(token: re.Match[str]) -> str:
    if token["rate"]:
        return unicode_name(token["of"], "dot")
    if token["name"]:
        name, primes = token["name"], len(token["primes"])
        if primes and name[0].isupper():
            return f"{unicode_name(name)}ᵀ"
        return unicode_name(name, {0: "", 1: "dot"}.get(primes, "ddot"))
    if token["weighted"]:
        return f"|²_{token['by']}"
    if token["close"]:
        return ")" + ("ᵀ" if token["after"] else "")
    return _UNICODE_SIGNS.get(token.group(), token.group())


def latex(text: str) -> str:
    r"""Formula in code notation as LaTeX; other text becomes ``\text{}``."""
    pieces, place = list[str](), 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None or not _is_formula(token, text):
            return rf"\text{{{_escaped(text)}}}"
        place = token.end()
        calls = token["name"] and not token["primes"] and text[place : place + 1] == "("
        pieces.append(_piece(token).rstrip() if calls else _piece(token))
    return re.sub(r" (?=[)^/,]|\|\^)|(?<=[A-Za-z]) (?=\()", "", " ".join("".join(pieces).split()))


def _escaped(text: str) -> str:
    return re.sub(r"([#$%&_{}])", r"\\\1", text)


def _is_formula(token: re.Match[str], text: str) -> bool:
    name = token["name"]
    if name is None:
        return True
    if name == "do" or name.endswith("_box") or (token["primes"] and text[token.end() : token.end() + 1].islower()):
        return False
    if text[token.end() : token.end() + 1] == "(":  # a function: tool(a_k)
        return True
    head = name.split("_")[0]
    return len(head) == 1 or head in LETTERS or re.fullmatch(r"d{1,2}[a-z]", head) is not None


def _piece(token: re.Match[str]) -> str:
    if token["rate"]:
        return rf"\dot {token['of']} "
    if token["name"]:
        return _primed(token["name"], len(token["primes"])) + " "
    if token["close"]:
        return ")" + (r"^{\top} " if token["after"] else "")
    if token["over"]:
        return "/dt "
    if token["comma"]:
        return r",\; "
    if token["weighted"]:
        return f"|^2_{token['by']} "
    if token["sign"]:
        return _SIGNS.get(token["sign"], f"{token['sign']}")
    return " " if token["blank"] else token["number"]


def _primed(name: str, primes: int) -> str:
    """Name with primes: J' is a transpose, z'' a second derivative."""
    if not primes:
        return latex_name(name)
    if name[0].isupper():
        return f"{latex_name(name)}^{{\\top}}"
    return f"{_DOTS.get(primes, _DOTS[2])}{{{latex_name(name)}}}"


def marked(text: str) -> str:
    """Convert a sentence to marked text: detected formulas, names with an underscore as code."""
    signs = {"formula": lambda part: f"${latex(part)}$", "code": lambda part: f"`{part}`"}
    return "".join(signs[kind](part) if kind in signs else part for kind, part in _parts(text))


def spelled(text: str) -> str:
    """Convert a sentence for a terminal: detected formulas in Unicode."""
    return "".join(in_unicode(part) if kind == "formula" else part for kind, part in _parts(text))


def _parts(text: str) -> Iterator[tuple[str, str]]:
    """Split a sentence into formulas, code and words."""
    run, place = list[re.Match[str]](), 0
    while place < len(text):
        label = _LABEL.match(text, place)
        if label is not None:
            yield from _finished(run)
            run.clear()
            yield "code", label.group()
            place = label.end()
            continue
        token = _TOKEN.match(text, place)
        in_word = place > 0 and text[place - 1].isalpha() and not (run and run[-1].end() == place)
        if token is not None and not in_word and _goes_on(run, token, text):
            run.append(token)
            place = token.end()
            continue
        yield from _finished(run)
        run.clear()
        word = re.match(r"[A-Za-z0-9_'-]+|.", text[place:], re.DOTALL)
        assert word is not None  # the second alternative matches any character
        yield "code" if "_" in word.group() else "words", word.group()
        place += word.end()
    yield from _finished(run)


def marked_prose(text: str) -> str:
    """Mark the formulas in the unmarked parts of a marked text."""
    pieces = re.split(r"(\$[^$]+\$|`[^`]+`)", text)
    return "".join(piece if place % 2 else marked(piece) for place, piece in enumerate(pieces))


def _goes_on(run: Sequence[re.Match[str]], token: re.Match[str], text: str) -> bool:
    """True if a formula can start or continue with this token; a comma only inside brackets."""
    if token["comma"]:
        source = "".join(known.group() for known in run)
        return source.count("(") > source.count(")")
    return _is_formula(token, text) and not _ends_a_word(token, text)


def _ends_a_word(token: re.Match[str], text: str) -> bool:
    """True for a token that starts a word such as ``x-axis``."""
    rest = text[token.end() :]
    return bool(token["name"]) and re.match(r"-[a-z]{2}|'[a-z]", rest) is not None


def _finished(run: list[re.Match[str]]) -> Iterator[tuple[str, str]]:
    """Formula of a run of tokens; blanks and unmatched brackets at its ends become words."""
    source = "".join(token.group() for token in run)
    names = [token["name"] for token in run if token["name"]]
    signs = any(token["sign"] in ("+", "=", "<", ">", ">=", "<=", "/", "^", "|", "-") for token in run)
    rates = any(token["rate"] for token in run)
    if not rates and (not names or (not signs and all(name in _ARTICLES for name in names))):
        yield "words", source.replace("<=", "≤").replace(">=", "≥")
        return
    body = source.strip()
    start, end = source.index(body), source.index(body) + len(body)
    while end > start and (source[end - 1] in "-+/*^=<> (" or _open(source[start:end], ")")):
        end -= 1
    while start < end and (source[start] == " " or _open(source[start:end], "(")):
        start += 1
    if _encloses(source[start:end]):
        start, end = start + 1, end - 1
    body = source[start:end]
    article = re.match(r"[aAI] (?=[A-Za-z(|])", body)
    if article:  # "a z" begins with the article, not with a matrix
        start, body = start + 2, body[2:]
    yield "words", source[:start]
    yield "formula", body
    yield "words", source[end:]


def _open(text: str, bracket: str) -> bool:
    """True for a text with an unmatched opening bracket at its start, or closing bracket at its end."""
    step = 1 if bracket == "(" else -1
    depth = 0
    for letter in text[::step]:
        depth += {"(": step, ")": -step}.get(letter, 0)
        if letter in "()" and depth == 0:
            return False
        if depth < 0:
            return False
    return text[::step][:1] == bracket and depth > 0


def _encloses(text: str) -> bool:
    """True if the first bracket is closed by the last character."""
    depth = 0
    for place, letter in enumerate(text):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if depth == 0:
            return letter == ")" and place == len(text) - 1
    return False
