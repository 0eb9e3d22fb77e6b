r"""Formulas as MathML, generated while the site is built: a browser shows them without script, font or network."""

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


class MathError(Exception):
    """A formula that cannot be set."""


def inline(latex: str) -> str:
    """A formula within a line."""
    return _set(latex.strip(), display=False)


def display(latex: str) -> str:
    r"""Displayed formulas: one row for each ``\\``, aligned at ``&``, each with its ``\tag`` at the right."""
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
    found = mathml(latex, display=display, joined=joined)
    if not found.startswith("<math"):
        raise MathError(f"cannot set {latex}")
    return found


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
