"""``dmframe delay``: identify the response delay of a robot in samples."""

from __future__ import annotations

import json
from dataclasses import asdict

from dmframe.analysis.delay import recorded_delay, signals_of
from dmframe.cli.streams import tell
from dmframe.graph.graph import Graph
from dmframe.simulate.keep import Log

NOT_FOUND = 1


def delay_of(graph: Graph, *, duration: float, as_json: bool) -> int:
    """Run one graph, fit its delay and print it; returns the exit status."""
    lasting, log = graph.until(duration), None
    if graph.clock is not None:  # independent of the log of the graph; without a clock, `recorded_delay` raises
        log = Log(graph.clock, signals_of(graph.diagram))
    found = recorded_delay(lasting.simulate(graph.diagram, log=log))
    if as_json:
        whole = None if found.refused else found.whole
        tell(json.dumps({"graph": graph.name, **asdict(found), "delay": whole, "refused": found.refused}, indent=2))
    elif found.refused:
        tell(f"{graph.name}: {found}")
    else:
        tell(f"{graph.name}: {found}")
        tell(f"to use it, set in each block with this parameter: delay: {found.whole}")
    return NOT_FOUND if found.refused else 0
