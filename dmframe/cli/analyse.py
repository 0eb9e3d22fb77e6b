"""``dmframe analyse``: poles, margins, passivity, largest stable sampling period, least K_c."""

from __future__ import annotations

import json

from dmframe.cli.streams import tell
from dmframe.graph.graph import Graph


def analyse_graph(graph: Graph, *, horizon: float, as_json: bool) -> None:
    """Analyse one graph and print it."""
    found = graph.analyse(horizon)
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
