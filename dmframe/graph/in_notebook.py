"""A graph as a notebook displays it."""

from __future__ import annotations

from dmframe.common import notebook
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.drawing import svg


def graph_html(graph: BaseGraph) -> str:
    """Block diagram, title and blocks."""
    clock = "continuous time" if graph.clock is None else f"sampled every {plain(graph.clock, 's')}"
    return (
        notebook.heading(graph.name, graph.title)
        + notebook.fitted(svg(graph.diagram), f"dm-{graph.diagram.fingerprint[:8]}")
        + notebook.paragraphs([f"{clock}, for {plain(graph.duration, 's')}"])
        + graph.blocks._repr_html_()
    )
