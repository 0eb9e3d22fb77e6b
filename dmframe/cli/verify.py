"""``dmframe verify``: prove graphs and print verdicts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from dmframe.cli.streams import tell
from dmframe.graph import Graph
from dmframe.graph.progress import progress_line
from dmframe.graph.runs import labels_of
from dmframe.remembered.recorder import finish

NOT_PROVED = 1


def verify_graphs(
    graphs: Sequence[Graph], *, report: Path | None, replay: Sequence[str], seed: int, as_json: bool
) -> int:
    """Verify graphs one after another; returns the exit status. `replay` is the command line."""
    from dmframe.report import check_place, write_report

    if report is not None:
        check_place(report)
    for graph in graphs:  # report faults of all graphs before the first proof
        _ = graph.diagram
    labels = labels_of([(graph.name, graph.experiment) for graph in graphs])
    found = [replace(graph.verify(seed=seed), label=label) for graph, label in zip(graphs, labels, strict=True)]
    status = 0 if all(each.proved for each in found) else NOT_PROVED
    proved_at = datetime.now(UTC).isoformat(timespec="seconds")
    summaries = [{**each.summary, "proved_at": proved_at, "remembered": False} for each in found]
    page = "\n\n".join(map(str, found))
    try:
        if report is not None:  # written before printing, which may fail
            words = [*replay, "--seed", str(seed), "--report", report.name]
            with progress_line("report", quiet=as_json) as progress:
                write_report(report, found, replay=words, tell=progress)
    finally:
        if as_json:
            tell(json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=2))
        else:
            tell(page)
    if report is not None:
        tell(f"wrote {report}", aside=as_json)
    finish(page, summaries, status, proved_at)
    return status
