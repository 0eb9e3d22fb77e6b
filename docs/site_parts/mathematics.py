r"""Formulas as MathML, made while the site is built: a browser sets them without a script, a font or a network."""

from __future__ import annotations

import re
from html import escape
from typing import Final

from dmframe.report.mathml import mathml, terms

_OUTER: Final = re.compile(
    r"^\s*\\begin\{(aligned|align\*?|split|gather\*?|equation\*?|eqnarray\*?)\}(.*)\\end\{\1\}\s*$", re.DOTALL
)
_TOKEN: Final = re.compile(r"\\(?:begin|end)\{\w+\*?\}|\\(?:left|right)\b|\\[a-zA-Z]+|\\.|.", re.DOTALL)
_TAG: Final = re.compile(r"\\tag\*?\{([^{}]*)\}")
_CAPITAL: Final = re.compile(r"<mi>(&#x003(?:9[1-9A-F]|A[0-9]);)</mi>")
"""Greek, which stands upright where Latin letters lean."""
_BIG: Final = re.compile(r"\\[bB]igg?[lrm]?(?![a-zA-Z])[ ]*")
"""A size of brackets, which grow with what they hold anyway."""
_SCRIPT: Final = re.compile(r'<mi mathvariant="script">([A-Z])</mi>')
_DEFINES: Final = re.compile(r"\\(?:DeclareMathOperator|newcommand|renewcommand|def)\b")
_UNKNOWN: Final = re.compile(r"<m\w+[^>]*>\\")
"""A command that the library does not know, and sets as it is typed."""
SCRIPT_CAPITALS: Final = "𝒜ℬ𝒞𝒟ℰℱ𝒢ℋℐ𝒥𝒦ℒℳ𝒩𝒪𝒫𝒬ℛ𝒮𝒯𝒰𝒱𝒲𝒳𝒴𝒵"


class MathError(Exception):
    """A formula that cannot be set."""


def inline(latex: str) -> str:
    """A formula within a line."""
    return _set(latex.strip(), display=False)


def display(latex: str) -> str:
    r"""Formulas of their own lines: one row for each ``\\``, aligned at ``&``, each with its ``\tag`` at the right."""
    outer = _OUTER.match(latex)
    rows = [row for row in _split(outer[2] if outer else latex, r"\\") if row.strip()]
    cells = [[part.strip() for part in _split(_TAG.sub("", row), "&")] for row in rows]
    tags = [_TAG.search(row) for row in rows]
    # a line that has fewer parts than others, such as one without an equals sign, goes on from the left
    wide = max((len(row) for row in cells), default=1)
    lines = []
    for row, tag in zip(cells, tags, strict=True):
        parts = [f"<td>{_set(part, display=True) if part else ''}</td>" for part in row[:-1]]
        parts.append(f'<td class="last">{_breakable(row[-1])}</td>')
        parts += ["<td></td>"] * (wide - len(row))
        number = f'<td class="tag">({escape(tag[1])})</td>' if tag else ""
        lines.append(f"<tr>{''.join(parts)}{number}</tr>")
    kind = "aligned" if wide > 1 else "single"
    return f'<div class="equations"><table class="{kind}" role="presentation">{"".join(lines)}</table></div>'


def _breakable(latex: str) -> str:
    """A formula in pieces, one a term, between which a narrow page may break it."""
    return "<wbr>".join(_set(piece, display=True, joined=place > 0) for place, piece in enumerate(terms(latex)))


def _set(latex: str, *, display: bool, joined: bool = False) -> str:
    if _DEFINES.search(latex):
        raise MathError(f"cannot set {latex}: it defines a command")
    braces = [token for token in _TOKEN.findall(latex) if token in "{}"]
    if braces.count("{") != braces.count("}"):
        raise MathError(f"cannot set {latex}: its braces do not match")
    found = mathml(_BIG.sub("", latex), display=display, joined=joined)
    if not found.startswith("<math") or _UNKNOWN.search(found):
        raise MathError(f"cannot set {latex}")
    # browsers know the letters, but not the attribute
    found = _SCRIPT.sub(lambda letter: f"<mi>{SCRIPT_CAPITALS[ord(letter[1]) - ord('A')]}</mi>", found)
    found = _CAPITAL.sub(r'<mi mathvariant="normal">\1</mi>', found)
    return found.replace("<mo>&#x022A4;</mo>", '<mi mathvariant="normal">T</mi>')


def _split(latex: str, mark: str) -> list[str]:
    """The parts of a formula between marks outside braces and environments."""
    parts, depth = [""], 0
    for token in _TOKEN.findall(latex):
        depth += {"{": 1, "}": -1}.get(token, 0)
        depth += token.startswith(r"\begin") - token.startswith(r"\end")
        if token == mark and depth == 0:
            parts.append("")
        else:
            parts[-1] += token
    return parts
