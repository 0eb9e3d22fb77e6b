"""``dmframe run``: simulate with a progress bar, write results and figures."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from dmframe.cli import STOPPED
from dmframe.cli.signals import deferred_signals
from dmframe.cli.streams import tell
from dmframe.common.copies import shared
from dmframe.common.errors import OutputError
from dmframe.common.units import seconds
from dmframe.graph.doubts import doubts
from dmframe.graph.graph import Graph
from dmframe.graph.labels import labels_of
from dmframe.graph.progress import Bars
from dmframe.graph.runs import labelled
from dmframe.remembered.conclusions import keep, recalled
from dmframe.remembered.recorder import current, end, paused
from dmframe.results.decided import Decided
from dmframe.results.drawing_process import drawing
from dmframe.results.folder import folders_of, named, safe_name, write_data, write_figures
from dmframe.results.place import PAGE, Place, complete, reserved
from dmframe.results.run import Run, notes_of, numbers_of
from dmframe.simulate.engine import Choice

DIVERGED = 1
MOST = 100
"""Maximum number of runs that start in one millisecond."""


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

    At Ctrl-C the current run is kept up to that time, and the others are skipped.
    """
    if baseline:
        graphs = [each for graph in graphs for each in (graph, graph.baseline())]
    if until is not None:
        duration = seconds("--until", until)
        graphs = [graph.until(duration) for graph in graphs]
    for graph in graphs:  # report faults of all graphs before the first run
        _ = graph.diagram
        if pages:
            _check_page(graph)
    with placed_folder(out, graphs, force=force) as place:
        with drawing(graphs, formats) as drawn:
            found, interrupted = _run_all(graphs, engine, as_json)
            if not found:
                return STOPPED
            lost = list[Exception]()
            runs: Sequence[Run] = labelled(found)
            say = partial(_say, lost=lost)
            drawn.begin(named(runs))
            if not as_json:
                say(numbers_of(runs))
            with deferred_signals() as signals:
                runs, conclusions = _judged(runs, graphs)  # takes longer than the run
                watching = end()
                if not as_json and (notes := notes_of(runs)):
                    say("\n".join(notes))
                summaries = written(place, runs)
            data = json.dumps(summaries[0] if len(graphs) == 1 else summaries, indent=2)
            say(data if as_json else f"results: {place.path}")
            if formats and not signals:
                if not as_json and sys.stderr.isatty():
                    tell("drawing the figures", aside=True)
                write_figures(drawn, place, runs)
        for error in lost:
            raise error
        if pages and not signals:
            _write_pages(place, [run.name for run in runs], graphs)
        complete(place)
    if conclusions:
        keep(watching, conclusions)
    if interrupted or signals:
        return STOPPED
    return DIVERGED if any(run.divergence for run in runs) else 0


def written(place: Place, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Write the data of runs; if that fails, keep them in a temporary folder, which the error names."""
    try:
        return write_data(place, runs)
    except OutputError as error:
        spare = Path(tempfile.mkdtemp(prefix="dmframe-results-"))
        other = Place(spare, Path(os.path.realpath(spare)), new=False)
        try:
            write_data(other, runs)
            complete(other)
        except OutputError:
            shutil.rmtree(spare, ignore_errors=True)
            raise error from None
        raise OutputError(f"{error.text}. The data are in {spare}, without figures") from None


def _check_page(graph: Graph) -> None:
    from dmframe.page.content import check_chance

    check_chance(graph)


def _write_pages(place: Place, names: Sequence[str], graphs: Sequence[Graph]) -> None:
    folders = folders_of(names) or [""]
    for graph, folder in zip(graphs, folders, strict=False):  # after Ctrl-C there are fewer runs than graphs
        graph.page().save(place.path / folder / PAGE)


@contextmanager
def placed_folder(out: Path | None, graphs: Sequence[Graph], *, force: bool) -> Iterator[Place]:
    """Reserve the given folder, or a new one named by the time."""
    if out is not None:
        labels = labels_of([(graph.name, graph) for graph in graphs])
        with ExitStack() as stack:
            with paused():
                place = stack.enter_context(reserved(out, force=force, folders=folders_of(labels)))
            yield place
        return
    first, count = _default_folder(graphs), 1
    path = first
    with ExitStack() as stack:
        while True:
            try:
                with paused():
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
    except KeyboardInterrupt:  # before a run has any results
        return runs, True
    return runs, False


def _default_folder(graphs: Sequence[Graph]) -> Path:
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")[:-3]
    return Path(
        "runs", f"{stamp}_{safe_name(graphs[0].name)}" + (f"_and_{len(graphs) - 1}_more" if len(graphs) > 1 else "")
    )


def _say(text: str, lost: list[Exception]) -> None:
    """Print; errors are stored in `lost` and raised after the results are written."""
    try:
        tell(text)
    except Exception as error:  # of any stream; it is raised once the results are on disk
        lost.append(error)


def _judged(runs: Sequence[Run], graphs: Sequence[Graph]) -> tuple[list[Run], Sequence[dict[str, Any]]]:
    """The runs with V and with the notices on their graphs, and conclusions to keep.

    Conclusions that depend on a graph only are read from the cache, or a forked process decides the notices while this
    one evaluates V. After Ctrl-C there are fewer runs than graphs.
    """
    regular = len(runs) == len(graphs) and not any(run.divergence or run.recording.interrupted for run in runs)
    known = recalled(len(graphs)) if regular else ()
    if known:
        for run, kept in zip(runs, known, strict=True):
            run.decide(Decided.read(kept["V"]))
        return [run.noticed(*kept["doubts"]) for run, kept in zip(runs, known, strict=True)], ()
    judging = [partial(doubts, graph, run.recording) for run, graph in zip(runs, graphs, strict=False)]
    with shared(judging, busy=True) as finished:
        for run in runs:
            _ = run.notices
        notes = finished()
    judged = [run.noticed(*texts) if texts else run for run, texts in zip(runs, notes, strict=True)]
    return judged, _conclusions(runs, notes) if regular and current() is not None else ()


def _conclusions(runs: Sequence[Run], notes: Sequence[Sequence[str]]) -> Sequence[dict[str, Any]]:
    """Cached conclusions about the graphs of runs; empty unless there is an entry for each of them."""
    decided = [run.decided for run in runs]
    found = [{"doubts": texts, "V": V.data} for texts, V in zip(notes, decided, strict=True) if V is not None]
    return found if len(found) == len(runs) else ()
