"""``dmframe verify``: prove graphs, and say what is proved and what is assumed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dmframe.cli.streams import tell
from dmframe.graph import Graph
from dmframe.graph.progress import telling
from dmframe.graph.runs import labels_of

NOT_PROVED = 1


def verify_graphs(
    graphs: Sequence[Graph], *, report: Path | None, replay: Sequence[str], seed: int, as_json: bool
) -> int:
    """Verify graphs one after another; returns the exit status. `replay` are the words of the command."""
    from dmframe.report import check_place, write_report

    if report is not None:
        check_place(report)
    for graph in graphs:  # faults of every graph are told before the first is proved
        _ = graph.diagram
    labels = labels_of([(graph.name, graph.experiment) for graph in graphs])
    found = [replace(graph.verify(seed=seed), label=label) for graph, label in zip(graphs, labels, strict=True)]
    try:
        if report is not None:  # on the disk before anything is printed: printing may fail
            words = [*replay, "--seed", str(seed), "--report", report.name]
            with telling("report", quiet=as_json) as progress:
                write_report(report, found, replay=words, tell=progress)
    finally:
        if as_json:
            told = [each.summary for each in found]
            tell(json.dumps(told[0] if len(told) == 1 else told, indent=2))
        else:
            tell("\n\n".join(map(str, found)))
    if report is not None:
        tell(f"wrote {report}", aside=as_json)
    return 0 if all(each.proved for each in found) else NOT_PROVED
