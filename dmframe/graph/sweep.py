"""Parameter sweep: figures of merit of one graph run with many values."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from dmframe.batch.columns import FIGURES, PREFIX, error_figures, limits_in, units_of
from dmframe.batch.figures import ERROR, TURN, Measured, MeasuredSignals, merged
from dmframe.batch.runner import Runner, Runs
from dmframe.block.parameter import Spec, specs
from dmframe.common.errors import DmframeError, ValueFault, raise_all
from dmframe.common.units import shorten, to_unit
from dmframe.config.given import listed
from dmframe.graph.graph import Graph
from dmframe.graph.load import load
from dmframe.results.metrics import EIGHTHS

if TYPE_CHECKING:
    import xarray

    from dmframe.simulate.engine import Choice

Design = Literal["grid", "list"]

MOST_FAULTS: Final = 10
"""Faults of single runs that one error lists."""

MOST_RUNS: Final = 10**7
"""Runs whose figures fit into one process."""

RUN: Final = "run"
"""The dimension of a list of runs."""


def sweep(
    graph: Graph | str | Path | Mapping[str, Any],
    values: Mapping[str, Iterable[Any]],
    *,
    until: float | str | None = None,
    design: Design = "grid",
    signals: Sequence[str] = (),
    limits: Mapping[str, float | str] | None = None,
    engine: Choice = "auto",
) -> xarray.Dataset:
    """Figures of one graph run with many values, ``dm.sweep("ur10_fast", {"dynamics.Gamma": [1, 10, 100]})``.

    If only numbers of blocks change, several runs are computed at a time in vector registers, on all cores: tens of
    thousands of times faster than real time on each. `compare` keeps whole runs instead, for figures over time.

    Parameters
    ----------
    values
        By ``block.parameter`` or a key of the graph file, the values to try; see `Graph.set`.
    until
        Simulated time, ``2``, ``"2 s"``; the graph's duration by default.
    design
        ``grid``: every combination, with a dimension per name. ``list``: the same number of values of each, combined
        element by element; the dimension is called ``run``.
    signals
        Labels ``block.signal`` whose least, largest and last value and RMS over the last eighth are kept, in addition
        to the tracking error.
    limits
        By label, or ``error`` or ``turn``: an absolute value, as a number in the signal's unit or a text with one; the
        time at which it is first exceeded is kept.
    engine
        See `Graph.run`.

    Returns
    -------
    xarray.Dataset
        Figures with the names of a study's columns: ``rms_1`` to ``rms_8``, ``rms_final`` and ``error_most`` of the
        tracking error's norm; ``turn_1`` to ``turn_8``, ``turn_final`` and ``turn_most`` of the tool's orientation
        error, in degrees; ``diverged``, ``diverged_at`` [s], ``<signal>.least``, ``.most``, ``.last``, ``.rms_final``,
        ``.crossed`` [s], and ``error_crossed``, ``turn_crossed``; nan after a divergence. The extremes of a run that
        diverged are those until then: check ``diverged`` first. Units are attributes. Deprecated names, such as
        ``rms_by_eighth``, ``turn_rms_final`` and ``<signal>_most``, hold the same numbers; their attribute ``instead``
        is the name to use.

    Raises
    ------
    DmframeError
        Faults of any of the values, and of the first runs that cannot be prepared.
    """
    if design not in get_args(Design):
        raise ValueFault(f"design: expected {' or '.join(get_args(Design))}, found {design!r}")
    base, tried = load(graph), listed(values)
    base = base if until is None else base.until(until)
    lengths = {label: len(several) for label, several in tried.items()}
    if design == "list" and len(set(lengths.values())) > 1:
        counts = ", ".join(f"{label} {length}" for label, length in lengths.items())
        raise ValueFault(f"values: expected lists of equal length, found {counts}")
    _check_distinct(tried)
    wanted = _measured_signals(base, signals, limits)
    shape = tuple(lengths.values()) if design == "grid" else (max(lengths.values(), default=1),)
    if (runs := math.prod(shape)) > MOST_RUNS:
        raise ValueFault(f"values: expected at most {MOST_RUNS} runs, found {runs}; take fewer, or run a study")
    indices = np.indices(shape).reshape(len(shape), runs)
    places = dict(zip(tried, indices if design == "grid" else [indices[0]] * len(tried), strict=True))
    found = _measured(base, tried, places, wanted, engine)
    raise_all(list(found.faults.values())[:MOST_FAULTS])
    names = list(tried) if design == "grid" else [RUN]
    return _dataset(base, found, names, shape, {label: _axis(base, label, several) for label, several in tried.items()})


def _check_distinct(labels: Iterable[str]) -> None:
    """Raise `ValueFault` if one parameter has two names: one list would silently replace the other."""
    found = dict[str, str]()
    for label in labels:
        name = label.strip().removeprefix("blocks.")
        if name in found:
            raise ValueFault(f"values: {found[name]} and {label} are the same parameter; remove one")
        found[name] = label


def _measured_signals(base: Graph, signals: Sequence[str], limits: Mapping[str, float | str] | None) -> MeasuredSignals:
    """What to measure, with limits as numbers. `Batch.of` refuses unknown names."""
    labels = [signals] if isinstance(signals, str) else signals
    labels = list(labels) if isinstance(labels, Iterable) else [labels]
    for label in labels:
        if not isinstance(label, str):
            raise ValueFault(f'signals: expected names such as ["servo.u"], found {shorten(repr(label), 30)}')
    if not isinstance(limits, Mapping | None):
        raise ValueFault(f'limits: expected numbers by name, {{"error": 0.01}}, found {shorten(repr(limits), 30)}')
    found, faults = limits_in(units_of(base.diagram), limits or {}, "limits")
    for label, limit in found.items():
        if limit < 0:
            faults.append(ValueFault(f"limits.{label}: expected a number of at least 0, found {limit:g}"))
    raise_all(faults)
    return MeasuredSignals(tuple(labels), {**dict.fromkeys(limits or {}, np.inf), **found})


def _column(base: Graph, label: str, several: Sequence[Any]) -> np.ndarray | None:
    """Values of a block's parameter as numbers, a row each; None for other values."""
    spec = _spec(base, label)
    if spec is None or getattr(base.blocks[label.partition(".")[0]], label.partition(".")[2]) is None:
        return None
    try:
        return np.array([_number(value, spec.unit) for value in several], dtype=float)
    except (DmframeError, TypeError, ValueError):
        return None


