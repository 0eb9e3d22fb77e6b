"""A lesson as a notebook to take away: its text and its cells, and for each live page the line that shows it."""

from __future__ import annotations

import json
import re
import shlex
from typing import Any, Final

from site_parts.pages import LINK

_HEADER: Final = re.compile(r"\A---\n(.*?)\n---\n", re.DOTALL)
_FENCE: Final = re.compile(r"^(`{3,})\{(code-cell|live)\}[ ]*([^\n]*)\n(.*?)^\1[ ]*$", re.MULTILINE | re.DOTALL)
_DIVISION: Final = re.compile(r"^\+\+\+.*$", re.MULTILINE)
_OPTION: Final = re.compile(r"\A(?::([\w-]+):[ ]*([^\n]*)\n|---\n.*?\n---\n)", re.DOTALL)


def is_notebook(text: str) -> bool:
    """True for a page with a header that names a kernel."""
    header = _HEADER.match(text)
    return header is not None and "kernelspec" in header[1]


def notebook(text: str) -> str:
    """A lesson in MyST Markdown as the JSON of a notebook without outputs."""
    body, cells, last = _HEADER.sub("", text), list[dict[str, Any]](), 0
    for fence in _FENCE.finditer(body):
        cells += _prose(body[last : fence.start()])
        options, code = _options(fence[4])
        if fence[2] == "live":
            code = _shown(fence[3].strip(), options)
        cells.append(_cell("code", code, {"tags": _tags(options)} if "tags" in options else {}))
        last = fence.end()
    cells += _prose(body[last:])
    for place, cell in enumerate(cells):
        cell["id"] = f"cell-{place}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    data = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _options(text: str) -> tuple[dict[str, str], str]:
    """The options at the beginning of a cell, and the rest."""
    options = dict[str, str]()
    while found := _OPTION.match(text):
        if found[1]:
            options[found[1]] = found[2].strip()
        text = text[found.end() :]
    return options, text.strip("\n")


def _tags(options: dict[str, str]) -> list[str]:
    return re.findall(r"[\w-]+", options["tags"])


def _shown(graph: str, options: dict[str, str]) -> str:
    """The cell that shows a live page in a notebook."""
    values = ", ".join(
        f"{key!r}: {value!r}" for key, _, value in (item.partition("=") for item in shlex.split(options.get("set", "")))
    )
    return f"import dmframe as dm\n\ndm.load({graph!r}){f'.set({{{values}}})' if values else ''}.page()"


def _prose(text: str) -> list[dict[str, Any]]:
    """Cells of Markdown; links to other pages lead nowhere in a file that stands alone, and become plain text."""
    parts = [LINK.sub(_unlinked, part).strip("\n") for part in _DIVISION.split(text)]
    return [_cell("markdown", part, {}) for part in parts if part.strip()]


def _unlinked(found: re.Match[str]) -> str:
    return found[0] if "://" in found["target"] else found["text"]


def _cell(kind: str, text: str, metadata: dict[str, Any]) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "id": "", "metadata": metadata, "source": text.splitlines(keepends=True)}
    return cell | {"execution_count": None, "outputs": []} if kind == "code" else cell
