"""A record played again: the commands that a controller gives to what was measured then."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.drive.drive import steered_controller
from dmframe.errors import MissingError
from dmframe.runtime.driving import STILL
from dmframe.runtime.robot import Sample
from dmframe.runtime.steered import Steered
from dmframe.simulate.engine import Choice
from dmframe.units import plain

SIGNALS = "signals.nc"
APART: Final = 0.4
"""How far from a whole number of periods samples may be apart, in periods."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Replay:
    """What was commanded then, and what is now.

    Parameters
    ----------
    time
        (N,) of the controller [s].
    then, now
        (N, n) [rad/s]; rows of nan where a sample is refused now.
    refused
        Samples that the controller refuses now.
    """

    name: str
    log: str
    label: str
    joints: tuple[str, ...]
    time: np.ndarray
    then: np.ndarray
    now: np.ndarray
    refused: int

    @property
    def identical(self) -> bool:
        """True for the same bits."""
        return self.then.tobytes() == self.now.tobytes()

    @property
    def differs(self) -> int | None:
        """The first row with another command; None where there is none."""
        rows = np.flatnonzero(np.any(self.then != self.now, axis=1))
        return int(rows[0]) if rows.size else None

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data."""
        first, apart = self.differs, np.abs(self.now - self.then)
        return {
            "graph": self.name,
            "log": self.log,
            "signal": self.label,
            "samples": len(self.time),
            "identical": self.identical,
            "refused": self.refused,
            "first_difference": None if first is None else float(self.time[first]),
            "largest_difference": float(np.nanmax(apart, initial=0.0)),
        }

    def __repr__(self) -> str:
        return f"<Replay of {self.log} with {self.name}: {'identical' if self.identical else 'different'}>"

    def __str__(self) -> str:
        count, first = len(self.time), self.differs
        told = f"{self.name}: {self.label} of {count} samples of {self.log}"
        if first is None:
            return f"{told}: identical, bit by bit"
        apart = np.abs(self.now - self.then)
        row, joint = np.unravel_index(int(np.nanargmax(apart)), apart.shape) if np.isfinite(apart).any() else (first, 0)
        place = int(np.argmax(self.then[first] != self.now[first]))
        lines = [
            f"{told}: different",
            f"  first at t = {plain(float(self.time[first]), 's')}, {self.joints[place]}: "
            f"{self.then[first, place]:.9g} then, {self.now[first, place]:.9g} now [rad/s]",
            f"  most at t = {plain(float(self.time[row]), 's')}, {self.joints[joint]}: "
            f"{plain(float(apart[row, joint]), 'rad/s')} apart",
        ]
        if self.refused:
            lines.append(f"  {self.refused} samples are refused now")
        return "\n".join(lines)


def replayed(experiment: Experiment, diagram: Diagram, log: str | Path, *, engine: Choice = "auto") -> Replay:
    """Feed a controller with what a record has of measurements, as then.

    Parameters
    ----------
    log
        The folder of a drive or of a run, or its ``signals.nc``. Of a run it must hold every tick.

    Raises
    ------
    MissingError
        There is no such file, it is damaged, or it lacks what this controller measures, or samples.
    """
    steered = steered_controller(experiment, diagram, engine)
    held = _read(Path(log), [*steered.fields, steered.label])
    time, count = held["time"].ravel(), held["time"].size
    _check_sizes(held, {**steered.controller.measured, steered.label: steered.command}, count, str(log))
    scale, missed = (held.get(f"robot.{name}", np.full(count, usual)).ravel() for name, usual in _USUAL)
    _check_whole(held.get("robot.time", time).ravel(), missed, steered.controller.clock, str(log))
    then, now = held[steered.label], np.full((count, steered.command.size), np.nan)
    refused = 0
    for k in range(count):
        sample = _sample(steered, held, k, int(missed[k]))
        if k == 0:
            steered.begin(sample, float(time[0]))
        if scale[k] >= STILL and not steered.step(sample, float(time[k]), float(scale[k])):
            refused += 1
            continue
        now[k] = steered.command
    joints = (
        tuple(diagram.robot.joint_names) if diagram.robot is not None else tuple(map(str, range(1, now.shape[1] + 1)))
    )
    return Replay(experiment.name, str(log), steered.label, joints, time, np.ascontiguousarray(then), now, refused)


_USUAL = (("scale", 1.0), ("missed", 0.0))
"""Of a record without them, a simulation's."""


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


def _check_whole(time: np.ndarray, missed: np.ndarray, clock: float, log: str) -> None:
    """Between two samples each state goes on: without one of them the next commands are others, and say nothing."""
    steps = np.diff(time)
    odd = np.flatnonzero(~(np.abs(steps - clock * (1 + missed[1:])) <= APART * clock))
    if odd.size:
        k = int(odd[0])
        raise MissingError(
            f"expected a sample each {plain(clock, 's')}, the graph's clock, found {plain(float(steps[k]), 's')} "
            f"after t = {plain(float(time[k]), 's')}; it is of another clock, or a run that log.every has thinned out",
            location=log,
        )


def _sample(steered: Steered, held: Mapping[str, np.ndarray], k: int, missed: int) -> Sample:
    told = {name: held[label][k] for label, name in steered.fields.items()}
    n = steered.command.size
    return Sample(
        float(held["time"][k]),
        told.get("q", np.zeros(n)),
        told.get("dq", np.zeros(n)),
        told.get("q_c"),
        told.get("x"),
        missed=missed,
    )


def _read(path: Path, needed: list[str]) -> dict[str, np.ndarray]:
    import h5netcdf

    file = path / SIGNALS if path.is_dir() else path
    try:
        content = file.read_bytes()
    except OSError:
        raise MissingError(f"expected a folder of results, or its {SIGNALS}, found none", location=str(path)) from None
    try:
        with h5netcdf.File(io.BytesIO(content), "r") as opened:
            lacking = [name for name in ("time", *needed) if name not in opened.variables]
            if lacking:
                text = f"expected a record with {lacking[0]}, which this controller needs, found none"
                raise MissingError(text, location=str(file))
            beside = [
                name for name in ("robot.time", *(f"robot.{word}" for word, _ in _USUAL)) if name in opened.variables
            ]
            return {name: np.array(opened.variables[name][...]) for name in ("time", *needed, *beside)}
    except MissingError:
        raise
    except Exception:  # h5netcdf raises what it likes of a file that is none of its own
        raise MissingError("expected a record as dmframe writes it, found another file", location=str(file)) from None
