"""HTML of an object for a notebook: headings, tables, pictures; all texts are escaped.

An embedded SVG has unique ids, styles that apply to itself only, and no external references.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

_LEFT = "text-align:left"
_FIT = '<svg style="max-width:100%;height:auto" '


def heading(name: str, description: str = "") -> str:
    """A name in bold, with an optional text."""
    detail = f": {escape(description)}" if description else ""
    return f"<p><b>{escape(name)}</b>{detail}</p>"


def table(rows: Iterable[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """Table of plain texts; all columns are aligned to the left."""
    head = "".join(f'<th style="{_LEFT}">{escape(text)}</th>' for text in heads)
    body = "".join(
        "<tr>" + "".join(f'<td style="{_LEFT}">{escape(text)}</td>' for text in row) + "</tr>" for row in rows
    )
    return f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"


def paragraphs(texts: Iterable[str]) -> str:
    """One paragraph for each plain text."""
    return "".join(f"<p>{escape(text)}</p>" for text in texts)


def picture(figure: Any, about: str) -> str:
    """A matplotlib figure as an inline PNG."""
    held = io.BytesIO()
    figure.savefig(held, format="png", dpi=120)
    code = base64.b64encode(held.getvalue()).decode()
    return f'<img alt="{escape(about)}" src="data:image/png;base64,{code}"/>'


def framed(page: str, about: str, height: int) -> str:
    """A page in a sandboxed iframe, whose scripts cannot reach the page around it; `height` in pixels."""
    style = f"width:100%;height:{height}px;border:0"
    return f'<iframe sandbox="allow-scripts" title="{escape(about)}" style="{style}" srcdoc="{escape(page)}"></iframe>'


def embedded(svg: str, prefix: str) -> str:
    """A stand-alone SVG as an HTML element; `prefix` makes its ids unique on the page."""
    svg = re.sub(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<!--.*?-->|<metadata>.*?</metadata>", "", svg, flags=re.DOTALL).strip()
    svg = re.sub(r"\s+xmlns(?::\w+)?=\"[^\"]*\"", "", svg).replace("xlink:href", "href")
    svg = re.sub(r"\bid=\"([^\"]+)\"", rf'id="{prefix}-\1"', svg)
    svg = re.sub(r"href=\"#([^\"]+)\"", rf'href="#{prefix}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", svg)
    svg = re.sub(r"<style[^>]*>(.*?)</style>", lambda found: _scoped(found[1], prefix), svg, flags=re.DOTALL)
    return re.sub(r"^<svg", f'<svg id="{prefix}"', svg)


def _scoped(style: str, prefix: str) -> str:
    """The style of a picture, with each selector restricted to this picture."""
    rules = list[str]()
    for selectors, body in re.findall(r"([^{}]+)\{([^{}]*)\}", style):
        own = ", ".join(f"#{prefix} {selector.strip()}" for selector in selectors.split(","))
        rules.append(f"{own} {{{body}}}")
    return "<style>" + "\n".join(rules) + "</style>"


def fitted(svg: str, prefix: str) -> str:
    """An SVG as an HTML element that is no wider than the page."""
    held = embedded(svg, prefix)
    return f'<div style="overflow-x:auto">{held.replace("<svg ", _FIT, 1)}</div>'
