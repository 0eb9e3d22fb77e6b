"""Clock of a virtual robot: real time, as accurately as the operating system allows, or in step with its client."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

LOOK: Final = 0.1
"""Interval between two calls of `wanted` while the robot waits for a client [s]."""


def serve(robot: VirtualRobot, wanted: Callable[[], bool], patience: float = 0.0) -> None:
    """Run while `wanted()` is true.

    If the machine is more than a cycle late, the robot's clock pauses and `late` counts it. Catching up would put
    cycles so close together that no client could answer them.

    Parameters
    ----------
    patience
        Time for which the clock waits for a client's answer to a sample [s]. Time is then simulated while a client
        answers samples, and no sample is missed. After a longer silence the clock waits again when the client writes.
        0 for real time.
    """
    from time import monotonic

    due = monotonic()
    while wanted():
        if patience and robot.owing:
            if not _answered(robot, wanted, patience):
                return
            due = monotonic()
        else:
            due += robot.dt
            while (left := due - monotonic()) > 0:
                robot.wait(left)
            if left < -robot.dt:
                robot.late += 1
                due -= left
        robot.advance()


def _answered(robot: VirtualRobot, wanted: Callable[[], bool], patience: float) -> bool:
    """Wait until all clients have answered, or `patience` has passed; False if `wanted()` became false."""
    from time import monotonic

    until = monotonic() + patience
    while robot.owing and (left := until - monotonic()) > 0:
        robot.wait(min(left, LOOK))
        if not wanted():
            return False
    for client in robot.owing:
        client.excuse()
        robot.report(f"a client has not answered for {patience:g} s: the clock continues")
    return True


@contextmanager
def in_background(robot: VirtualRobot, patience: float = 0.0) -> Iterator[VirtualRobot]:
    """Run in a thread until the ``with`` block ends, and raise the thread's exception then."""
    ended, faults = Event(), list[BaseException]()

    def run() -> None:
        try:
            serve(robot, lambda: not ended.is_set(), patience)
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
