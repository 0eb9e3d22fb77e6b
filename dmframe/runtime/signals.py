"""Mapping of a graph's signals to the fields of a robot's sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dmframe.common.errors import DriveError
from dmframe.diagram import Diagram

FIELDS: Final = ("q", "dq", "q_c", "x")
"""Fields of a `Sample` that a controller may measure; signals have the same names."""


def origins(diagram: Diagram) -> Mapping[str, str]:
    """For each output of a channel model the signal that it replaces: ``encoder.q_m`` -> ``arm.q``."""
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
        The controller measures a signal that no driver has.
    """
    known, found = origins(diagram), dict[str, str]()
    for leaf in diagram.loop.measured:
        name = known.get(leaf.name, leaf.name).rpartition(".")[2]
        if name not in FIELDS:
            raise DriveError(
                f"{leaf.name}: expected one of {', '.join(FIELDS)}, which a robot's driver measures, found {name}"
            )
        found[leaf.name] = name
    return found


def velocity_command(diagram: Diagram) -> str:
    """Label of the command, which must be the joint velocities.

    Raises
    ------
    DriveError
        The graph has another command, or several.
    """
    units = {signal.label: signal.unit for signal in diagram.loop.outputs}
    names = [leaf.name for leaf in diagram.loop.commanded]
    if len(names) != 1 or units[names[0]] != "rad/s":
        found = " and ".join(f"{name} [{units[name]}]" for name in names) or "nothing"
        raise DriveError(f"expected a graph whose only command is the joint velocities [rad/s], found {found}")
    return names[0]
