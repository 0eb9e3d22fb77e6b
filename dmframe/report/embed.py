"""SVG pictures as part of a page: no names that clash, no style that leaks, no address of anything outside."""

from __future__ import annotations

import io
import re
from typing import Any


def embedded(svg: str, prefix: str) -> str:
    """A stand-alone SVG as an element of HTML; `prefix` sets its names apart from those of other pictures."""
    svg = re.sub(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<!--.*?-->|<metadata>.*?</metadata>", "", svg, flags=re.DOTALL).strip()
    svg = re.sub(r"\s+xmlns(?::\w+)?=\"[^\"]*\"", "", svg).replace("xlink:href", "href")
    svg = re.sub(r"\bid=\"([^\"]+)\"", rf'id="{prefix}-\1"', svg)
    svg = re.sub(r"href=\"#([^\"]+)\"", rf'href="#{prefix}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", svg)
    svg = re.sub(r"<style[^>]*>(.*?)</style>", lambda found: _scoped(found[1], prefix), svg, flags=re.DOTALL)
    return re.sub(r"^<svg", f'<svg id="{prefix}"', svg)


def _scoped(style: str, prefix: str) -> str:
    """Each rule of a picture's style, for this picture alone."""
    rules = list[str]()
    for selectors, body in re.findall(r"([^{}]+)\{([^{}]*)\}", style):
        own = ", ".join(f"#{prefix} {selector.strip()}" for selector in selectors.split(","))
        rules.append(f"{own} {{{body}}}")
    return "<style>" + "\n".join(rules) + "</style>"


def figure_svg(figure: Any) -> str:
    """A matplotlib figure as SVG text."""
    from dmframe.results.plotting import styled

    text = io.StringIO()
    with styled():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
