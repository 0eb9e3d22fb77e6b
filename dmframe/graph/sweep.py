"""One graph with many values, and of each run its figures."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from dmframe.batch import Batch, Measured, Wanted
from dmframe.batch.figures import ERROR, TURN, Board
from dmframe.errors import DmframeError, NeedsDiagramError, ValueFault, raise_all
from dmframe.graph.arguments import listed
from dmframe.graph.graph import Graph
from dmframe.graph.load import load
from dmframe.parameter import Spec, specs
from dmframe.results.metrics import EIGHTHS, TurnError, goal_of
from dmframe.simulate.keep import apart_of
from dmframe.units import shorten, to_unit

if TYPE_CHECKING:
    import xarray

    from dmframe.simulate.engine import Choice

Design = Literal["grid", "list"]

MOST_FAULTS: Final = 10
"""Of runs that cannot be made, so many are told."""

MOST_RUNS: Final = 10**7
"""Whose figures one process holds."""

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

    Where no more than numbers of blocks change, runs are computed several at a time in vector registers, on all cores:
    tens of thousands of times real time on each. `compare` keeps whole runs instead, for figures over time.

    Parameters
    ----------
    values
        By ``block.parameter`` or a key of the graph file, the values to try; see `Graph.set`.
    until
        Simulated time, ``2``, ``"2 s"``; the graph's duration without it.
    design
        ``grid``: every combination, a dimension for each name. ``list``: as many values of each, which go together;
        the dimension is called ``run``.
    signals
        Labels ``block.signal`` of which the least, the largest, the last value and the RMS over the last eighth are
        kept, beside the tracking error.
    limits
        By label, or ``error`` or ``turn``: when the absolute value first left it, a number in the signal's unit or a
        text with one.
    engine
        See `Graph.run`.

    Returns
    -------
    xarray.Dataset
        Figures by the names that a study's table has: ``rms_1`` to ``rms_8``, ``rms_final`` and ``error_most`` of the
        tracking error's norm; of a tool's turn from its orientation, in degrees, ``turn_1`` to ``turn_8``,
        ``turn_final`` and ``turn_most``; ``diverged``, ``diverged_at`` [s], ``<signal>.least``, ``.most``, ``.last``,
        ``.rms_final``, ``.crossed`` [s], and ``error_crossed``, ``turn_crossed``; nan where a run never came. The
        extremes of a run that diverged are those until then: look at ``diverged`` first. Units are attributes. The
        names of before, such as ``rms_by_eighth``, ``turn_rms_final`` and ``<signal>_most``, hold the same numbers, and
        say by the attribute ``instead`` what to write in their place.

    Raises
    ------
    DmframeError
        Faults of any of the values, and of the first run that cannot be made.
    """
    if design not in get_args(Design):
        raise ValueFault(f"design: expected {' or '.join(get_args(Design))}, found {design!r}")
    base, tried = load(graph), listed(values)
    base = base if until is None else base.until(until)
    lengths = {label: len(several) for label, several in tried.items()}
    if design == "list" and len(set(lengths.values())) > 1:
        told = ", ".join(f"{label} {length}" for label, length in lengths.items())
        raise ValueFault(f"values: expected as many of each in a list, found {told}")
    _apart(tried)
    wanted = _wanted(base, signals, limits)
    shape = tuple(lengths.values()) if design == "grid" else (max(lengths.values(), default=1),)
    if (runs := math.prod(shape)) > MOST_RUNS:
        raise ValueFault(f"values: expected at most {MOST_RUNS} runs, found {runs}; take fewer, or a study")
    indices = np.indices(shape).reshape(len(shape), runs)
    places = dict(zip(tried, indices if design == "grid" else [indices[0]] * len(tried), strict=True))
    numbers = {label: column for label in tried if (column := _column(base, label, tried[label])) is not None}
    try:
        found = _measured(base, tried, places, numbers, wanted, engine)
    except NeedsDiagramError:
        found = _measured(base, tried, places, {}, wanted, engine)
    raise_all(list(found.faults.values())[:MOST_FAULTS])
    names = list(tried) if design == "grid" else [RUN]
    return _dataset(base, found, names, shape, {label: _axis(base, label, several) for label, several in tried.items()})


def _apart(labels: Iterable[str]) -> None:
    """Raise `ValueFault` where one parameter stands under two names: one of them would win unseen."""
    found = dict[str, str]()
    for label in labels:
        name = label.strip().removeprefix("blocks.")
        if name in found:
            raise ValueFault(f"values: {found[name]} and {label} are the same parameter; leave one out")
        found[name] = label


def _wanted(base: Graph, signals: Sequence[str], limits: Mapping[str, float | str] | None) -> Wanted:
    """What is measured, limits as numbers. Names that there are not are told by `Batch.of`."""
    labels = [signals] if isinstance(signals, str) else signals
    labels = list(labels) if isinstance(labels, Iterable) else [labels]
    for label in labels:
        if not isinstance(label, str):
            raise ValueFault(f'signals: expected names such as ["servo.u"], found {shorten(repr(label), 30)}')
    if not isinstance(limits, Mapping | None):
        raise ValueFault(f'limits: expected numbers by name, {{"error": 0.01}}, found {shorten(repr(limits), 30)}')
    loop, found, faults = base.diagram.loop, dict[str, float](), list[DmframeError]()
    units = {signal.label: signal.unit for signal in loop.outputs}
    units |= {variable.label: variable.unit for variable in loop.variables}
    goal = goal_of(loop)
    units |= {} if goal is None else {ERROR: units[goal.actual]}
    units |= {} if apart_of(loop) is None else {TURN: TurnError.unit}
    for label, value in (limits or {}).items():
        number = value.item() if isinstance(value, np.generic) else value
        try:
            found[label] = to_unit(number, units.get(label, ""))
        except DmframeError as error:
            if label in units:
                faults.append(type(error)(f"limits.{label}: {error.text}"))
            else:
                found[label] = np.inf
            continue
        if found[label] < 0:
            faults.append(ValueFault(f"limits.{label}: expected a number of at least 0, found {found[label]:g}"))
    raise_all(faults)
    return Wanted(tuple(labels), found)


