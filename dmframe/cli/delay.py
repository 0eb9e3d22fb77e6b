"""``dmframe delay``: how many samples late a robot answers, and what to tell the blocks."""

from __future__ import annotations

import json
from dataclasses import asdict

from dmframe.analysis.delay import recorded_delay, signals_of
from dmframe.cli.streams import tell
from dmframe.graph import Graph
from dmframe.simulate.keep import Log

NONE_TOLD = 1


def delay_of(graph: Graph, *, duration: float, as_json: bool) -> int:
    """Run one graph, fit its delay and print it; returns the exit status."""
    lasting, log = graph.until(duration), None
    if graph.clock is not None:  # whatever the graph keeps of its runs; without a clock there is a fault below
        log = Log(graph.clock, signals_of(graph.diagram))
    found = recorded_delay(lasting.experiment.simulate(graph.diagram, log=log))
    if as_json:
        told = None if found.refused else found.whole
        tell(json.dumps({"graph": graph.name, **asdict(found), "delay": told, "refused": found.refused}, indent=2))
    elif found.refused:
        tell(f"{graph.name}: {found}")
    else:
        tell(f"{graph.name}: {found}")
        tell(f"to use it, under blocks, of each block that has this parameter: delay: {found.whole}")
    return NONE_TOLD if found.refused else 0
