"""Comparison of runs: several graphs, or one graph with several values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final, overload

from dmframe.common import notebook
from dmframe.common.errors import DmframeError, NeedsDiagramError, UnknownNameError, ValueFault, raise_all
from dmframe.common.plotting import FORMATS
from dmframe.common.units import plain, seconds, shorten
from dmframe.config import BaseGraph
from dmframe.graph.doubts import doubts
from dmframe.graph.graph import Graph
from dmframe.graph.labels import labels_of
from dmframe.graph.load import load
from dmframe.graph.progress import Bars
from dmframe.results.run import HEADS, NOTE, Run, drawn, ended, row, saved, table_of
from dmframe.simulate import Recording

if TYPE_CHECKING:
    import pandas

    from dmframe.results.figures import Figures
    from dmframe.simulate.engine import Choice


@final
@dataclass(frozen=True, repr=False, eq=False)
class Runs(Sequence[Run]):
    """Runs in an order, each with a unique label.

    ``runs["ur10_fast"]`` and ``runs[0]`` are a run; ``runs.table`` is a pandas table.
    """

    runs: tuple[Run, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the runs in tables and legends."""
        return tuple(run.name for run in self.runs)

    @property
    def table(self) -> pandas.DataFrame:
        """A row per run: values that were set, clock and duration [s], divergence, and RMS of the error and of the
        tool's turn [deg] in each eighth.
        """
        import pandas

        rows = list[dict[str, Any]]()
        for run in self.runs:
            summary, error = run.summary, run.error
            turned = run.turn.rms_by_eighth if run.turn is not None else ()
            eighths = error.rms_by_eighth if error is not None else ()
            clock = None if summary["clock"] == "continuous" else summary["clock"]
            rows.append(
                {"run": run.name, **_set_in(run), "clock": clock, "duration": summary["duration"]}
                | {"diverged": summary["diverged"], "wall_time": summary["wall_time"]}
                | {"error": error.signal if error else None, "unit": error.unit if error else None}
                | {f"rms_{k}": value for k, value in enumerate(eighths, start=1)}
                | {f"turn_{k}": value for k, value in enumerate(turned, start=1)}
            )
        return pandas.DataFrame(rows, columns=None if rows else ["run"]).set_index("run")

    def plot(self, *signals: str | Sequence[str]) -> Figures:
        """The figures of the command line, overlaid, or one of some signals. See `Run.plot`."""
        return drawn(self.runs, signals)

    def save(
        self, folder: str | Path, *, plots: bool = True, formats: Sequence[str] = FORMATS[:1], force: bool = False
    ) -> Path:
        """Write each run to its own folder below `folder`, and the figures into `folder`. See `Run.save`."""
        return saved(self.runs, folder, plots=plots, formats=formats, force=force)

    @overload
    def __getitem__(self, key: int | str) -> Run: ...
    @overload
    def __getitem__(self, key: slice) -> Runs: ...
    def __getitem__(self, key: int | str | slice) -> Run | Runs:
        if isinstance(key, slice):
            return Runs(self.runs[key])
        if isinstance(key, int):
            return self.runs[key]
        for run in self.runs:
            if run.name == key:
                return run
        raise UnknownNameError(f"runs[{key!r}]", "run", key, self.labels)

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.labels)

    def __repr__(self) -> str:
        return f"<Runs: {shorten(', '.join(self.labels), 100) or 'none'}>"

    def __str__(self) -> str:
        return table_of(self.runs)

    def _repr_html_(self) -> str:
        from dmframe.results.figures import error_picture

        notices = [f"{run.name}: {text}" for run in self.runs for text in (*run.notices, *ended(run))]
        return (
            notebook.table(map(row, self.runs), HEADS)
            + notebook.paragraphs([NOTE, *notices])
            + error_picture({run.name: run for run in self.runs})
        )


def compare(
    items: Iterable[Graph | Run | str | Path | Mapping[str, Any]] | Graph | Run | str | Path | Mapping[str, Any],
    *,
    until: float | str | None = None,
    engine: Choice = "auto",
    progress: bool | None = None,
) -> Runs:
    """Runs to compare; graphs are loaded and run.

    Runs of one name are distinguished by the values that were set, ``ur10_fast Gamma=1``. Graphs that differ in numbers
    of blocks alone, as from `Graph.variants`, are built and compiled once, and run on all cores.

    Parameters
    ----------
    items
        Runs, graphs, or what `load` takes.
    until, engine, progress
        See `Graph.run`.

    Raises
    ------
    DmframeError
        Faults of all graphs, before any of them runs.
    """
    if isinstance(items, Run | Graph | str | Path | Mapping):  # a single item
        items = [items]
    found: list[Graph | Run] = [item if isinstance(item, Run) else load(item) for item in items]
    for item in found:
        if until is not None and isinstance(item, Run) and item.recording.duration != seconds("until", until):
            raise ValueFault(
                f"compare: {item.name} is a run of {plain(item.recording.duration, 's')}, not {until}; "
                "pass its graph to run it again"
            )
    graphs = [item if until is None else item.until(until) for item in found if isinstance(item, Graph)]
    if len(graphs) == len(found) > 1 and (runs := ran_together(graphs, engine)) is not None:
        return labelled(runs)
    for graph in graphs:
        _ = graph.diagram
    runs = list[Run]()
    with Bars(quiet=None if progress is None else not progress, transient=True) as bars:
        for item in found:
            if isinstance(item, Run):
                runs.append(item)
                continue
            total = item.duration if until is None else seconds("until", until)
            runs.append(item.run(until, engine=engine, progress=bars.of(item.name, total)))
    return labelled(runs)


def ran_together(graphs: Sequence[Graph], engine: Choice) -> list[Run] | None:
    """Runs of graphs that share one closed loop and its settings, in one build; None if they differ in more."""
    from dmframe.batch.runner import numbers_between
    from dmframe.simulate import simulate_many

    base = graphs[0]
    found = [numbers_between(base, graph) if _same_settings(base, graph) else None for graph in graphs]
    numbers = [each for each in found if each is not None]
    if len(numbers) < len(graphs):
        return None
    runs = simulate_many(graphs[0].diagram, numbers, graphs[0].duration, engine=engine, **base.settings)
    if any(isinstance(fault, NeedsDiagramError) for fault in runs):
        return None
    raise_all([fault for fault in runs if isinstance(fault, DmframeError)][:1])
    return [
        Run(graph, recording).noticed(*doubts(graph, recording))
        for graph, recording in zip(graphs, runs, strict=True)
        if isinstance(recording, Recording)
    ]


def _same_settings(base: BaseGraph, other: BaseGraph) -> bool:
    """True if the files differ in their blocks only."""
    return base.file.model_copy(update={"blocks": {}}) == other.file.model_copy(update={"blocks": {}})


def labelled(runs: Sequence[Run]) -> Runs:
    """Runs with unique labels: the graph's name, and the values that were set if several have one name."""
    labels = labels_of([(run.name, run.graph) for run in runs])
    return Runs(tuple(Run(run.graph, run.recording, label) for run, label in zip(runs, labels, strict=True)))


def _set_in(run: Run) -> dict[str, Any]:
    """Values that were set in a run's graph, by label."""
    found = dict[str, Any]()
    for text in run.graph.overrides:
        label, _, value = text.partition("=")
        try:
            found[label] = json.loads(value)
        except ValueError:
            found[label] = value
    return {label: value if isinstance(value, int | float | str) else str(value) for label, value in found.items()}
