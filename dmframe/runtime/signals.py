"""Which of a robot's numbers a graph's signals are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dmframe.diagram import Diagram
from dmframe.errors import DriveError

TOLD: Final = ("q", "dq", "q_c", "x")
"""What a `Sample` has, by the names that signals have."""


def origins(diagram: Diagram) -> Mapping[str, str]:
    """By a stand-in's label what it stands in for: ``encoder.q_m`` for ``arm.q``."""
    return {
        f"{wire.block}.{wire.port}": f"{way.origin.block}.{way.origin.port}"
        for way in diagram.ways
        for wire in way.through
    }


def measured_as(diagram: Diagram) -> dict[str, str]:
    """For each measured signal the field of a `Sample`, ``{"arm.q": "q"}``.

    Raises
    ------
    DriveError
        The controller measures what no driver tells.
    """
    known, found = origins(diagram), dict[str, str]()
    for leaf in diagram.loop.measured:
        name = known.get(leaf.name, leaf.name).rpartition(".")[2]
        if name not in TOLD:
            raise DriveError(
                f"{leaf.name}: expected a controller that measures {', '.join(TOLD)}, which a robot tells, found {name}"
            )
        found[leaf.name] = name
    return found


def velocity_command(diagram: Diagram) -> str:
    """The label of what is commanded, a velocity of each joint.

    Raises
    ------
    DriveError
        It is something else, or more than that.
    """
    units = {signal.label: signal.unit for signal in diagram.loop.outputs}
    names = [leaf.name for leaf in diagram.loop.commanded]
    if len(names) != 1 or units[names[0]] != "rad/s":
        found = " and ".join(f"{name} [{units[name]}]" for name in names) or "nothing"
        raise DriveError(f"expected a graph that commands velocities of joints alone [rad/s], found {found}")
    return names[0]