def _column(base: Graph, label: str, several: Sequence[Any]) -> np.ndarray | None:
    """Values of a block's parameter as numbers, a row each; None for anything else."""
    spec = _spec(base, label)
    if spec is None or getattr(base.experiment.blocks[label.partition(".")[0]], label.partition(".")[2]) is None:
        return None
    try:
        return np.array([_number(value, spec.unit) for value in several], dtype=float)
    except (DmframeError, TypeError, ValueError):
        return None


def _number(value: Any, unit: str) -> Any:
    return [_number(item, unit) for item in value] if isinstance(value, list | tuple) else to_unit(value, unit)


def _spec(base: Graph, label: str) -> Spec | None:
    block, _, name = label.partition(".")
    return specs(type(base.experiment.blocks[block])).get(name) if block in base.experiment.blocks else None


def _measured(
    base: Graph,
    tried: Mapping[str, Sequence[Any]],
    places: Mapping[str, np.ndarray],
    numbers: Mapping[str, np.ndarray],
    wanted: Wanted,
    engine: Choice,
) -> Measured:
    """All runs: together those whose graphs differ by numbers alone."""
    shaping = [label for label in tried if label not in numbers]
    runs = next((place.size for place in places.values()), 1)
    members = defaultdict[tuple[int, ...], list[int]](list)
    for run in range(runs):
        members[tuple(int(places[label][run]) for label in shaping)].append(run)
    graphs, faults = dict[tuple[int, ...], Graph](), list[DmframeError]()
    for chosen in members:
        try:
            values = {label: tried[label][place] for label, place in zip(shaping, chosen, strict=True)}
            graphs[chosen] = base.set(values) if values else base
        except DmframeError as error:
            faults += error.faults
    raise_all(faults)
    board: Board | None = None
    for chosen, graph in graphs.items():
        mine = np.array(members[chosen])
        batch = Batch.of(graph.diagram, graph.duration, wanted=wanted, engine=engine, **graph.experiment.settings)
        found = batch.measure({label: column[places[label][mine]] for label, column in numbers.items()})
        board = board or Board.like(found, runs)
        board.put(mine, found)
    assert board is not None  # there is a run, and so a graph
    return board.measured()


def _axis(base: Graph, label: str, several: Sequence[Any]) -> tuple[list[Any], str]:
    """Values as coordinates, numbers where they are, else texts; and their unit."""
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
    before = dict[str, tuple[str, xarray.Variable]]()  # names of versions before, with what to write instead
    for label, figures in found.signals.items():
        rows = [] if label in (ERROR, TURN) else [f"{label}_row"]
        parts = {"least": figures.least, "most": figures.most, "last": figures.last, "rms_final": figures.rms_final}
        if label in (ERROR, TURN):
            rms, of = figures.rms_by_eighth[:, 0], "rms" if label == ERROR else label
            data |= {f"{of}_{k + 1}": labelled(rms[:, k], figures.unit) for k in range(EIGHTHS)}
            data[f"{of}_final"] = labelled(rms[:, -1], figures.unit)
            data[f"{label}_most"] = labelled(figures.most[:, 0], figures.unit)
            older = "rms" if label == ERROR else f"{label}_rms"
            before[f"{older}_by_eighth"] = f"{of}_1", labelled(rms, figures.unit, "eighth")
            if label == TURN:
                before[f"{older}_final"] = f"{of}_final", data[f"{of}_final"]
        else:
            found_here = {f"{label}.{name}": labelled(part, figures.unit, *rows) for name, part in parts.items()}
            data |= found_here
            before |= {f"{label}_{name.removeprefix(f'{label}.')}": (name, item) for name, item in found_here.items()}
        crossed = figures.crossed[:, 0] if not rows else figures.crossed
        if np.isfinite(crossed).any():
            data[f"{label}.crossed" if rows else f"{label}_crossed"] = labelled(crossed, "s", *rows)
            if rows:
                before[f"{label}_crossed"] = f"{label}.crossed", data[f"{label}.crossed"]
    for name, (instead, item) in before.items():
        data[name] = xarray.Variable(item.dims, item.data, {**item.attrs, "instead": instead})
    coordinates = {
        label: xarray.Variable([label if label in names else RUN], values, {"units": unit} if unit else {})
        for label, (values, unit) in axes.items()
    }
    told: dict[str, Any] = {"graph": base.name, "engine": found.engine, "notices": "; ".join(found.notices)}
    if "duration" not in axes:
        told |= {"duration": base.duration}
    return xarray.Dataset(data, coordinates | {"eighth": np.arange(1, EIGHTHS + 1)}, told)
