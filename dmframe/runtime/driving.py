"""The loop that drives a robot, one sample of the robot's own clock after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from dmframe.errors import DriveError, LostError
from dmframe.runtime.gate import Gate, Stop
from dmframe.runtime.journal import Journal, Spool
from dmframe.runtime.robot import Robot, Sample
from dmframe.runtime.steered import Steered

AT_START: Final = 1e-4
"""A robot this close to the pose in which it is to start is not moved there [rad]."""
STILL: Final = 0.01
"""A robot that is slowed down further than this stands: the controller waits."""
APPROACH: Final = 0.25
"""Speed of the way to the start [rad/s]."""


@final
@dataclass(frozen=True, eq=False)
class Plan:
    """What is to be done.

    Parameters
    ----------
    until
        Time of the reference at the end [s].
    start
        (n,) where to begin [rad]; None for where the robot is.
    ramp
        For how long the controller's time gathers speed after the start [s].
    shadow
        Compute, and send nothing.
    """

    until: float
    start: np.ndarray | None = None
    ramp: float = 0.0
    shadow: bool = False


@final
@dataclass(frozen=True, eq=False)
class Driven:
    """A drive that is over.

    Parameters
    ----------
    stop
        Why it ended before its time; None for one that came to its end.
    cuts
        How many commands each rule of the gate has cut.
    wall_time
        Of the loop [s].
    """

    journal: Journal
    stop: Stop | None
    cuts: Mapping[str, int]
    wall_time: float


def drive(
    steered: Steered, robot: Robot, gate: Gate, plan: Plan, asked: Callable[[], str], spool: Spool | None = None
) -> Driven:
    """Drive a robot until the plan's end, or until something is wrong; then it is brought to rest.

    Parameters
    ----------
    asked
        Called at each sample: what asks for a stop, ``Ctrl-C``; empty for nothing.
    spool
        Where samples are recorded; in memory without it.

    Raises
    ------
    DriveError
        The robot does not tell what the controller needs, or has another period.
    LostError
        Nobody answers at the beginning.
    """
    journal, begun, limits = Journal(spool), time.perf_counter(), gate.limits
    halt = max(limits.deceleration, limits.halt)
    with closing(journal), closing(robot):  # the robot comes to rest first
        robot.connect()
        stop: Stop | None
        try:
            stop = _run(steered, robot, gate, plan, asked, journal)
        except LostError as fault:
            stop = Stop("lost link", fault.text)
        except KeyboardInterrupt:
            stop = Stop("asked", "Ctrl-C")
        except BaseException:
            if not plan.shadow:
                with suppress(LostError):  # what was raised first is what is told
                    robot.stop(halt)
            raise
        if not plan.shadow:
            try:
                robot.stop(limits.deceleration if stop is None or stop.rule == "asked" else halt)
            except LostError as fault:
                told = f"{stop}; " if stop is not None else ""
                stop = Stop("lost link", f"{told}it could not be told to stop: {fault.text}")
    return Driven(journal, stop, dict(gate.cuts), time.perf_counter() - begun)


def _run(
    steered: Steered, robot: Robot, gate: Gate, plan: Plan, asked: Callable[[], str], journal: Journal
) -> Stop | None:
    sample = robot.read()
    _check(steered, robot, sample)
    if stop := gate.admit(sample):
        return stop
    if stop := gate.begins(sample.q if plan.start is None else plan.start):
        return stop
    if plan.start is not None and np.max(np.abs(sample.q - plan.start)) > AT_START:
        if plan.shadow:
            return Stop("start", "the robot is not where the graph starts, and in shadow nothing moves it there")
        if stop := _way(robot, gate, plan.start, asked):
            return stop
        sample = robot.read()
        if stop := gate.admit(sample):
            return stop
        if (apart := float(np.max(np.abs(sample.q - plan.start)))) > gate.limits.deviation:
            return Stop("start", f"the robot ended its way to the start {apart:.3g} rad from it")
    if not plan.shadow:
        robot.begin()
        sample = robot.read()
        if stop := gate.admit(sample):
            return stop
    steered.begin(sample)
    return _loop(steered, robot, gate, plan, asked, journal, sample)


def _way(robot: Robot, gate: Gate, start: np.ndarray, asked: Callable[[], str]) -> Stop | None:
    """To the start, under the rules of the gate for samples; None, or why it ended on the way."""
    if text := asked():  # before anything moves, too
        return Stop("asked", text)
    found = list[Stop]()

    def watched(sample: Sample) -> bool:
        # the robot finds its way by itself: a sample that is lost loses no command
        ended = Stop("asked", text) if (text := asked()) else gate.admit(replace(sample, missed=0))
        found.extend([ended] if ended else [])
        return bool(found)

    robot.move(start, APPROACH, gate.limits.deceleration / 2, watched)
    return found[0] if found else None


def _loop(
    steered: Steered, robot: Robot, gate: Gate, plan: Plan, asked: Callable[[], str], journal: Journal, sample: Sample
) -> Stop | None:
    T, first, behind = robot.period, sample.time, 0.0
    sent = np.zeros(steered.command.size)
    while True:
        arrived = time.perf_counter()
        if text := asked():
            return Stop("asked", text)
        if journal.fault:
            return Stop("record", journal.fault)
        since = sample.time - first
        own = min(1.0, (since + T) / plan.ramp) if plan.ramp else 1.0
        scale, reference = own * sample.scaling, since - behind
        journal.begin(sample, steered, since, reference, scale if scale >= STILL else 0.0)
        moving = scale >= STILL
        if moving and not steered.step(sample, reference, scale):
            return Stop("controller", "from a sample followed what is not finite")
        wanted = own * steered.command if moving else np.zeros(sent.size)
        stop = gate.limited(wanted, sent, sample.missed)
        journal.commanded(steered.command, sent)
        if stop:
            return stop
        if reference >= plan.until - T * scale / 2:
            return None
        if not plan.shadow:
            robot.command(sent)
        journal.answered(time.perf_counter() - arrived)
        before, sample = sample, robot.read()
        lost = int(sample.time <= before.time)  # the same one again, or an older
        while 0 < lost <= gate.limits.lost and sample.time <= before.time:
            sample = robot.read()
            lost = lost + 1 if sample.time <= before.time else 0
        if lost > gate.limits.lost:
            return Stop("lost samples", f"its clock stands at {before.time:g} s")
        if stop := gate.admit(sample):
            return stop
        behind += (1.0 - (scale if moving else 0.0)) * (sample.time - before.time)


def _check(steered: Steered, robot: Robot, sample: Sample) -> None:
    clock = steered.controller.clock
    if abs(robot.period - clock) > 1e-9:
        raise DriveError(
            f"{robot.name}: expected a robot with the graph's clock of {clock:g} s, found one with {robot.period:g} s"
        )
    lacking = [name for name in steered.lacking if getattr(sample, name) is None]
    if lacking:
        raise DriveError(f"{robot.name}: the controller needs {' and '.join(lacking)}, which this robot does not tell")
    n = steered.command.size
    if sample.q.size != n:
        raise DriveError(f"{robot.name}: expected a robot with {n} joints, as the graph's, found {sample.q.size}")
