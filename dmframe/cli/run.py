"""``dmframe run``: simulate with a progress bar, write the results, tell the figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path

from dmframe.cli import STOPPED
from dmframe.cli.signals import held_off
from dmframe.cli.streams import tell
from dmframe.errors import OutputError
from dmframe.graph import Graph
from dmframe.graph.arguments import seconds
from dmframe.graph.progress import Bars
from dmframe.graph.runs import labelled, labels_of
from dmframe.results.folder import drawing, folders_of, safe_name, write_data
from dmframe.results.place import PAGE, Place, complete, reserved
from dmframe.results.run import Run
from dmframe.simulate.engine import Choice

DIVERGED = 1
MOST = 100
"""Runs that may begin in one millisecond."""


def run_graphs(
    graphs: Sequence[Graph],
    *,
    until: str | None,
    out: Path | None,
    engine: Choice,
    baseline: bool,
    formats: Sequence[str],
    pages: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Run graphs one after another and write one folder of results; returns the exit status.

    At Ctrl-C the graph that runs is kept up to there, and those not begun are left out.
    """
    if baseline:
        graphs = [each for graph in graphs for each in (graph, graph.baseline())]
    if until is not None:
        duration = seconds("--until", until)
        graphs = [graph.until(duration) for graph in graphs]
    for graph in graphs:  # faults of every graph are told before the first runs
        _ = graph.diagram
        if pages:
            _check_page(graph)
    with placed_folder(out, graphs, force=force) as place:
        found, interrupted = _run_all(graphs, engine, as_json)
        if not found:
            return STOPPED
        with drawing(labelled(found) if formats else (), formats) as draw:
            judged = [
                Run(run.experiment, graph.warned(run.recording))  # while the figures are drawn elsewhere
                for run, graph in zip(found, graphs, strict=False)  # after Ctrl-C there are fewer runs than graphs
            ]
            runs = labelled(judged)
            try:  # printing may fail, and everything is written all the same
                if not as_json:
                    tell(str(runs))
            finally:
                with held_off() as signals:
                    summaries = write_data(place, runs)
                told = json.dumps(summaries[0] if len(graphs) == 1 else summaries, indent=2)
                try:
                    tell(told if as_json else f"results: {place.path}")
                finally:
                    if formats and not signals:
                        _say("drawing the figures", as_json)
                        draw(place)
        if pages and not signals:
            _write_pages(place, [run.name for run in runs], graphs)
        complete(place)
    if interrupted or signals:
        return STOPPED
    return DIVERGED if any(run.divergence for run in runs) else 0


def _check_page(graph: Graph) -> None:
    from dmframe.page.content import check_chance

    check_chance(graph.experiment, graph.diagram)


def _write_pages(place: Place, names: Sequence[str], graphs: Sequence[Graph]) -> None:
    folders = folders_of(names) or [""]
    for graph, folder in zip(graphs, folders, strict=False):  # after Ctrl-C there are fewer runs than graphs
        graph.page().save(place.path / folder / PAGE)


@contextmanager
def placed_folder(out: Path | None, graphs: Sequence[Graph], *, force: bool) -> Iterator[Place]:
    """The folder that was named, or one named by the time, of which two runs may not have the same."""
    if out is not None:
        labels = labels_of([(graph.name, graph.experiment) for graph in graphs])
        with reserved(out, force=force, folders=folders_of(labels)) as place:
            yield place
        return
    first, count = _default_folder(graphs), 1
    path = first
    with ExitStack() as stack:
        while True:
            try:
                place = stack.enter_context(reserved(path))
                break
            except OutputError:
                if not path.is_dir() or count > MOST:
                    raise
                count += 1
                path = first.with_name(f"{first.name}_{count}")
        yield place


def _run_all(graphs: Sequence[Graph], engine: Choice, as_json: bool) -> tuple[list[Run], bool]:
    runs = list[Run]()
    try:
        with Bars(quiet=True if as_json else None) as bars:
            for graph in graphs:
                runs.append(graph.run(engine=engine, progress=bars.of(graph.name, graph.duration), judge=False))
                if runs[-1].recording.interrupted:
                    return runs, True
    except KeyboardInterrupt:  # between two marches, where a run has nothing to keep yet
        return runs, True
    return runs, False


def _default_folder(graphs: Sequence[Graph]) -> Path:
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")[:-3]
    return Path(
        "runs", f"{stamp}_{safe_name(graphs[0].name)}" + (f"_and_{len(graphs) - 1}_more" if len(graphs) > 1 else "")
    )


def _say(text: str, as_json: bool) -> None:
    if not as_json and sys.stderr.isatty():
        tell(text, aside=True)
