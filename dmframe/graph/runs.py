"""Several runs beside one another: of graphs that are compared, or of one graph whose values are swept."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final, overload

from dmframe import notebook
from dmframe.config import Experiment
from dmframe.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.graph.graph import Graph, load, seconds
from dmframe.graph.progress import Bars
from dmframe.results.run import HEADS, NOTE, Run, ended, row, table_of
from dmframe.simulate import Recording, simulate_many
from dmframe.units import shorten

if TYPE_CHECKING:
    import pandas

    from dmframe.results.figures import Figures
    from dmframe.simulate.engine import Choice


@final
@dataclass(frozen=True, repr=False, eq=False)
class Runs(Sequence[Run]):
    """Runs in an order, each under a label of its own.

    ``runs["ur10_fast"]`` and ``runs[0]`` are a run; ``runs.table`` is a table of pandas'.
    """

    runs: tuple[Run, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """What tables and legends call them."""
        return tuple(run.name for run in self.runs)

    @property
    def table(self) -> pandas.DataFrame:
        """A row a run: label, clock, the tracking error's RMS in each eighth, its unit, did it diverge."""
        import pandas

        rows = list[dict[str, Any]]()
        for run in self.runs:
            told, error = run.summary, run.error
            eighths = error.rms_by_eighth if error is not None else ()
            rows.append(
                {"run": run.name, "clock": told["clock"], "diverged": told["diverged"]}
                | {"error": error.signal if error else None, "unit": error.unit if error else None}
                | {f"rms_{k}": value for k, value in enumerate(eighths, start=1)}
            )
        return pandas.DataFrame(rows).set_index("run")

    def plot(self, *signals: str) -> Figures:
        """The figures of the command line, overlaid, or one of some signals. See `Run.plot`."""
        from dmframe.results.figures import figures_of, signals_figure

        runs = {run.name: run.recording for run in self.runs}
        return signals_figure(runs, signals) if signals else figures_of(runs)

    def save(self, folder: str | Path, *, plots: bool = True) -> Path:
        """Write each to a folder of its own below `folder`, and the figures beside them. See `Run.save`."""
        from dmframe.results.folder import write_run

        write_run(folder, self.runs, plots=plots)
        return Path(folder)

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

        told = [f"{run.name}: {text}" for run in self.runs for text in (*run.notices, *ended(run))]
        return (
            notebook.table(map(row, self.runs), HEADS)
            + notebook.paragraphs([NOTE, *told])
            + error_picture({run.name: run.recording for run in self.runs})
        )


def compare(
    items: Iterable[Graph | Run | str | Path | Mapping[str, Any]],
    *,
    until: float | str | None = None,
    engine: Choice = "auto",
    progress: bool | None = None,
) -> Runs:
    """Runs beside one another; what is no `Run` yet is loaded and run.

    Two of one name are told apart by the values that were set, ``ur10_fast Gamma=1``.

    Parameters
    ----------
    items
        Runs, graphs, or what `load` takes.
    until, engine, progress
        See `Graph.run`.

    Raises
    ------
    DmframeError
        Faults of every graph, before the first runs.
    """
    found: list[Graph | Run] = [item if isinstance(item, Run) else load(item) for item in items]
    graphs = [item for item in found if isinstance(item, Graph)]
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


def sweep(
    graph: Graph | str | Path | Mapping[str, Any],
    values: Mapping[str, Iterable[Any]],
    *,
    until: float | str | None = None,
    engine: Choice = "auto",
) -> Runs:
    """One graph run with each of some values, ``dm.sweep("ur10_fast", {"dynamics.Gamma": [1, 10, 100]})``.

    With several keys every combination is run. Where only numbers of blocks change, the loop is built and compiled
    once, and all cores run at the same time.

    Parameters
    ----------
    values
        By ``block.parameter`` or a key of the graph file, the values to try; see `Graph.set`.
    until, engine
        See `Graph.run`.

    Raises
    ------
    DmframeError
        Faults of any of the values, and of the first run that cannot be made.
    """
    base = load(graph)
    if until is not None:
        base = base.until(until)
    return labelled(ran_together(base, variants(base, values), engine))


def variants(base: Graph, values: Mapping[str, Iterable[Any]]) -> list[Graph]:
    """The graph with each combination of values; faults of all of them at once."""
    tried = {label: list(several) for label, several in values.items()}
    for label, several in tried.items():
        if not several:
            raise ValueFault(f"sweep {label}: expected at least one value, found none")
    made, faults = list[Graph](), list[DmframeError]()
    for combination in itertools.product(*tried.values()):
        try:
            made.append(base.set(dict(zip(tried, combination, strict=True))))
        except DmframeError as error:
            faults += error.faults
    raise_all(faults)
    return made


def ran_together(base: Graph, graphs: Sequence[Graph], engine: Choice) -> list[Run]:
    """Runs of graphs that differ from one by some values: in one build where these are numbers of blocks alone."""
    changes = [_numbers(base.experiment, graph.experiment) for graph in graphs]
    numbers = [change for change in changes if change is not None]
    if len(numbers) < len(graphs):
        return [graph.run(engine=engine) for graph in graphs]
    experiment = base.experiment
    found = simulate_many(
        base.diagram,
        numbers,
        base.duration,
        clock=base.clock,
        solver=experiment.solver,
        start=experiment.start,
        engine=engine,
        log=experiment.log,
    )
    raise_all([fault for fault in found if isinstance(fault, DmframeError)][:1])
    return [
        Run(graph.experiment, recording)
        for graph, recording in zip(graphs, found, strict=True)
        if isinstance(recording, Recording)
    ]


def _numbers(base: Experiment, other: Experiment) -> dict[str, Any] | None:
    """Parameters of blocks, by label, in which two experiments differ; None where they differ in anything else."""
    from dmframe.parameter import specs

    if base.file.model_copy(update={"blocks": {}}) != other.file.model_copy(update={"blocks": {}}):
        return None
    if base.blocks.keys() != other.blocks.keys():
        return None
    changed = dict[str, Any]()
    for name, block in base.blocks.items():
        new = other.blocks[name]
        if type(new) is not type(block):
            return None
        for key in type(block).model_fields:
            old_value, value = getattr(block, key), getattr(new, key)
            if old_value == value:
                continue
            spec = specs(type(block)).get(key)
            if spec is None or value is None or old_value is None or spec.form == "gain":
                return None
            changed[f"{name}.{key}"] = value
    return changed


def labelled(runs: Sequence[Run]) -> Runs:
    """Each under a label of its own: the graph's name, with what was set where several bear one name."""
    labels = list[str]()
    for run in runs:
        alike = [set(other.experiment.overrides) for other in runs if other.name == run.name]
        own = [text for text in run.experiment.overrides if not all(text in others for others in alike)]
        labels.append(f"{run.name} {', '.join(map(_short, own))}".strip())
    for place, label in enumerate(labels):
        if label in labels[:place]:
            count = 2
            while f"{label} {count}" in labels:
                count += 1
            labels[place] = f"{label} {count}"
    return Runs(tuple(Run(run.experiment, run.recording, label) for run, label in zip(runs, labels, strict=True)))


def _short(override: str) -> str:
    """``dynamics.Gamma=1`` as ``Gamma=1``."""
    label, _, value = override.partition("=")
    return f"{label.rpartition('.')[2]}={shorten(value, 20)}"
