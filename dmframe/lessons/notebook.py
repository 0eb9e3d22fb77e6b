"""A lesson as a notebook without outputs: text, cells, and a line of Python for each live page."""

from __future__ import annotations

import json
import re
import shlex
from typing import Any, Final

from dmframe.lessons.lesson import Lesson, Piece

LINK: Final = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s]+)\)")
"""``[text](target)``, except for a picture."""


def notebook(lesson: Lesson) -> str:
    """JSON of the notebook, format 4.5; solutions are folded."""
    cells = [_cell(piece) for piece in lesson.pieces]
    for place, cell in enumerate(cells):
        cell["id"] = f"cell-{place}"
    data = {
        "cells": cells,
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
            "title": lesson.title,
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _cell(piece: Piece) -> dict[str, Any]:
    if piece.kind == "prose":
        return _made("markdown", unlinked(piece.text), {})
    if piece.kind == "code":
        return _made("markdown", f"```\n{piece.text}\n```", {})
    if piece.kind == "live":
        return _made("code", shown(piece), {})
    metadata: dict[str, Any] = {"tags": list(piece.tags)} if piece.tags else {}
    if {"hide-cell", "hide-input"} & set(piece.tags):
        metadata["jupyter"] = {"source_hidden": True}
    return _made("code", piece.text, metadata)


def _made(kind: str, text: str, metadata: dict[str, Any]) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "id": "", "metadata": metadata, "source": text.splitlines(keepends=True)}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def shown(piece: Piece) -> str:
    """Python that shows a live page of a packaged graph, or of one in the lesson."""
    values = dict[str, str]()
    for word in shlex.split(dict(piece.options).get("set", "")):
        key, _, value = word.partition("=")
        values[key] = value
    source = f'"""\n{piece.text}\n"""' if piece.text else repr(piece.argument)
    return f"import dmframe as dm\n\ndm.load({source}){f'.set({values!r})' if values else ''}.page()"


def unlinked(text: str) -> str:
    """Replace links to other pages, which a stand-alone file does not have, by their text."""
    return LINK.sub(lambda link: link[0] if "://" in link[2] else link[1], text)
