"""One graph on one robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.drive.identity import identity
from dmframe.drive.kept import refusal
from dmframe.drive.limits import own_limits
from dmframe.drive.record import drive_data, recording_of
from dmframe.drive.robots import Options, clock_of, kind_of, usual_payload
from dmframe.errors import DriveError
from dmframe.runtime.controller import Controller
from dmframe.runtime.driving import Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.journal import Spool
from dmframe.runtime.steered import Steered
from dmframe.simulate import Recording
from dmframe.simulate.engine import Choice
from dmframe.simulate.start import start_state

RAMP: Final = 1.0
"""For how long a real robot's first motion gathers speed, where nobody says otherwise [s]."""


def steered_controller(experiment: Experiment, diagram: Diagram, engine: Choice = "auto") -> Steered:
    """A graph's controller, ready for samples of a robot. Raises `DmframeError` for one that no robot can take."""
    return Steered(diagram, Controller(diagram, clock_of(experiment), start=experiment.start, engine=engine))


def driven(
    experiment: Experiment,
    diagram: Diagram,
    robot: str,
    *,
    until: float | None = None,
    limits: Limits | None = None,
    ramp: float | None = None,
    patience: float | None = None,
    payload: float | None = None,
    shadow: bool = False,
    rehearsed: bool = True,
    engine: Choice = "auto",
    asked: Callable[[], str] = lambda: "",
    record: Path | None = None,
) -> Recording:
    """Drive a robot with a graph's controller, and return what was recorded.

    Parameters
    ----------
    robot
        ``sim``, ``sim:2``: the graph's own, two samples late, ``ur:HOST``, or ``ur_rtde:HOST``.
    until
        Time of the reference [s]; the graph's duration without it.
    limits
        Without them, those of the robot's model.
    ramp
        For how long the first motion gathers speed [s]; none for a simulated robot, else a second.
    patience
        How long to wait for a sample of a real robot [s]; its driver's own without it.
    payload
        What the rehearsal must have tried at the tool [kg]; what a rehearsal tries by itself without it.
    rehearsed
        Require a passed rehearsal of exactly what is driven before a real robot moves.
    asked
        Called at each sample: what asks for a stop; empty for nothing.
    record
        A file to which samples are written while the robot moves, so that memory stays bounded; the signals of a long
        drive are thinned out then. Without it they are held in memory.

    Raises
    ------
    DriveError
        The graph cannot drive a robot, or a real one is not to be driven by it.
    LostError
        Nobody answers at the beginning, or not one sample came.
    """
    kind, rest = kind_of(robot)
    duration = experiment.file.duration if until is None else until
    held = limits or own_limits(diagram.robot)
    if kind.real and not shadow:
        _check_acceleration(held)
    steered = steered_controller(experiment, diagram, engine)  # all is compiled before the loop
    if kind.real and not shadow and rehearsed:  # of the controller that drives, not of files that may be others by now
        parts = identity(experiment, steered, held, usual_payload(diagram) if payload is None else payload)
        if why := refusal(experiment.name, parts, duration):
            raise DriveError(f"{experiment.name}: {why}")
    with SYMBOLIC:
        start = _start(experiment, diagram)
    driver = kind.make(
        rest, experiment, diagram, Options(duration, engine, max(held.deceleration, held.halt), patience)
    )
    plan = Plan(duration, start, RAMP * kind.real if ramp is None else ramp, shadow)
    gate = Gate(held, driver.period)
    about: dict[str, Any] = {"graph": experiment.name, "field_hash": diagram.fingerprint, "command": steered.label}
    about |= {"engine": steered.controller.engine, "drive": drive_data(robot, plan, gate)}
    found = drive(steered, driver, gate, plan, asked, None if record is None else Spool(record, about))
    recording = recording_of(
        diagram,
        steered,
        found,
        robot=robot,
        plan=plan,
        gate=gate,
        solver=experiment.solver,
        thinned=record is not None,
    )
    if recording is None:
        raise DriveError(f"{robot}: the robot was stopped before its first command: {found.stop}")
    return recording


def _check_acceleration(limits: Limits) -> None:
    if limits.acceleration is None or not np.isfinite(limits.acceleration).all():
        raise DriveError(
            "expected limits with an acceleration for a real robot, which its model does not state: --limits FILE with "
            "acceleration: 4 rad/s^2"
        )


def _start(experiment: Experiment, diagram: Diagram) -> np.ndarray | None:
    """Where the graph's robot begins: the state q of the plant."""
    column, first = start_state(diagram, experiment.start), 0
    own = {variable.label for variable in diagram.loop.plant}
    for variable in diagram.loop.variables:
        size = variable.symbol.numel()
        if variable.label in own and variable.name == "q":
            return np.asarray(column[first : first + size])
        first += size
    return None
