"""HTML elements from escaped text."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import NewType

Html = NewType("Html", str)
"""Escaped text; only `plain` and `tag` create it."""


def plain(text: str) -> Html:
    """Escape a text."""
    return Html(escape(text))


def tag(name: str, *inside: Html, **attributes: str) -> Html:
    """An element; an attribute without a value is left out, ``class_`` is ``class``, ``aria_label`` ``aria-label``."""
    pairs = ((key.rstrip("_").replace("_", "-"), value) for key, value in attributes.items() if value)
    written = "".join(f' {key}="{escape(value)}"' for key, value in pairs)
    return Html(f"<{name}{written}>{''.join(inside)}</{name}>")


def joined(items: Iterable[Html], between: str = "\n") -> Html:
    """Elements one after another."""
    return Html(between.join(items))