def _number(value: Any, unit: str) -> Any:
    return [_number(item, unit) for item in value] if isinstance(value, list | tuple) else to_unit(value, unit)


def _spec(base: Graph, label: str) -> Spec | None:
    block, _, name = label.partition(".")
    return specs(type(base.blocks[block])).get(name) if block in base.blocks else None


def _measured(
    base: Graph,
    tried: Mapping[str, Sequence[Any]],
    places: Mapping[str, np.ndarray],
    wanted: MeasuredSignals,
    engine: Choice,
) -> Measured:
    """All runs: values that are numbers of blocks as columns, other values as graphs of their own."""
    columns = {label: column for label in tried if (column := _column(base, label, tried[label])) is not None}
    others = [label for label in tried if label not in columns]
    runs = next((place.size for place in places.values()), 1)
    members = defaultdict[tuple[int, ...], list[int]](list)
    for run in range(runs):
        members[tuple(int(places[label][run]) for label in others)].append(run)
    several, faults, runner = list[Runs](), list[DmframeError](), Runner()
    runner.own_loop(base, base.diagram)
    for chosen, some in members.items():
        try:
            values = {label: tried[label][place] for label, place in zip(others, chosen, strict=True)}
            graph = base.set(values) if values else base
            rows = {label: column[places[label][some]] for label, column in columns.items()}
            several.append(Runs(graph, rows, len(some)))
        except DmframeError as error:
            faults += error.faults
    raise_all(faults)
    found = runner.measure(several, lambda _: wanted, engine=engine)
    return merged([(np.array(some), part) for some, part in zip(members.values(), found, strict=True)], runs)


def _axis(base: Graph, label: str, several: Sequence[Any]) -> tuple[list[Any], str]:
    """Values as coordinates, as numbers if possible, else as texts; and their unit."""
    column, spec = _column(base, label, several), _spec(base, label)
    if column is not None and column.ndim == 1:
        return column.tolist(), spec.unit if spec else ""
    plain = all(isinstance(value, int | float) and not isinstance(value, bool) for value in several)
    return [value if plain else shorten(str(value)) for value in several], ""


def _dataset(
    base: Graph,
    found: Measured,
    names: Sequence[str],
    shape: tuple[int, ...],
    axes: Mapping[str, tuple[list[Any], str]],
) -> xarray.Dataset:
    import xarray

    def labelled(values: np.ndarray, unit: str, *more: str) -> xarray.Variable:
        return xarray.Variable(
            [*names, *more], values.reshape((*shape, *values.shape[1:])), {"units": unit} if unit else {}
        )

    data = {"diverged": labelled(np.isfinite(found.diverged), ""), "diverged_at": labelled(found.diverged, "s")}
    deprecated = dict[str, tuple[str, xarray.Variable]]()  # old names, with the name to use instead
    for label, figures in found.signals.items():
        if label in PREFIX:
            parts = error_figures(label, figures)
            if not np.isfinite(figures.crossed).any():
                del parts[f"{label}_crossed"]
            data |= {name: labelled(values, unit) for name, (values, unit) in parts.items()}
            of, older = PREFIX[label], "rms" if label == ERROR else f"{label}_rms"
            deprecated[f"{older}_by_eighth"] = f"{of}_1", labelled(figures.rms_by_eighth[:, 0], figures.unit, "eighth")
            if label == TURN:
                deprecated[f"{older}_final"] = f"{of}_final", data[f"{of}_final"]
            continue
        for name in (*FIGURES, *(["crossed"] if np.isfinite(figures.crossed).any() else [])):
            unit = "s" if name == "crossed" else figures.unit
            data[f"{label}.{name}"] = labelled(getattr(figures, name), unit, f"{label}_row")
            deprecated[f"{label}_{name}"] = f"{label}.{name}", data[f"{label}.{name}"]
    for name, (instead, item) in deprecated.items():
        data[name] = xarray.Variable(item.dims, item.data, {**item.attrs, "instead": instead})
    coordinates = {
        label: xarray.Variable([label if label in names else RUN], values, {"units": unit} if unit else {})
        for label, (values, unit) in axes.items()
    }
    about: dict[str, Any] = {"graph": base.name, "engine": found.engine, "notices": "; ".join(found.notices)}
    if "duration" not in axes:
        about["duration"] = base.duration
    return xarray.Dataset(data, coordinates | {"eighth": np.arange(1, EIGHTHS + 1)}, about)
