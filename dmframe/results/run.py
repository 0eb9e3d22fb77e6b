"""Run of a graph: labelled signals, metrics, figures, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.common import notebook
from dmframe.common.columns import columns
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.common.files import expanded
from dmframe.common.plotting import FORMATS
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.config.about import AboutGraph
from dmframe.results.dataset import dataset
from dmframe.results.decided import Decided
from dmframe.results.metrics import TrackingError, TurnError, tracking_error, turn_error
from dmframe.results.reported import ReportedEstimate, reported_estimates
from dmframe.results.storage import SIGNALS, Storage, decided_by, storage_of, with_storage
from dmframe.results.summary import integrated, summary, summary_of
from dmframe.simulate import Divergence, Recording

if TYPE_CHECKING:
    import xarray

    from dmframe.certify.claim import Claim
    from dmframe.results.figures import Figures
    from dmframe.results.next_turn import NextTurn

HEADS = ("graph", "clock", "error", "first eighth", "last eighth", "speed", "engine")
RIGHT = (1, 3, 4, 5)
NOTE = "error: root mean square of its Euclidean norm; speed: times real time"


@final
@dataclass(frozen=True, repr=False, eq=False)
class Run(AboutGraph):
    """Graph with the recording of its run.

    ``run["arm.q"]`` is a signal as an xarray, time by joint, with its unit; ``run.data`` contains all of them.
    ``run["V"]`` is the Lyapunov function of the certificates, ``run["V.dynamics"]`` the storage function of one block,
    ``run["V_rate"]`` dV/dt according to the certificates. V is computed when it or the notices are read, in a fraction
    of a second.

    Parameters
    ----------
    graph
        The graph that ran.
    recording
        States and outputs as plain arrays.
    label
        Name in tables and legends; default: the name of the graph.
    """

    graph: BaseGraph
    recording: Recording
    label: str = field(default="")

    @property
    def name(self) -> str:
        """Name in tables and legends."""
        return self.label or self.graph.name

    @property
    def time(self) -> np.ndarray:
        """(N,), recorded instants [s]."""
        return self.recording.time

    @property
    def divergence(self) -> Divergence | None:
        """First state that is not finite or beyond its bound, or a tracking error that grows; None without any."""
        return self.recording.divergence

    @property
    def notices(self) -> tuple[str, ...]:
        """Warnings of the run, that on V last."""
        storage, own = self._storage, self.recording.notices
        return (*own, storage.notice) if isinstance(storage, Storage) and storage.notice else own

    def noticed(self, *texts: str) -> Run:
        """The same run with more notices of its own; V is not computed again."""
        result = Run(self.graph, replace(self.recording, notices=(*self.recording.notices, *texts)), self.label)
        for known in ("_storage", "_turns"):
            if known in vars(self):
                vars(result)[known] = getattr(self, known)
        return result

    @cached_property
    def data(self) -> xarray.Dataset:
        """Recorded signals ``block.signal`` over time with units and element names, and V if defined."""
        return dataset(self.whole, self.graph)

    @property
    def whole(self) -> Recording:
        """Recording with V among its signals, if defined."""
        storage = self._storage
        return with_storage(self.recording, storage if isinstance(storage, Storage) else None)

    @property
    def storage(self) -> Storage:
        """V along the run, its rise and possible causes.

        Raises
        ------
        DmframeError
            If the graph has no V, or the run did not record the signals in V.
        """
        if isinstance(self._storage, DmframeError):
            raise self._storage
        return self._storage

    @cached_property
    def _storage(self) -> Storage | DmframeError:
        try:
            return storage_of(self.recording, self.graph)
        except DmframeError as error:
            return error

    def decide(self, decided: Decided) -> None:
        """Evaluate V with what was decided before from the same graph."""
        try:
            vars(self)["_storage"] = storage_of(self.recording, self.graph, decided)
        except DmframeError as error:
            vars(self)["_storage"] = error

    def next_turn(self, eta: float | Sequence[float] | None = None) -> NextTurn:
        """Bound on the error in the next turn of a repeated path, from the samples of the last one (`NextTurn`).

        Parameters
        ----------
        eta
            Upper limit of what the true parameters leave unexplained of a sample, for all joints or for each; by
            default the largest prediction errors of the last turn.

        Raises
        ------
        DmframeError
            The law has no certificate over samples, or the reason why there is no bound.
        """
        from dmframe.results.next_turn import next_turn

        return next_turn(self.recording, self._claim, eta)

    @cached_property
    def _claim(self) -> Claim:
        """The claim of the diagram that ran; a drive, whose V is not evaluated, has one too."""
        if not isinstance(self._storage, DmframeError):
            return self._storage.claim
        if not self.recording.diagram.loop.discrete_time:
            raise self._storage
        from dmframe.certify.claim import claim_of

        with SYMBOLIC:
            return claim_of(self.recording.diagram, held=False, named=False)

    @cached_property
    def _turns(self) -> tuple[NextTurn | None, str]:
        """The bound on the next turn with the observed eta, or why there is none; empty without update steps."""
        try:
            claim = self._claim
        except DmframeError:
            return None, ""
        if not any(part.certificate.steps for part in claim.parts):
            return None, ""
        try:
            return self.next_turn(), ""
        except DmframeError as error:
            return None, error.text

    @property
    def bounded(self) -> list[str]:
        """The bound on the next turn as a sentence, if there is one."""
        found, _ = self._turns
        return [] if found is None else [f"{self.name}: {found}"]

    @property
    def bounds(self) -> list[dict[str, Any]]:
        """Bounds from the data of this run, as ``run --json`` lists them."""
        found, _ = self._turns
        return [] if found is None else [found.summary]

    @property
    def bounds_missing(self) -> list[str]:
        """Why a law with update steps has no bound from data."""
        _, reason = self._turns
        return [reason] if reason else []

    @property
    def decided(self) -> Decided | None:
        """What the graph decides about V; None where it is not known."""
        return decided_by(self.recording, self.graph, self._storage)

    @cached_property
    def _recorded(self) -> xarray.Dataset:
        """`data` without V, whose evaluation takes time."""
        return dataset(self.recording, self.graph)

    @cached_property
    def error(self) -> TrackingError | None:
        """Tracking error, actual minus desired; None for a graph without a goal."""
        return tracking_error(self.recording)

    @cached_property
    def turn(self) -> TurnError | None:
        """Angle between actual and desired tool orientation; None for a task without orientation."""
        return turn_error(self.recording)

    @cached_property
    def shown(self) -> list[ReportedEstimate]:
        """Estimates that blocks report at the end of the run, with their excitation."""
        return reported_estimates(self.recording)

    @property
    def summary(self) -> dict[str, Any]:
        """Data that ``dmframe run --json`` prints."""
        return summary_of(self)

    def __getitem__(self, label: str) -> xarray.DataArray:
        if not isinstance(label, str):
            raise ValueFault(
                f"run[{label!r:.40}]: expected a signal's name such as arm.q, found {type(label).__name__}"
            )
        if label not in self and (label in SIGNALS or label.startswith("V.")):
            if isinstance(self._storage, DmframeError):
                reason = self._storage.text
                raise ValueFault(f"run[{label!r}]: expected a graph with a certificate, found none: {reason}")
            signals = self._storage.signals
            if label not in signals:
                raise UnknownNameError(f"run[{label!r}]", "signal", label, signals)
            return self.data[label]
        if label not in self:
            own = [name for name in self if name.startswith(f"{label}.")]
            raise UnknownNameError(f"run[{label!r}]", "signal", "" if own else label, own or self)
        return self._recorded[label]

    def __contains__(self, label: object) -> bool:
        return label in self.recording.states or label in self.recording.outputs

    def __iter__(self) -> Iterator[str]:
        yield from self.recording.states
        yield from self.recording.outputs

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def plot(self, *signals: str | Sequence[str]) -> Figures:
        """Default figures, or a figure of the given signals, ``run.plot("arm.q", "dynamics.tau_dc")``.

        Raises
        ------
        UnknownNameError
            If a signal was not recorded.
        """
        return drawn([self], signals)

    def save(
        self, folder: str | Path, *, plots: bool = True, formats: Sequence[str] = FORMATS[:1], force: bool = False
    ) -> Path:
        """Write signals, graph, summary and figures (``svg``, ``png``, ``pdf``) atomically to a new or empty folder.

        With `force` the folder may contain files; those of the same names are replaced.

        Raises
        ------
        OutputError
            If the folder is not empty or cannot be written.
        """
        return saved([self], folder, plots=plots, formats=formats, force=force)

    def __reduce__(self) -> Any:
        """Pickle without the diagram, which is rebuilt from the graph."""
        arrays = {name: value for name, value in vars(self.recording).items() if name != "diagram"}
        return _restored, (self.graph, arrays, self.label)

    def __repr__(self) -> str:
        lasted = self.divergence or self.recording.interrupted
        time = float(self.time[-1]) if lasted else self.recording.duration
        return f"<Run {self.name}: {plain(time, 's')}, {self._ended()}{self._followed()}>"

    def __str__(self) -> str:
        return table_of([self])

    def _repr_html_(self) -> str:
        from dmframe.results.figures import error_picture

        rows = [row(self)]
        notes = [*ended(self), *(f"notice: {notice}" for notice in self.notices), *map(str, self.shown)]
        return (
            notebook.heading(self.name, self.graph.file.title)
            + notebook.table(rows, HEADS)
            + notebook.paragraphs([NOTE, *notes])
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
        if error.prismatic is not None:
            turned = f" and {_shown(error.prismatic.rms_final, error.prismatic.unit)}"
        return f", |{error.signal}| {plain(error.rms_final, error.unit)}{turned} RMS in the last eighth"


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
    """Table row of a run, columns `HEADS`."""
    data = summary(run.graph.name, run.recording)
    error, turn = data["error"], data["turn"]
    clock = data["clock"] if data["clock"] == "continuous" else plain(data["clock"], "s")
    shown = [each for each in (error, error and error.get("prismatic"), turn) if each]
    first, last = (", ".join(_rms(each, index) for each in shown) or "-" for index in (0, -1))
    signal = (error["signal"] if error else "-") + (", turn" if turn else "")
    factor = data["real_time_factor"]
    speed = "-" if factor is None else f"{factor:.0f} x"
    return run.name, clock, signal, first, last, speed, data["engine"]


def _rms(error: Mapping[str, Any], index: int) -> str:
    return _shown(error["rms_by_eighth"][index], error["unit"])


def _shown(value: float | None, unit: str) -> str:
    return "-" if value is None else plain(value, unit)


def ended(run: Run) -> list[str]:
    """Notes on divergence and interruption of a run."""
    notes = list[str]()
    if run.divergence is not None:
        notes.append(f"diverged: {run.divergence}")
    if run.recording.interrupted:
        notes.append(f"stopped at {plain(float(run.time[-1]), 's')}; the results so far are kept")
    return notes


def table_of(runs: Sequence[Run]) -> str:
    """Terminal table of runs, followed by their notes."""
    return "\n".join([numbers_of(runs), *notes_of(runs)])


def numbers_of(runs: Sequence[Run]) -> str:
    """Ends of runs and their table, without V, whose evaluation takes longer than a short run."""
    ends = [f"{run.name}: {text}" for run in runs for text in ended(run)]
    return "\n".join([*ends, columns([HEADS, *map(row, runs)], indent="", right=RIGHT), NOTE])


def notes_of(runs: Sequence[Run]) -> list[str]:
    """Warnings and reported estimates of each run."""
    lines = list[str]()
    for run in runs:
        lines += [f"{run.name}: {text}" for text in integrated(run.recording)]
        lines += [f"{run.name}: notice: {notice}" for notice in run.notices]
        lines += [f"{run.name}: {item}" for item in run.shown]
        lines += run.bounded
    return lines


def _restored(graph: BaseGraph, arrays: dict[str, Any], label: str) -> Run:
    """Restore a pickled run."""
    return Run(graph, Recording(diagram=graph.diagram, **arrays), label)
