"""``dmframe run``: simulate with a progress bar, write the results, tell the figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, cast, get_args

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from dmframe.cli import STOPPED
from dmframe.cli.options import quantity
from dmframe.cli.signals import held_off
from dmframe.cli.streams import tell
from dmframe.cli.terminal import console
from dmframe.config import Graph, load_graph
from dmframe.config.graph import placed
from dmframe.errors import DmframeError, Faults, UnknownNameError, ValueFault
from dmframe.results import Result, reserved, write_run
from dmframe.results.folder import safe_name
from dmframe.results.summary import summary
from dmframe.simulate import Run, simulate
from dmframe.simulate.engine import Choice
from dmframe.units import plain

DIVERGED = 1


def run_graphs(
    names: Sequence[str],
    overrides: Sequence[str],
    *,
    until: str | None,
    out: Path | None,
    engine: str,
    baseline: bool,
    plots: bool,
    as_json: bool,
) -> int:
    """Run graphs one after another and write one folder of results; returns the exit status.

    At Ctrl-C the graph that runs is kept up to there, and those not begun are left out.
    """
    choice = _engine(engine)
    graphs = [_loaded(name, overrides, alone=len(names) == 1) for name in names]
    if baseline:
        graphs = [each for graph in graphs for each in (graph, graph.baseline())]
    if until is not None:
        duration = _seconds(until)
        graphs = [graph.with_duration(duration) for graph in graphs]
    diagrams = [graph.diagram() for graph in graphs]  # faults of every graph are told before the first runs
    with reserved(out or _default_folder(graphs)) as place:
        results, interrupted = _simulate_all(graphs, diagrams, choice, as_json)
        if not results:
            return STOPPED
        try:
            if not as_json:
                _table(results)  # figures take seconds; the numbers are there now
        finally:  # printing may fail, results are written all the same
            _say(f"writing {place.path}", as_json)
            with held_off() as signals:
                summaries = write_run(place, results, plots=plots)
    if as_json:
        tell(json.dumps(summaries[0] if len(graphs) == 1 else summaries, indent=2))
    else:
        tell(f"results: {place.path}")
    if interrupted or signals:
        return STOPPED
    return DIVERGED if any(result.run.divergence for result in results) else 0


def _loaded(name: str, overrides: Sequence[str], *, alone: bool) -> Graph:
    try:
        return load_graph(name, overrides)
    except DmframeError as error:
        for fault in error.faults if isinstance(error, Faults) else (error,):
            if not alone and not fault.location and name not in fault.text:
                fault.location = name  # which of the graphs
        raise


def _simulate_all(
    graphs: Sequence[Graph], diagrams: Sequence[Any], engine: Choice, as_json: bool
) -> tuple[list[Result], bool]:
    results = list[Result]()
    try:
        with _progress(as_json) as bar:
            for graph, diagram in zip(graphs, diagrams, strict=True):
                results.append(Result(graph, _run(graph, diagram, engine, bar)))
                if results[-1].run.interrupted:
                    return results, True
    except KeyboardInterrupt:  # between two marches, where a run has nothing to keep yet
        return results, True
    return results, False


def _seconds(until: str) -> float:
    duration = quantity("--until", until, "s")
    if duration <= 0:
        raise ValueFault(f"--until {until}: expected a time above zero")
    return duration


def _engine(name: str) -> Choice:
    for choice in get_args(Choice):
        if name == choice:
            return cast(Choice, choice)
    raise UnknownNameError(f"--engine {name}", "engine", name, get_args(Choice))


def _default_folder(graphs: Sequence[Graph]) -> Path:
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S_%f")[:-3]
    return Path(
        "runs", f"{stamp}_{safe_name(graphs[0].name)}" + (f"_and_{len(graphs) - 1}_more" if len(graphs) > 1 else "")
    )


def _progress(as_json: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.completed:.0f} / {task.total:.0f} s"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
        console=console(aside=True),
        disable=as_json or not sys.stderr.isatty(),
    )


def _run(graph: Graph, diagram: Any, engine: Choice, bar: Progress) -> Run:
    task = bar.add_task(graph.name, total=graph.file.duration, speed="")

    def done(time: float) -> None:
        elapsed = bar.tasks[task].elapsed
        bar.update(task, completed=time, speed=f"{time / elapsed:.0f} x real time" if elapsed else "")

    file = graph.file
    try:
        return simulate(
            diagram,
            file.duration,
            clock=file.clock,
            solver=graph.solver,
            start=graph.start,
            progress=done,
            engine=engine,
            log=graph.log,
        )
    except DmframeError as error:
        raise placed(error, graph.document) from None


def _say(text: str, as_json: bool) -> None:
    if not as_json and sys.stderr.isatty():
        tell(text, aside=True)


def _table(results: Sequence[Result]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("graph", "clock", "error", "first eighth", "last eighth", "speed", "engine"):
        table.add_column(heading, justify="left" if heading in ("graph", "error", "engine") else "right")
    for told in (summary(result.graph.name, result.run) for result in results):
        error = told["error"]
        clock = told["clock"] if told["clock"] == "continuous" else plain(told["clock"], "s")
        first, last = (_rms(error, index) for index in (0, -1))
        speed = f"{told['real_time_factor']:.0f} x"
        table.add_row(told["graph"], clock, error["signal"] if error else "-", first, last, speed, told["engine"])
    screen = console(width=None if sys.stdout.isatty() else 120)
    screen.print(table)
    screen.print("error: root mean square of its Euclidean norm; speed: times real time", style="dim")
    for result in results:
        name = result.graph.name
        for notice in result.run.notices:
            screen.print(f"{name}: notice: {notice}", soft_wrap=True)
        if result.run.divergence:
            screen.print(f"{name}: diverged: {result.run.divergence}", soft_wrap=True)
        if result.run.interrupted:
            screen.print(f"{name}: stopped at {plain(result.run.time[-1], 's')}; what was done is kept")
    sys.stdout.flush()


def _rms(error: dict[str, Any] | None, index: int) -> str:
    if error is None or error["rms_by_eighth"][index] is None:
        return "-"
    return plain(error["rms_by_eighth"][index], error["unit"])
