"""Distinct labels of several graphs or runs."""

from __future__ import annotations

from collections.abc import Sequence

from dmframe.common.files import made_distinct
from dmframe.common.units import shorten
from dmframe.config import BaseGraph


def labels_of(items: Sequence[tuple[str, BaseGraph]]) -> list[str]:
    """Names, made distinct by the values set in their graphs, or by a number."""
    labels = list[str]()
    for name, graph in items:
        same_name = [set(other.overrides) for called, other in items if called == name]
        own = [text for text in graph.overrides if not all(text in others for others in same_name)]
        labels.append(f"{name} {', '.join(map(_short, own))}".strip())
    return made_distinct(labels, lambda label, count: f"{label} {count}")


def _short(override: str) -> str:
    """``dynamics.Gamma=1`` as ``Gamma=1``."""
    label, _, value = override.partition("=")
    return f"{label.rpartition('.')[2]}={shorten(value, 20)}"
