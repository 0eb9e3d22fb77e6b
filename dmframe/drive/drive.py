"""Drive of one robot by one graph."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import DriveError
from dmframe.config import BaseGraph
from dmframe.diagram.pieces import rows_of
from dmframe.drive.identity import identity
from dmframe.drive.limits import own_limits
from dmframe.drive.record import drive_data, recording_of
from dmframe.drive.records import refusal
from dmframe.drive.robots import Options, clock_of, kind_of, usual_payload
from dmframe.runtime.controller import Controller
from dmframe.runtime.driving import Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.journal import Spool
from dmframe.runtime.scaled import ScaledController
from dmframe.simulate import Recording
from dmframe.simulate.engine import Choice
from dmframe.simulate.start import start_state

RAMP: Final = 1.0
"""Default time in which a real robot's first motion accelerates to full speed [s]."""


def scaled_controller(graph: BaseGraph, engine: Choice = "auto") -> ScaledController:
    """Controller of a graph on a robot's samples. Raises `DmframeError` if no robot can execute it."""
    return ScaledController(graph.diagram, Controller(graph.diagram, clock_of(graph), start=graph.start, engine=engine))


def run_on_robot(
    graph: BaseGraph,
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
    stop_requested: Callable[[], str] = lambda: "",
    record: Path | None = None,
) -> Recording:
    """Drive a robot with a graph's controller, and return the recording.

    Parameters
    ----------
    robot
        ``sim`` for the graph's own robot, ``sim:2`` for a delay of two samples, ``ur:HOST``, or ``ur_rtde:HOST``.
    until
        Reference time of the end [s]; the graph's duration by default.
    limits
        Limits of the gate; those of the robot's model by default.
    ramp
        Time in which the first motion accelerates [s]; by default 0 for a simulated robot, else `RAMP`.
    patience
        Timeout of a real robot's sample [s]; the driver's default without it.
    payload
        Payload of the required rehearsal [kg]; the default payload of a rehearsal without it.
    rehearsed
        Require a passed rehearsal of exactly this graph before a real robot moves.
    stop_requested
        Called at each sample; returns the source of a stop request, or an empty text.
    record
        File to which samples are written during the drive, so that memory stays bounded; the recording of a long drive
        is then decimated. Without it, samples are stored in memory.

    Raises
    ------
    DriveError
        The graph cannot drive a robot, or it must not drive this one.
    LostError
        The robot does not answer at the beginning, or sends no sample.
    """
    diagram = graph.diagram
    kind, rest = kind_of(robot)
    duration = graph.file.duration if until is None else until
    limits, ramp = limits or own_limits(diagram.robot), RAMP * kind.real if ramp is None else ramp
    if kind.real and not shadow:
        _check_acceleration(limits)
    scaled = scaled_controller(graph, engine)  # compile before the loop
    if kind.real and not shadow and rehearsed:  # identity of the loaded controller: files may have changed since
        load = usual_payload(diagram) if payload is None else payload
        parts = identity(graph, scaled, limits, payload=load, ramp=ramp, patience=patience)
        if why := refusal(graph.name, parts, duration):
            raise DriveError(f"{graph.name}: {why}")
    with SYMBOLIC:
        start = start_angles(graph)
    options = Options(duration, engine, max(limits.deceleration, limits.halt), patience)
    driver = kind.make(rest, graph, options)
    plan = Plan(duration, start, ramp, shadow)
    gate = Gate(limits, driver.period)
    about: dict[str, Any] = {"graph": graph.name, "field_hash": diagram.fingerprint, "command": scaled.label}
    about |= {"engine": scaled.controller.engine, "drive": drive_data(robot, plan, gate)}
    found = drive(scaled, driver, gate, plan, stop_requested, None if record is None else Spool(record, about))
    recording = recording_of(
        diagram,
        scaled,
        found,
        robot=robot,
        plan=plan,
        gate=gate,
        solver=graph.solver.automatic,
        thinned=record is not None,
    )
    if recording is None:
        raise DriveError(f"{robot}: the robot was stopped before its first command: {found.stop}")
    return recording


def _check_acceleration(limits: Limits) -> None:
    if limits.acceleration is None or not np.isfinite(limits.acceleration).all():
        raise DriveError(
            "expected an acceleration limit for a real robot, which its model does not have: --limits FILE with "
            "acceleration: 4 rad/s^2"
        )


def start_angles(graph: BaseGraph) -> np.ndarray | None:
    """Initial joint angles of the graph's plant."""
    column, loop = start_state(graph.diagram, graph.start), graph.diagram.loop
    own = {variable.label for variable in loop.plant}
    places = (rows for variable, rows in rows_of(loop.variables) if variable.label in own and variable.name == "q")
    return next((np.asarray(column[rows]) for rows in places), None)
