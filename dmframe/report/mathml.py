r"""LaTeX as MathML, split into terms with line-break opportunities: browsers do not break formulas."""

from __future__ import annotations

import html
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Final

_TOKEN: Final = re.compile(
    r"\\(?:left|right)\s*(?:\\[a-zA-Z]+|\\.|.)|\\(?:begin|end)\{\w+\*?\}|\\[a-zA-Z]+|\\.|.", re.DOTALL
)
_DEPTH: Final = {"{": 1, "(": 1, "[": 1, "}": -1, ")": -1, "]": -1}
_BRACES: Final = {"{": 1, "}": -1}
LONG: Final = 120
"""Length [characters of LaTeX] above which a term may be broken inside its brackets."""
_WORDS: Final = re.compile(r"(?<=_)\{([A-Za-z]{2,})\}|\\mathrm\{([A-Za-z]+)\}")
_UNDERSCORED: Final = re.compile(r"\\operatorname\{([A-Za-z0-9]+(?:\\_[A-Za-z0-9]+)+)\}")
_FUNCTION: Final = re.compile(r"(</m(?:i|n|sub|sup|subsup|frac)>)(<m([io])>(?:sin|cos|tanh|min|max)</m\3>)")
_ACCENT: Final = re.compile(r"<mo[^>]*>&#x0(007E|02D9|00A8|00AF|005E);</mo></mover>")
_ACCENTS: Final = {"005E": "&#x02C6;", "007E": "&#x02DC;", "02D9": "&#x02D9;", "00A8": "&#x00A8;", "00AF": "&#x00AF;"}
"""Typographic accents instead of the ASCII signs ^ and ~."""
_LEADING: Final = re.compile(r"^(<math[^>]*><mrow><mo)>(?=&#x0(?:002B|2212|003D|2265|2264|00B1);)")
_ELEMENTS: Final = frozenset(
    "math menclose mfrac mi mn mo mover mpadded mphantom mroot mrow mspace msqrt mstyle msub msubsup msup mtable mtd "
    "mtext mtr munder munderover".split()
)
_ATTRIBUTES: Final = frozenset(
    "accent accentunder columnalign columnlines columnspacing depth display displaystyle fence form height largeop "
    "linethickness lspace mathbackground mathcolor mathsize mathvariant maxsize minsize movablelimits notation "
    "rowlines rowspacing rspace scriptlevel separator stretchy symmetric voffset width".split()
)
_SIGNS: Final = ("+", "-", "=", r"\ge", r"\le", r"\pm")


def mathml(latex: str, *, display: bool = False, joined: bool = False) -> str:
    """One formula as ``<math>``; LaTeX that cannot be converted becomes ``<code>``.

    `joined`: the formula continues a previous one, so a leading sign is an infix operator.
    """
    from latex2mathml.converter import convert

    try:
        text = convert(_prepared(latex))
        known = _is_mathml(text)
    except Exception:  # latex2mathml raises various errors; one plain formula is better than no report
        known = False
    if not known:
        return f"<code>{html.escape(latex)}</code>"
    text = text.replace(' xmlns="http://www.w3.org/1998/Math/MathML"', "")
    text = text.replace('display="inline"', 'displaystyle="true"' if display else 'displaystyle="false"', 1)
    text = text.replace("<mo>&#x0002F;</mo>", '<mo lspace="0.05em" rspace="0.05em">&#x0002F;</mo>')
    text = _FUNCTION.sub(r'\1<mspace width="0.167em"/>\2', text)
    text = _ACCENT.sub(lambda found: f'<mo stretchy="false">{_ACCENTS[found[1]]}</mo></mover>', text)
    text = text.replace("<mover>", '<mover accent="true">')
    if joined or latex.startswith(("=", r"\le", r"\ge")):
        text = _LEADING.sub(r'\1 form="infix">', text)
    return text


def _is_mathml(text: str) -> bool:
    r"""Check elements and attributes against a white list: latex2mathml passes markup in a ``\text``."""
    elements = list(ET.fromstring(text).iter())
    return all(each.tag.rpartition("}")[2] in _ELEMENTS and set(each.keys()) <= _ATTRIBUTES for each in elements)


def breakable(latex: str, *, display: bool = False) -> str:
    """Formula as one ``<math>`` a term, with line-break opportunities between them."""
    pieces = terms(latex)
    return "<wbr/>".join(mathml(piece, display=display, joined=place > 0) for place, piece in enumerate(pieces))


def terms(latex: str) -> list[str]:
    r"""Split a formula before signs outside brackets and at each ``\quad``; a long term inside ( ) too."""
    pieces = _cut(latex, _DEPTH)
    return [part for piece in pieces for part in (_cut(piece, _BRACES) if len(piece) > LONG else [piece])]


def _cut(latex: str, brackets: Mapping[str, int]) -> list[str]:
    pieces, current, depth, bars = list[str](), "", 0, False
    for token in _TOKEN.findall(latex):
        if token == "|":
            bars = not bars
        elif token.startswith((r"\left", r"\begin")) and token not in (r"\leftarrow", r"\le", r"\leq"):
            depth += 1
        elif token.startswith((r"\right", r"\end")):
            depth -= 1
        depth += brackets.get(token, 0)
        outside = depth == 0 and not bars
        if outside and token in _SIGNS and current.strip() and not current.strip().endswith((*_SIGNS, "(", "^")):
            pieces.append(current.strip())
            current = ""
        elif outside and token in (r"\quad", r"\qquad"):
            pieces.append(f"{current.strip()} {token}")
            current = ""
            continue
        current += token
    return [piece for piece in [*pieces, current.strip()] if piece]


def _prepared(latex: str) -> str:
    """Set words in indices upright, and bars that scale with their content."""
    latex = _UNDERSCORED.sub(lambda found: rf"{{\text{{{found[1]}}}}}".replace(r"\_", "_"), latex)
    latex = _WORDS.sub(lambda found: rf"{{\text{{{found[1] or found[2]}}}}}", latex)
    out, opened = list[str](), False
    for token in _TOKEN.findall(latex):
        if token in ("|", r"\vert"):
            opened = not opened
            out.append(r"\left|" if opened else r"\right|")
        else:
            out.append(token)
    return latex if opened else "".join(out)
