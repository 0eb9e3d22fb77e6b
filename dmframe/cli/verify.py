"""``dmframe verify``: prove graphs and print verdicts."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dmframe.cli.streams import tell
from dmframe.common.errors import ValueFault
from dmframe.common.files import check_place as check_file
from dmframe.common.files import write_text
from dmframe.common.version import version
from dmframe.graph.graph import Graph
from dmframe.graph.labels import labels_of
from dmframe.graph.progress import progress_line
from dmframe.remembered.recorder import finish

if TYPE_CHECKING:
    from dmframe.report.verification import Verification

NOT_PROVED = 1


def verify_graphs(
    graphs: Sequence[Graph],
    *,
    report: Path | None,
    files: Mapping[str, Path | None],
    replay: Sequence[str],
    seed: int,
    bounds: Mapping[str, str],
    clock: bool,
    as_json: bool,
) -> int:
    """Verify graphs one after another; returns the exit status.

    `replay` is the command line; `files` are the paths of the claim and the certificate of a single graph, and `bounds`
    the time and the torque of the bounds, by option; with `clock` they are also proved on their clocks.
    """
    if report is not None:
        from dmframe.report.write import check_place

        check_place(report)
    wanted = {name: path for name, path in files.items() if path is not None}
    for name, path in wanted.items():
        if len(graphs) != 1:
            raise ValueFault(f"--{name}: expected one graph, found {len(graphs)}; a file holds one {name}")
        check_file(path)
    for graph in graphs:  # report faults of all graphs before the first proof
        _ = graph.diagram
    labels = labels_of([(graph.name, graph) for graph in graphs])
    found = [
        replace(graph.verify(seed=seed, clock=clock, **bounds), label=label)
        for graph, label in zip(graphs, labels, strict=True)
    ]
    status = 0 if all(each.proved for each in found) else NOT_PROVED
    proved_at = datetime.now(UTC).isoformat(timespec="seconds")
    summaries = [{**each.summary, "proved_at": proved_at, "remembered": False} for each in found]
    page = "\n\n".join(map(str, found))
    try:
        for name, path in wanted.items():
            _WRITERS[name](path, found[0])
        if report is not None:  # written before printing, which may fail
            from dmframe.report.write import write_report

            words = [*replay, "--seed", str(seed), "--report", report.name]
            with progress_line("report", quiet=as_json) as progress:
                write_report(report, found, replay=words, tell=progress)
    finally:
        if as_json:
            tell(json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=2))
        else:
            tell(page)
    for written in (*wanted.values(), report):
        if written is not None:
            tell(f"wrote {written}", aside=as_json)
    finish(page, summaries, status, proved_at)
    return status


def _write_claim(path: Path, found: Verification) -> None:
    """Write the claim as data. Raises `ValueFault` where the graph has none."""
    from dmframe.certify.symbols import exact_values
    from dmframe.prove.export import to_json

    exact, claim = found.verdict.exact, found.verdict.claim
    if exact is None or claim is None:
        raise ValueFault(f"--claim: {found.label} has no claim: {found.verdict.reason}")
    own = {symbol.label for symbol in exact.symbols if symbol.kind == "parameter"}
    numbers = {label: values for label, values in exact_values(claim.diagram).items() if label in own}
    write_text(path, to_json(exact, numbers) + "\n")


def _write_certificate(path: Path, found: Verification) -> None:
    """Write the certificate. Raises `ValueFault` for a graph that is not proved."""
    from dmframe.certify.published import certificate_text

    about = {"graph": found.label, "model": str(found.summary["field_hash"]), "dmframe": version()}
    write_text(path, certificate_text(found.verdict, about, found.graph.intervals()))


_WRITERS: Final[Mapping[str, Callable[[Path, Verification], None]]] = {
    "claim": _write_claim,
    "certificate": _write_certificate,
}
