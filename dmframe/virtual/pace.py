"""A virtual robot in real time, as well as a common machine keeps it, or in step with its client."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

LOOK: Final = 0.1
"""How often it is asked, while a client is waited for, whether to go on [s]."""


def serve(robot: VirtualRobot, wanted: Callable[[], bool], patience: float = 0.0) -> None:
    """Run as long as it is wanted.

    Where this machine is late by more than a cycle, the robot's clock waits, and `late` counts it: cycles that were
    made up for would come so close together that no client could answer them.

    Parameters
    ----------
    patience
        How long the clock waits for a client's answer to a sample [s]. With it time is simulated while a client
        answers samples: no sample is missed, however slow both are. A client that is silent for longer is not waited
        for any more, until it writes again. 0 for real time.
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
    """Wait until nobody owes an answer, or has let us wait for too long; False where that is not wanted any more."""
    from time import monotonic

    until = monotonic() + patience
    while robot.owing and (left := until - monotonic()) > 0:
        robot.wait(min(left, LOOK))
        if not wanted():
            return False
    for client in robot.owing:
        client.excuse()
        robot.tell(f"a client has not answered for {patience:g} s: the clock goes on")
    return True


@contextmanager
def in_background(robot: VirtualRobot, patience: float = 0.0) -> Iterator[VirtualRobot]:
    """Run in a thread of its own, until the block ends; what fails there is raised then."""
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
