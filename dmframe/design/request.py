"""Request for a design: a robot, a task and what is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final, get_args

from dmframe.common.errors import MissingError, ValueFault
from dmframe.common.files import expanded
from dmframe.common.units import seconds, to_unit

Task = Literal["joints", "position", "pose"]
TASKS: Final = get_args(Task)
CLOCK: Final = 0.008
"""Default sampling period [s]."""
SHORTEST, LONGEST = 0.002, 0.1
"""Sampling periods to which the laws apply [s]."""


@final
@dataclass(frozen=True)
class Request:
    """A robot, a task and what is known.

    Parameters
    ----------
    robot
        Name of a packaged robot, or a URDF, xacro or MJCF file.
    task
        What follows the path: the joints, the position or the pose of the tool; None for what the path is of, or the
        joints.
    path
        CSV file or ROS ``JointTrajectory`` with the path; see `read_path`. None for paths about a posture far from
        singularities and limits.
    clock
        Sampling period [s]; None for that of the log, or `CLOCK`.
    payload
        Largest mass at the tool [kg]; None for a twentieth of the moving mass.
    log
        Log of the robot, from which servo, delay and friction are identified.
    tool, hold
        As in `first_graph`.
    """

    robot: str
    task: Task | None = None
    clock: float | None = None
    payload: float | None = None
    log: str | None = None
    tool: str | None = None
    hold: tuple[tuple[str, float], ...] = ()
    path: str | None = None

    @classmethod
    def of(
        cls,
        robot: str,
        *,
        task: str | None = None,
        clock: str | float | None = None,
        payload: str | float | None = None,
        log: str | None = None,
        tool: str | None = None,
        hold: tuple[tuple[str, float], ...] = (),
        path: str | None = None,
    ) -> Request:
        """A checked request.

        Raises
        ------
        MissingError, ValueFault
            A value is invalid, or a file does not exist.
        """
        if task is not None and task not in TASKS:
            raise ValueFault(f"task: expected {', '.join(TASKS)}, found {task}")
        period = None if clock is None else seconds("clock", clock)
        if period is not None and not SHORTEST <= period <= LONGEST:
            raise ValueFault(f"clock: expected a period from 2 ms to 100 ms, found {1000 * period:g} ms")
        for what, name in (("path", path), ("log", log)):
            if name is not None and not expanded(name).exists():
                raise MissingError(f"{what}: expected a file, found none: {name}")
        chosen: Task | None = next((item for item in TASKS if item == task), None)
        return cls(robot, chosen, period, None if payload is None else _mass(payload), log, tool, hold, path)


def _mass(value: str | float) -> float:
    """The largest mass of ``0..3``, ``0..3 kg`` or ``3 kg`` [kg]."""
    least, dots, most = value.partition("..") if isinstance(value, str) else ("", "", value)
    found = to_unit(most if dots or not isinstance(value, str) else least, "kg")
    if dots and to_unit(least, "kg") != 0:
        raise ValueFault(f"payload: expected a range from 0, such as 0..3, found {value}")
    if not 0 <= found < float("inf"):
        raise ValueFault(f"payload: expected a mass of zero or more, found {value}")
    return found
