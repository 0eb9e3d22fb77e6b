"""A record played again: the commands are computed anew from what was measured then, and compared bit by bit.

What the controller commands, what the gate lets through and the recorded states of the controller are computed; the
measurements are the input, and all other signals of the record are not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.drive.drive import steered_controller
from dmframe.drive.log import Log, read_log
from dmframe.drive.record import plain_signals
from dmframe.errors import MissingError, listed
from dmframe.runtime.driving import STILL
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.robot import Sample
from dmframe.runtime.steered import Steered
from dmframe.simulate.engine import Choice
from dmframe.units import plain

APART: Final = 0.4
"""How far from a whole number of periods samples may be apart, in periods."""
MOST_MISSED: Final = 2**31
"""Samples that can be lost in a row; a record with more of them is damaged."""
SENT: Final = "robot.sent"
_USUAL: Final = {"robot.scale": 1.0, "robot.missed": 0.0}
"""Of a record without them, a simulation's."""


@final
@dataclass(frozen=True, eq=False)
class Compared:
    """A signal as it was recorded and as it is computed now, (N, n) each; rows of nan where none is computed."""

    then: np.ndarray
    now: np.ndarray
    unit: str

    @property
    def rows(self) -> np.ndarray:
        """Those that have other bits."""
        then, now = (np.ascontiguousarray(part, dtype=float).view(np.int64) for part in (self.then, self.now))
        return np.flatnonzero(np.any(then != now, axis=1))

    @property
    def largest(self) -> float:
        """The largest difference."""
        return float(np.nanmax(self.apart, initial=0.0))

    @property
    def apart(self) -> np.ndarray:
        """How far the numbers are apart; nan for two infinite ones."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(np.abs(self.now - self.then))


@final
@dataclass(frozen=True, repr=False, eq=False)
class Replay:
    """What was commanded then, and what is now.

    Parameters
    ----------
    label
        Of the controller's command, the velocities of the joints.
    time
        (N,) of the controller [s].
    compared
        By label: the command, what the gate let through, and the controller's states.
    refused
        Samples that the controller refuses now.
    engines
        What computed the record, and what computes now.
    notices
        What keeps the comparison from being whole.
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
        """(N, n) the recorded command [rad/s]."""
        return self.compared[self.label].then

    @property
    def now(self) -> np.ndarray:
        """(N, n) the command as it is computed now [rad/s]; rows of nan where a sample is refused."""
        return self.compared[self.label].now

    @property
    def identical(self) -> bool:
        """True for the same bits of all that is compared."""
        return self.differs is None

    @property
    def differs(self) -> int | None:
        """The first row with another number; None where there is none."""
        rows = [int(item.rows[0]) for item in self.compared.values() if item.rows.size]
        return min(rows, default=None)

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data; ``largest_difference`` is that of the command."""
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
        told = (
            f"{self.name}: {listed(what)} of {len(self.time)} samples of {self.log}, computed again{engine}{other}: "
            f"{'identical, bit by bit' if self.identical else 'different'}"
        )
        lines = [
            told,
            *(line for label, item in self.compared.items() if item.rows.size for line in self._lines(label)),
        ]
        if self.refused:
            lines.append(f"  {self.refused} samples are refused now")
        return "\n".join([*lines, *(f"{self.name}: notice: {notice}" for notice in self.notices)])

    def _lines(self, label: str) -> list[str]:
        """Where a signal is another first, and where most."""
        item = self.compared[label]
        first, apart = int(item.rows[0]), item.apart
        names = self.joints if apart.shape[1] == len(self.joints) else tuple(map(str, range(1, apart.shape[1] + 1)))
        place = int(np.argmax(item.then[first] != item.now[first]))
        row, most = np.unravel_index(int(np.nanargmax(apart)), apart.shape) if np.isfinite(apart).any() else (first, 0)
        return [
            f"  {label}: first at t = {plain(float(self.time[first]), 's')}, {names[place]}: "
            f"{item.then[first, place]:.9g} then, {item.now[first, place]:.9g} now [{item.unit or '1'}]",
            f"  {label}: most at t = {plain(float(self.time[row]), 's')}, {names[most]}: "
            f"{plain(float(apart[row, most]), item.unit)} apart",
        ]


def replayed(experiment: Experiment, diagram: Diagram, log: str | Path, *, engine: Choice = "auto") -> Replay:
    """Feed a controller with what a record has of measurements, as then, and its commands to the gate.

    Parameters
    ----------
    log
        The folder of a drive or of a run, or its ``signals.nc``. Of a run it must hold every tick.

    Raises
    ------
    MissingError
        There is no such file, it or a file of its folder is not what was written, or it lacks what this controller
        measures, or samples.
    """
    steered = steered_controller(experiment, diagram, engine)
    own, states = plain_signals(diagram), {item.label: item for item in diagram.loop.controller}
    known = ["robot.time", SENT, *_USUAL, *own, *states]
    fields = {**own, **steered.fields}
    held = read_log(Path(log), [*steered.fields, steered.label], known, fields)
    notices = list(held.notices)
    expected = {**steered.controller.measured, steered.label: steered.command}
    count = held.values["time"].size
    _check_sizes(held.values, expected, count, str(log))
    kept = [label for label in states if label in held.values]
    if lost := [label for label, item in states.items() if item.recorded and label not in held.values]:
        notices.append(f"{listed(lost)} {'are' if len(lost) > 1 else 'is'} not compared: not in the record")
    now, refused, notice = _computed(steered, held, fields, kept, str(log))
    units = {steered.label: "rad/s", SENT: "rad/s", **{label: item.unit for label, item in states.items()}}
    compared = {
        label: Compared(_rows(held.values[label], rows.shape, label, str(log)), rows, units[label])
        for label, rows in now.items()
    }
    joints = (
        tuple(diagram.robot.joint_names)
        if diagram.robot is not None
        else tuple(map(str, range(1, steered.command.size + 1)))
    )
    return Replay(
        experiment.name,
        str(log),
        steered.label,
        joints,
        held.values["time"].ravel(),
        compared,
        refused,
        (held.engine, steered.controller.engine),
        (*notices, *notice),
    )


def _computed(
    steered: Steered, held: Log, fields: Mapping[str, str], states: list[str], log: str
) -> tuple[dict[str, np.ndarray], int, tuple[str, ...]]:
    """Commands, what the gate lets through, and states; how many samples are refused; and notices."""
    time = held.values["time"].ravel()
    count, n = time.size, steered.command.size
    scale, missed = (held.values.get(label, np.full(count, usual)).ravel() for label, usual in _USUAL.items())
    since = held.values.get("robot.time", time).ravel()
    _check_whole(since, missed, steered.controller.clock, log)
    gate, ramp, notice = _gate(held, n, log)
    now = {steered.label: np.full((count, n), np.nan)}
    if gate is not None:
        now[SENT] = np.full((count, n), np.nan)
    now |= {label: np.full((count, steered.controller.states[label].size), np.nan) for label in states}
    sent, refused = np.zeros(n), 0
    for k in range(count):
        sample = _sample(held.values, fields, n, k, int(missed[k]))
        if k == 0:
            steered.begin(sample, float(time[0]))
        for label in states:
            now[label][k] = steered.controller.states[label]
        moving = bool(scale[k] >= STILL)
        if moving and not steered.step(sample, float(time[k]), float(scale[k])):
            refused += 1
            continue
        now[steered.label][k] = steered.command
        if gate is not None:
            own = min(1.0, (float(since[k]) + gate.period) / ramp) if ramp else 1.0
            gate.admit(sample)
            gate.limited(own * steered.command if moving else np.zeros(n), sent, int(missed[k]))
            now[SENT][k] = sent
    return now, refused, notice


def _gate(held: Log, n: int, log: str) -> tuple[Gate | None, float, tuple[str, ...]]:
    """The gate of then and how long it gathered speed; no gate for a simulation, and with a notice for a drive whose
    limits, or what was sent, are not recorded.
    """
    if SENT not in held.values:
        return None, 0.0, (f"{SENT} is not compared: the record does not hold it",) if held.drive else ()
    if not held.drive:
        return None, 0.0, (f"{SENT} is not compared: the record does not hold the limits of its drive",)
    try:
        limits, period = Limits.of(held.drive["limits"]), float(held.drive["period"])
        ramp = float(held.drive.get("ramp", 0))
    except (KeyError, TypeError, ValueError) as error:
        raise MissingError(f"expected the limits of the drive in the record: {error}", location=log) from None
    if limits.speed.shape != (n,) or held.values[SENT].shape[1:] != (n,):
        raise MissingError(f"{SENT}: expected {n} joints, as this controller has; the record has others", location=log)
    return Gate(limits, period), ramp, ()


def _check_sizes(held: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], count: int, log: str) -> None:
    """A record of another robot may have the same names."""
    if not count:
        raise MissingError("expected a record with samples, found none", location=log)
    for label, values in expected.items():
        if held[label].shape != (count, values.size):
            found = " x ".join(map(str, held[label].shape))
            raise MissingError(
                f"{label}: expected {count} x {values.size} numbers, as this controller has, found {found}; it is a "
                "record of another robot",
                location=log,
            )


def _rows(values: np.ndarray, shape: tuple[int, ...], label: str, log: str) -> np.ndarray:
    """A recorded signal row by row, a matrix column by column, as a controller has its states."""
    flat = values.reshape(len(values), -1) if values.ndim < 3 else values.swapaxes(1, 2).reshape(len(values), -1)
    if flat.shape != shape:
        raise MissingError(
            f"{label}: expected {shape[1]} numbers a sample, found {flat.shape[1]}; it is a record of another graph",
            location=log,
        )
    return np.ascontiguousarray(flat, dtype=float)


def _check_whole(time: np.ndarray, missed: np.ndarray, clock: float, log: str) -> None:
    """Between two samples each state goes on: without one of them the next commands are others, and say nothing."""
    if (wrong := np.flatnonzero(~((missed >= 0) & (missed < MOST_MISSED) & (missed == np.floor(missed))))).size:
        k = int(wrong[0])
        raise MissingError(f"expected a count of lost samples, found {missed[k]:g} in sample {k + 1}", location=log)
    steps = np.diff(time)
    odd = np.flatnonzero(~(np.abs(steps - clock * (1 + missed[1:])) <= APART * clock))
    if odd.size:
        k = int(odd[0])
        raise MissingError(
            f"expected a sample each {plain(clock, 's')}, the graph's clock, found {plain(float(steps[k]), 's')} "
            f"after t = {plain(float(time[k]), 's')}; it is of another clock, or a run that log.every has thinned out",
            location=log,
        )


def _sample(held: Mapping[str, np.ndarray], fields: Mapping[str, str], n: int, k: int, missed: int) -> Sample:
    """What the robot showed: what the controller measures goes before what the robot tells beside it."""
    told = {name: held[label][k] for label, name in fields.items() if label in held}
    return Sample(
        float(held["time"][k]),
        told.get("q", np.zeros(n)),
        told.get("dq", np.zeros(n)),
        told.get("q_c"),
        told.get("x"),
        missed=missed,
    )
