"""Replay of a record: recomputes the commands from the recorded measurements, and compares them bit by bit.

Compared are the controller's command, the command after the gate, and the recorded states of the controller. Other
signals of the record are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import MissingError, listed
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.drive.drive import scaled_controller
from dmframe.drive.log import Log, read_log
from dmframe.drive.record import plain_signals
from dmframe.runtime.driving import STILL
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.robot import Sample
from dmframe.runtime.scaled import ScaledController
from dmframe.simulate.engine import Choice

PERIOD_DEVIATION: Final = 0.4
"""Tolerance for the time between samples as a whole number of periods [periods]."""
MOST_MISSED: Final = 2**31
"""Lost samples in a row above which a record is damaged."""
SENT: Final = "robot.sent"
_USUAL: Final = {"robot.scale": 1.0, "robot.missed": 0.0}
"""Values for a simulation's record, which lacks these signals."""


@final
@dataclass(frozen=True, eq=False)
class Compared:
    """Recorded and recomputed values of a signal, (N, n) each; rows of NaN where none is computed."""

    then: np.ndarray
    now: np.ndarray
    unit: str

    @property
    def rows(self) -> np.ndarray:
        """Rows that differ in any bit."""
        then, now = (np.ascontiguousarray(part, dtype=float).view(np.int64) for part in (self.then, self.now))
        return np.flatnonzero(np.any(then != now, axis=1))

    @property
    def largest(self) -> float:
        """Largest difference."""
        return float(np.nanmax(self.difference, initial=0.0))

    @property
    def difference(self) -> np.ndarray:
        """Absolute differences; NaN for two infinite numbers."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(np.abs(self.now - self.then))


@final
@dataclass(frozen=True, repr=False, eq=False)
class Replay:
    """Comparison of recorded and recomputed signals.

    Parameters
    ----------
    label
        Label of the controller's command, the joint velocities.
    time
        (N,) time of the controller [s].
    compared
        Label -> comparison, for the command, the command after the gate, and the controller's states.
    refused
        Number of samples that the controller refuses.
    engines
        Engine of the record, and of the replay.
    notices
        Why the comparison is incomplete.
    """

    name: str
    log: str
    label: str
    joints: tuple[str, ...]
    time: np.ndarray
    compared: Mapping[str, Compared]
    refused: int
    engines: tuple[str, str] = ("", "")
    notices: tuple[str, ...] = field(default=())

    @property
    def then(self) -> np.ndarray:
        """(N, n) recorded command [rad/s]."""
        return self.compared[self.label].then

    @property
    def now(self) -> np.ndarray:
        """(N, n) recomputed command [rad/s]; rows of NaN for refused samples."""
        return self.compared[self.label].now

    @property
    def identical(self) -> bool:
        """True if all compared signals are equal bit by bit."""
        return self.differs is None

    @property
    def differs(self) -> int | None:
        """First row that differs; None if there is none."""
        rows = [int(item.rows[0]) for item in self.compared.values() if item.rows.size]
        return min(rows, default=None)

    @property
    def summary(self) -> dict[str, Any]:
        """JSON data; ``largest_difference`` is that of the command."""
        first = self.differs
        return {
            "graph": self.name,
            "log": self.log,
            "signal": self.label,
            "samples": len(self.time),
            "identical": self.identical,
            "refused": self.refused,
            "first_difference": None if first is None else float(self.time[first]),
            "largest_difference": self.compared[self.label].largest,
            "compared": {
                label: {"identical": not item.rows.size, "largest_difference": item.largest, "unit": item.unit}
                for label, item in self.compared.items()
            },
            "engine": self.engines[1],
            "engine_of_record": self.engines[0],
            "notices": list(self.notices),
        }

    def __repr__(self) -> str:
        return f"<Replay of {self.log} with {self.name}: {'identical' if self.identical else 'different'}>"

    def __str__(self) -> str:
        commands = [label for label in (self.label, SENT) if label in self.compared]
        states = len(self.compared) - len(commands)
        engine = f" by the {self.engines[1]} engine" if self.engines[1] else ""
        other = f" (the record: {self.engines[0]})" if self.engines[0] not in ("", self.engines[1]) else ""
        what = [*commands, *([f"{states} state{'s' * (states > 1)} of the controller"] if states else [])]
        lines = [
            f"{self.name}: {listed(what)} of {len(self.time)} samples of {self.log}, recomputed{engine}{other}: "
            f"{'identical, bit by bit' if self.identical else 'different'}"
        ]
        lines += [line for label, item in self.compared.items() if item.rows.size for line in self._lines(label)]
        if self.refused:
            lines.append(f"  {self.refused} samples are refused")
        return "\n".join([*lines, *(f"{self.name}: notice: {notice}" for notice in self.notices)])

    def _lines(self, label: str) -> list[str]:
        """First and largest difference of a signal."""
        item = self.compared[label]
        first, difference = int(item.rows[0]), item.difference
        names = (
            self.joints
            if difference.shape[1] == len(self.joints)
            else tuple(map(str, range(1, difference.shape[1] + 1)))
        )
        place = int(np.argmax(item.then[first] != item.now[first]))
        row, most = (
            np.unravel_index(int(np.nanargmax(difference)), difference.shape)
            if np.isfinite(difference).any()
            else (first, 0)
        )
        return [
            f"  {label}: first difference at t = {plain(float(self.time[first]), 's')}, {names[place]}: "
            f"recorded {item.then[first, place]:.9g}, recomputed {item.now[first, place]:.9g} [{item.unit or '1'}]",
            f"  {label}: largest difference at t = {plain(float(self.time[row]), 's')}, {names[most]}: "
            f"{plain(float(difference[row, most]), item.unit)}",
        ]


def replayed(graph: BaseGraph, log: str | Path, *, engine: Choice = "auto") -> Replay:
    """Recompute the commands of a record from its measurements, through the same gate.

    Parameters
    ----------
    log
        Folder of a drive or of a run, or its ``signals.nc``. A run must have every sample.

    Raises
    ------
    MissingError
        There is no such file, a file of its folder was changed, or a measurement or a sample is missing.
    """
    diagram = graph.diagram
    scaled = scaled_controller(graph, engine)
    own, states = plain_signals(diagram), {item.label: item for item in diagram.loop.controller}
    known = ["robot.time", SENT, *_USUAL, *own, *states]
    fields = {**own, **scaled.fields}
    record = read_log(Path(log), [*scaled.fields, scaled.label], known, fields)
    notices = list(record.notices)
    expected = {**scaled.controller.measured, scaled.label: scaled.command}
    count = record.values["time"].size
    _check_sizes(record.values, expected, count, str(log))
    kept = [label for label in states if label in record.values]
    if lost := [label for label, item in states.items() if item.recorded and label not in record.values]:
        notices.append(f"{listed(lost)} {'are' if len(lost) > 1 else 'is'} not compared: not in the record")
    now, refused, notice = _computed(scaled, record, fields, kept, str(log))
    units = {scaled.label: "rad/s", SENT: "rad/s", **{label: item.unit for label, item in states.items()}}
    compared = {
        label: Compared(_rows(record.values[label], rows.shape, label, str(log)), rows, units[label])
        for label, rows in now.items()
    }
    n = scaled.command.size
    joints = tuple(map(str, range(1, n + 1)) if diagram.robot is None else diagram.robot.joint_names)
    return Replay(
        graph.name,
        str(log),
        scaled.label,
        joints,
        record.values["time"].ravel(),
        compared,
        refused,
        (record.engine, scaled.controller.engine),
        (*notices, *notice),
    )


def _computed(
    scaled: ScaledController, record: Log, fields: Mapping[str, str], states: list[str], log: str
) -> tuple[dict[str, np.ndarray], int, tuple[str, ...]]:
    """Recompute commands, commands after the gate, and states; with the number of refused samples, and notices."""
    time = record.values["time"].ravel()
    count, n = time.size, scaled.command.size
    scale, missed = (record.values.get(label, np.full(count, usual)).ravel() for label, usual in _USUAL.items())
    since = record.values.get("robot.time", time).ravel()
    _check_whole(since, missed, scaled.controller.clock, log)
    gate, ramp, notice = _gate(record, n, log)
    now = {scaled.label: np.full((count, n), np.nan)}
    if gate is not None:
        now[SENT] = np.full((count, n), np.nan)
    now |= {label: np.full((count, scaled.controller.states[label].size), np.nan) for label in states}
    sent, refused = np.zeros(n), 0
    for k in range(count):
        sample = _sample(record.values, fields, n, k, int(missed[k]))
        if k == 0:
            scaled.begin(sample, float(time[0]))
        for label in states:
            now[label][k] = scaled.controller.states[label]
        moving = bool(scale[k] >= STILL)
        if moving and not scaled.step(sample, float(time[k]), float(scale[k])):
            refused += 1
            continue
        now[scaled.label][k] = scaled.command
        if gate is not None:
            own = min(1.0, (float(since[k]) + gate.period) / ramp) if ramp else 1.0
            gate.admit(sample)
            gate.limited(own * scaled.command if moving else np.zeros(n), sent, int(missed[k]))
            now[SENT][k] = sent
    return now, refused, notice


def _gate(record: Log, n: int, log: str) -> tuple[Gate | None, float, tuple[str, ...]]:
    """Gate of the record, ramp time, and notices; no gate for a simulation, or without recorded limits or commands."""
    if SENT not in record.values:
        return None, 0.0, (f"{SENT} is not compared: not in the record",) if record.drive else ()
    if not record.drive:
        return None, 0.0, (f"{SENT} is not compared: the limits of the drive are not in the record",)
    try:
        limits, period = Limits.of(record.drive["limits"]), float(record.drive["period"])
        ramp = float(record.drive.get("ramp", 0))
    except (KeyError, TypeError, ValueError) as error:
        raise MissingError(f"expected the limits of the drive in the record: {error}", location=log) from None
    if limits.speed.shape != (n,) or record.values[SENT].shape[1:] != (n,):
        raise MissingError(f"{SENT}: expected {n} joints, as this controller has; the record has others", location=log)
    return Gate(limits, period), ramp, ()


def _check_sizes(values: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], count: int, log: str) -> None:
    """Check shapes: a record of another robot may have the same names."""
    if not count:
        raise MissingError("expected a record with samples, found none", location=log)
    for label, own in expected.items():
        if values[label].shape != (count, own.size):
            found = " x ".join(map(str, values[label].shape))
            raise MissingError(
                f"{label}: expected {count} x {own.size} numbers, as this controller has, found {found}; the record "
                "is of another robot",
                location=log,
            )


def _rows(values: np.ndarray, shape: tuple[int, ...], label: str, log: str) -> np.ndarray:
    """Flatten a recorded signal to rows, matrices in column-major order as in a controller's states."""
    flat = values.reshape(len(values), -1) if values.ndim < 3 else values.swapaxes(1, 2).reshape(len(values), -1)
    if flat.shape != shape:
        raise MissingError(
            f"{label}: expected {shape[1]} numbers a sample, found {flat.shape[1]}; the record is of another graph",
            location=log,
        )
    return np.ascontiguousarray(flat, dtype=float)


