"""``dmframe robot``: serve a virtual closed robot on ports of this machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dmframe.cli.options import whole
from dmframe.cli.streams import tell
from dmframe.common.errors import ValueFault

if TYPE_CHECKING:
    from dmframe.graph.graph import Graph
    from dmframe.virtual import VirtualRobot


def ports_of(pairs: Sequence[str]) -> dict[str, int]:
    """Parse ports such as ``rtde=30004``; raises `ValueFault`."""
    from dmframe.virtual.server import NAMES

    found = dict[str, int]()
    for pair in pairs:
        name, equals, number = (word.strip() for word in pair.partition("="))
        if not equals or name not in NAMES:
            raise ValueFault(f"--port {pair}: expected NAME=NUMBER, NAME one of {', '.join(NAMES)}")
        found[name] = whole("--port", number)
    return found


def serve(
    graph: Graph, host: str, ports: dict[str, int], until: float | None, patience: float, **behaviour: Any
) -> None:
    """Open the ports and run the robot, printing its messages."""
    from dmframe.virtual import Ports

    with graph.virtual_robot(**behaviour) as robot:
        opened = robot.listen(host, Ports(**ports))
        listed = ", ".join(f"{name} {number}" for name, number in vars(opened).items())
        tell(f"{graph.name}: a virtual {robot.arm.name} at {host}, {1 / robot.dt:g} cycles a second; {listed}")
        tell("no hardware: its documentation lists what is not emulated; Ctrl-C stops it")
        printer = _Printer(robot)
        robot.serve(lambda: printer.continues(until), patience)


class _Printer:
    """Prints new messages of the robot."""

    def __init__(self, robot: VirtualRobot) -> None:
        self._robot, self._seen = robot, 0

    def continues(self, until: float | None) -> bool:
        """Print new messages; returns False at the end time."""
        robot = self._robot
        fresh = robot.message_count - self._seen
        if fresh:
            for text in list(robot.messages)[-fresh:]:
                tell(text)
            self._seen = robot.message_count
        return until is None or robot.time < until - 0.5 * robot.dt
