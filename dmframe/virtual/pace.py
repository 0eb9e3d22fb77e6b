"""A virtual robot in real time, as well as a common machine keeps it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot


def serve(robot: VirtualRobot, wanted: Callable[[], bool]) -> None:
    """Run as long as it is wanted.

    Where this machine is late by more than a cycle, the robot's clock waits, and `late` counts it: cycles that were
    made up for would come so close together that no client could answer them.
    """
    from time import monotonic

    due = monotonic()
    while wanted():
        due += robot.dt
        while (left := due - monotonic()) > 0:
            robot.wait(left)
        if left < -robot.dt:
            robot.late += 1
            due -= left
        robot.advance()


@contextmanager
def in_background(robot: VirtualRobot) -> Iterator[VirtualRobot]:
    """Run in a thread of its own, until the block ends; what fails there is raised then."""
    ended, faults = Event(), list[BaseException]()

    def run() -> None:
        try:
            serve(robot, lambda: not ended.is_set())
        except BaseException as fault:
            faults.append(fault)

    thread = Thread(target=run, name="virtual robot", daemon=True)
    thread.start()
    try:
        yield robot
    finally:
        ended.set()
        thread.join()
    if faults:
        raise faults[0]
