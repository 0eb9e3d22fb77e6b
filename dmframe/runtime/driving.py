"""Control loop of a robot, synchronised with the robot's samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from dmframe.common.errors import DriveError, LostError
from dmframe.runtime.gate import Gate, Stop
from dmframe.runtime.journal import Journal, Spool
from dmframe.runtime.robot import Robot, Sample
from dmframe.runtime.scaled import ScaledController

AT_START: Final = 1e-4
"""Distance from the start pose below which the robot is not moved there [rad]."""
STILL: Final = 0.01
"""Speed scaling below which the controller waits."""
APPROACH: Final = 0.25
"""Speed of the motion to the start [rad/s]."""


@final
@dataclass(frozen=True, eq=False)
class Plan:
    """Options of a drive.

    Parameters
    ----------
    until
        Reference time at the end [s].
    start
        (n,) start pose [rad]; None for the present pose.
    ramp
        Time in which the controller's time accelerates to full speed [s].
    shadow
        Compute commands without sending them.
    """

    until: float
    start: np.ndarray | None = None
    ramp: float = 0.0
    shadow: bool = False


@final
@dataclass(frozen=True, eq=False)
class DriveResult:
    """Result of a drive.

    Parameters
    ----------
    stop
        Reason of an early end; None if the drive was completed.
    cuts
        Number of commands that each rule of the gate limited.
    wall_time
        Duration of the loop [s].
    """

    journal: Journal
    stop: Stop | None
    cuts: Mapping[str, int]
    wall_time: float


def drive(
    scaled: ScaledController,
    robot: Robot,
    gate: Gate,
    plan: Plan,
    stop_requested: Callable[[], str],
    spool: Spool | None = None,
) -> DriveResult:
    """Drive a robot until the plan's end or a fault, then bring it to rest.

    Parameters
    ----------
    stop_requested
        Called at each sample; returns the source of a stop request, such as ``Ctrl-C``, or an empty text.
    spool
        File that records the samples; without it they are stored in memory.

    Raises
    ------
    DriveError
        The robot does not measure what the controller needs, or has another period.
    LostError
        The robot does not answer at the beginning.
    """
    journal, started, limits = Journal(spool), time.perf_counter(), gate.limits
    halt = max(limits.deceleration, limits.halt)
    with closing(journal), closing(robot):  # the robot comes to rest first
        robot.connect()
        stop: Stop | None
        try:
            stop = _run(scaled, robot, gate, plan, stop_requested, journal)
        except LostError as fault:
            stop = Stop("lost link", fault.text)
        except KeyboardInterrupt:
            stop = Stop("requested", "Ctrl-C")
        except BaseException:
            if not plan.shadow:
                with suppress(LostError):  # report the first exception
                    robot.stop(halt)
            raise
        if not plan.shadow:
            try:
                robot.stop(limits.deceleration if stop is None or stop.rule == "requested" else halt)
            except LostError as fault:
                before = f"{stop}; " if stop is not None else ""
                stop = Stop("lost link", f"{before}the stop command was not sent: {fault.text}")
    return DriveResult(journal, stop, dict(gate.cuts), time.perf_counter() - started)


def _run(
    scaled: ScaledController, robot: Robot, gate: Gate, plan: Plan, stop_requested: Callable[[], str], journal: Journal
) -> Stop | None:
    sample = robot.read()
    _check(scaled, robot, sample)
    if stop := gate.admit(sample):
        return stop
    if stop := gate.begins(sample.q if plan.start is None else plan.start):
        return stop
    if plan.start is not None and np.max(np.abs(sample.q - plan.start)) > AT_START:
        if plan.shadow:
            return Stop("start", "the robot is not at the graph's start pose, and a shadow drive does not move it")
        if stop := _move_to_start(robot, gate, plan.start, stop_requested):
            return stop
        sample = robot.read()
        if stop := gate.admit(sample):
            return stop
        if (distance := float(np.max(np.abs(sample.q - plan.start)))) > gate.limits.deviation:
            return Stop("start", f"the robot is {distance:.3g} rad from the start pose after its motion to it")
    if not plan.shadow:
        robot.begin()
        sample = robot.read()
        if stop := gate.admit(sample):
            return stop
    scaled.begin(sample)
    return _loop(scaled, robot, gate, plan, stop_requested, journal, sample)


def _move_to_start(robot: Robot, gate: Gate, start: np.ndarray, stop_requested: Callable[[], str]) -> Stop | None:
    """Move to the start, with the gate's checks of samples; return why the motion was stopped, or None."""
    if text := stop_requested():  # also before the motion
        return Stop("requested", text)
    found = list[Stop]()

    def watched(sample: Sample) -> bool:
        # the robot interpolates by itself: a lost sample does not lose a command
        ended = Stop("requested", text) if (text := stop_requested()) else gate.admit(replace(sample, missed=0))
        found.extend([ended] if ended else [])
        return bool(found)

    robot.move(start, APPROACH, gate.limits.deceleration / 2, watched)
    return found[0] if found else None


def _loop(
    scaled: ScaledController,
    robot: Robot,
    gate: Gate,
    plan: Plan,
    stop_requested: Callable[[], str],
    journal: Journal,
    sample: Sample,
) -> Stop | None:
    T, first, behind = robot.period, sample.time, 0.0
    sent = np.zeros(scaled.command.size)
    while True:
        arrived = time.perf_counter()
        if text := stop_requested():
            return Stop("requested", text)
        if journal.fault:
            return Stop("record", journal.fault)
        since = sample.time - first
        own = min(1.0, (since + T) / plan.ramp) if plan.ramp else 1.0
        scale, reference = own * sample.scaling, since - behind
        journal.begin(sample, scaled, since, reference, scale if scale >= STILL else 0.0)
        moving = scale >= STILL
        if moving and not scaled.step(sample, reference, scale):
            return Stop("controller", "a command or a state is not finite")
        wanted = own * scaled.command if moving else np.zeros(sent.size)
        stop = gate.limited(wanted, sent, sample.missed)
        journal.commanded(scaled.command, sent)
        if stop:
            return stop
        if reference >= plan.until - T * scale / 2:
            return None
        if not plan.shadow:
            robot.command(sent)
        journal.answered(time.perf_counter() - arrived)
        before, sample = sample, robot.read()
        lost = int(sample.time <= before.time)  # a repeated or older sample
        while 0 < lost <= gate.limits.lost and sample.time <= before.time:
            sample = robot.read()
            lost = lost + 1 if sample.time <= before.time else 0
        if lost > gate.limits.lost:
            return Stop("lost samples", f"the robot's clock does not advance beyond {before.time:g} s")
        if stop := gate.admit(sample):
            return stop
        behind += (1.0 - (scale if moving else 0.0)) * (sample.time - before.time)


def _check(scaled: ScaledController, robot: Robot, sample: Sample) -> None:
    clock = scaled.controller.clock
    if abs(robot.period - clock) > 1e-9:
        raise DriveError(
            f"{robot.name}: expected a robot with the graph's clock of {clock:g} s, found one with {robot.period:g} s"
        )
    lacking = [name for name in scaled.lacking if getattr(sample, name) is None]
    if lacking:
        raise DriveError(f"{robot.name}: the controller needs {' and '.join(lacking)}, which this robot lacks")
    n = scaled.command.size
    if sample.q.size != n:
        raise DriveError(f"{robot.name}: expected {n} joints as in the graph, found {sample.q.size}")
