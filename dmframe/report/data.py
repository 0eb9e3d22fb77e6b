"""A report as plain data: what ``verify --json`` says of each graph, with the formulas and the run beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from dmframe.report.content import Content

_SHOWN = ("picture", "mermaid", "summary", "measured", "linear", "name", "title", "outcome")


def as_data(contents: Sequence[Content]) -> dict[str, Any]:
    """Everything but the pictures; formulas are LaTeX, sentences have them between dollar signs."""
    return {"dmframe_report": 1, "graphs": [_graph(content) for content in contents]}


def _graph(content: Content) -> dict[str, Any]:
    whole = asdict(content)
    measured = {key: whole["measured"][key] for key in ("sentence", "facts", "numbers")}
    linear = {key: whole["linear"][key] for key in ("sentence", "numbers")}
    rest = {key: value for key, value in whole.items() if key not in _SHOWN}
    return {"title": content.title, "verdict": content.summary, "measured": measured, "linear": linear, **rest}