def _check_whole(time: np.ndarray, missed: np.ndarray, clock: float, log: str) -> None:
    """Check that no sample is missing: states advance with each sample."""
    if (wrong := np.flatnonzero(~((missed >= 0) & (missed < MOST_MISSED) & (missed == np.floor(missed))))).size:
        k = int(wrong[0])
        raise MissingError(f"expected a count of lost samples, found {missed[k]:g} in sample {k + 1}", location=log)
    steps = np.diff(time)
    odd = np.flatnonzero(~(np.abs(steps - clock * (1 + missed[1:])) <= PERIOD_DEVIATION * clock))
    if odd.size:
        k = int(odd[0])
        raise MissingError(
            f"expected a sample each {plain(clock, 's')}, the graph's clock, found {plain(float(steps[k]), 's')} "
            f"after t = {plain(float(time[k]), 's')}; the record has another clock, or log.every has decimated it",
            location=log,
        )


def _sample(values: Mapping[str, np.ndarray], fields: Mapping[str, str], n: int, k: int, missed: int) -> Sample:
    """Sample of the record; the controller's measurements, last in `fields`, precede the robot's other signals."""
    rows = {"q": np.zeros(n), "dq": np.zeros(n)}
    rows |= {name: values[label][k] for label, name in fields.items() if label in values}
    return Sample(float(values["time"][k]), rows["q"], rows["dq"], rows.get("q_c"), rows.get("x"), missed=missed)
