"""A graph that has run, as a person holds it: numbers with names and units, figures, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from dmframe import notebook
from dmframe.columns import columns
from dmframe.config import Experiment
from dmframe.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.files import expanded
from dmframe.plotting import FORMATS
from dmframe.results.dataset import dataset
from dmframe.results.metrics import TrackingError, TurnError, tracking_error, turn_error
from dmframe.results.shown import Shown, shown_by
from dmframe.results.storage import SIGNALS, Storage, storage_of, with_storage
from dmframe.results.summary import summary, summary_of
from dmframe.simulate import Divergence, Recording
from dmframe.units import plain

if TYPE_CHECKING:
    import xarray

    from dmframe.results.figures import Figures

HEADS = ("graph", "clock", "error", "first eighth", "last eighth", "speed", "engine")
RIGHT = (1, 3, 4, 5)
NOTE = "error: root mean square of its Euclidean norm; speed: times real time"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Run:
    """A graph with what its run recorded.

    ``run["arm.q"]`` is a signal as an xarray, time by joint, with its unit; ``run.data`` holds all of them.
    ``run["V"]`` is the Lyapunov function that its blocks claim, ``run["V.dynamics"]`` the part of one block,
    ``run["V_rate"]`` dV/dt as the claim states it. V is computed when it or the notices are read: it takes a fraction
    of a second.

    Parameters
    ----------
    experiment
        The graph that ran.
    recording
        Its states and outputs as plain arrays.
    label
        What tables and legends call it; the graph's name.
    """

    experiment: Experiment
    recording: Recording
    label: str = field(default="")

    @property
    def name(self) -> str:
        """What tables and legends call it."""
        return self.label or self.experiment.name

    @property
    def time(self) -> np.ndarray:
        """(N,), the instants that were kept [s]."""
        return self.recording.time

    @property
    def divergence(self) -> Divergence | None:
        """Where the run left the finite numbers first, if it did."""
        return self.recording.divergence

    @property
    def notices(self) -> tuple[str, ...]:
        """What the run has to say of itself, the rise of V last."""
        storage, own = self._storage, self.recording.notices
        return (*own, storage.notice) if isinstance(storage, Storage) and storage.notice else own

    @cached_property
    def data(self) -> xarray.Dataset:
        """Every recorded signal ``block.signal`` over time, with its unit and the names of its elements; V, if any."""
        return dataset(self.whole, self.experiment)

    @property
    def whole(self) -> Recording:
        """The recording with V among its signals, where there is a V."""
        storage = self._storage
        return with_storage(self.recording, storage if isinstance(storage, Storage) else None)

    @property
    def storage(self) -> Storage:
        """V along the run, how far it rose, and what is known of the reason.

        Raises
        ------
        DmframeError
            The graph has no V, or the run did not keep what V holds: with the reason.
        """
        if isinstance(self._storage, DmframeError):
            raise self._storage
        return self._storage

    @cached_property
    def _storage(self) -> Storage | DmframeError:
        try:
            return storage_of(self.recording, self.experiment)
        except DmframeError as error:
            return error

    @cached_property
    def _recorded(self) -> xarray.Dataset:
        """`data` without V, which takes time."""
        return dataset(self.recording, self.experiment)

    @cached_property
    def error(self) -> TrackingError | None:
        """The tracking error, actual minus desired; None for a graph without a goal."""
        return tracking_error(self.recording)

    @cached_property
    def turn(self) -> TurnError | None:
        """The angle between the tool's orientation and the desired one; None for a task without one."""
        return turn_error(self.recording)

    @cached_property
    def shown(self) -> list[Shown]:
        """What its blocks show of their estimates at its end, with how much of it was felt."""
        return shown_by(self.recording)

    @property
    def summary(self) -> dict[str, Any]:
        """What ``dmframe run --json`` prints of it."""
        return summary_of(self)

    def __getitem__(self, label: str) -> xarray.DataArray:
        if not isinstance(label, str):
            raise ValueFault(
                f"run[{label!r:.40}]: expected a signal's name such as arm.q, found {type(label).__name__}"
            )
        if label not in self and _of_storage(label):
            if isinstance(self._storage, DmframeError):
                reason = self._storage.text
                raise ValueFault(f"run[{label!r}]: expected a graph with a claim about V, found none: {reason}")
            held = self._storage.signals
            if label not in held:
                raise UnknownNameError(f"run[{label!r}]", "signal", label, held)
            return self.data[label]
        if label not in self:
            own = [name for name in self if name.startswith(f"{label}.")]
            raise UnknownNameError(f"run[{label!r}]", "signal", "" if own else label, own or self)
        return self._recorded[label]

    def __contains__(self, label: object) -> bool:
        return isinstance(label, str) and self._has(label)

    def _has(self, label: str) -> bool:
        return label in self.recording.states or label in self.recording.outputs

    def __iter__(self) -> Iterator[str]:
        yield from self.recording.states
        yield from self.recording.outputs

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def plot(self, *signals: str | Sequence[str]) -> Figures:
        """The figures of the command line, or one of some signals, ``run.plot("arm.q", "dynamics.tau_dc")``.

        Raises
        ------
        UnknownNameError
            The run recorded no such signal.
        """
        return drawn([self], signals)

    def save(
        self, folder: str | Path, *, plots: bool = True, formats: Sequence[str] = FORMATS[:1], force: bool = False
    ) -> Path:
        """Write signals, graph, summary and figures to a new or an empty folder, all of it or nothing.

        Figures in the formats that are named: ``svg``, ``png``, ``pdf``.

        With `force` the folder may hold files; those of the same names are replaced.

        Raises
        ------
        OutputError
            The folder has files in it, or cannot be written.
        """
        return saved([self], folder, plots=plots, formats=formats, force=force)

    def __reduce__(self) -> Any:
        """Pickled with its arrays; its diagram is made anew when it is read."""
        held = {name: value for name, value in vars(self.recording).items() if name != "diagram"}
        return _again, (self.experiment, held, self.label)

    def __repr__(self) -> str:
        lasted = self.divergence or self.recording.interrupted
        time = float(self.time[-1]) if lasted else self.recording.duration
        return f"<Run {self.name}: {plain(time, 's')}, {self._ended()}{self._followed()}>"

    def __str__(self) -> str:
        return table_of([self])

    def _repr_html_(self) -> str:
        from dmframe.results.figures import error_picture

        rows = [row(self)]
        told = [*(f"notice: {notice}" for notice in self.notices), *map(str, self.shown), *ended(self)]
        return (
            notebook.heading(self.name, self.experiment.file.title)
            + notebook.table(rows, HEADS)
            + notebook.paragraphs([NOTE, *told])
            + error_picture({self.name: self})
        )

    def _ended(self) -> str:
        if self.divergence is not None:
            return f"diverged: {self.divergence}"
        return "stopped" if self.recording.interrupted else "to its end"

    def _followed(self) -> str:
        error = self.error
        if error is None or error.rms_final is None:
            return ""
        turned = "" if self.turn is None else f" and turned by {_shown(self.turn.rms_final, self.turn.unit)}"
        return f", |{error.signal}| {plain(error.rms_final, error.unit)}{turned} RMS in the last eighth"


def _of_storage(label: str) -> bool:
    return label in SIGNALS or label.startswith("V.")


def drawn(runs: Sequence[Run], signals: Sequence[str | Sequence[str]]) -> Figures:
    """See `Run.plot`."""
    from dmframe.results.figures import figures_of, signals_figure

    named = {run.name: run for run in runs}
    labels = [each for item in signals for each in ([item] if isinstance(item, str) else item)]
    return signals_figure(named, labels) if labels else figures_of(named)


def saved(runs: Sequence[Run], folder: str | Path, *, plots: bool, formats: Sequence[str], force: bool) -> Path:
    """See `Run.save`."""
    from dmframe.results.folder import write_run

    path = expanded(folder)
    write_run(path, runs, plots=plots, formats=formats, force=force)
    return path


def row(run: Run) -> tuple[str, ...]:
    """A run under `HEADS`."""
    told = summary(run.experiment.name, run.recording)
    error, turn = told["error"], told["turn"]
    clock = told["clock"] if told["clock"] == "continuous" else plain(told["clock"], "s")
    first, last = (", ".join(_rms(each, index) for each in (error, turn) if each) or "-" for index in (0, -1))
    signal = (error["signal"] if error else "-") + (", turn" if turn else "")
    factor = told["real_time_factor"]
    speed = "-" if factor is None else f"{factor:.0f} x"
    return run.name, clock, signal, first, last, speed, told["engine"]


def _rms(error: Mapping[str, Any], index: int) -> str:
    return _shown(error["rms_by_eighth"][index], error["unit"])


def _shown(value: float | None, unit: str) -> str:
    return "-" if value is None else plain(value, unit)


def ended(run: Run) -> list[str]:
    """How a run ended, where it did not end well."""
    told = list[str]()
    if run.divergence is not None:
        told.append(f"diverged: {run.divergence}")
    if run.recording.interrupted:
        told.append(f"stopped at {plain(float(run.time[-1]), 's')}; what was done is kept")
    return told


def table_of(runs: Sequence[Run]) -> str:
    """Runs for a terminal: a line each, then their notices."""
    lines = [columns([HEADS, *map(row, runs)], indent="", right=RIGHT), NOTE]
    for run in runs:
        lines += [f"{run.name}: notice: {notice}" for notice in run.notices]
        lines += [f"{run.name}: {item}" for item in run.shown]
        lines += [f"{run.name}: {text}" for text in ended(run)]
    return "\n".join(lines)


def _again(experiment: Experiment, held: dict[str, Any], label: str) -> Run:
    """A run that was pickled."""
    return Run(experiment, Recording(diagram=experiment.diagram(), **held), label)
