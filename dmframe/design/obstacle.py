"""Diagnosis of a race in which each law diverged: the torque limit of the robot."""

from __future__ import annotations

from typing import Final

import numpy as np

from dmframe.common.errors import DmframeError
from dmframe.common.units import plain
from dmframe.race.plan import Cell, Race, Run

EXCESS: Final = "torque_limits.tau_excess"
"""Torque beyond the limits, of the channel of a UR [N m]."""


def obstacle(race: Race, cell: Cell) -> str:
    """Which torque limit the first law exceeds in a cell, and what to do; empty if it exceeds none.

    A joint that cannot hold the arm diverges with any law.
    """
    law = next(iter(race.file.laws))
    try:
        graph = race.graph(Run(law, cell, race.laws[law, cell.clock].own, race.file.seed))
        beyond = np.abs(np.nan_to_num(graph.run(judge=False).recording[EXCESS])) > 0
    except (DmframeError, KeyError):
        return ""
    shares = np.mean(beyond, axis=0)
    k = int(np.argmax(shares))
    if not shares[k]:
        return ""
    joint = graph.robot.joints[k]
    return (
        f"each law diverges: {joint.name} is at its torque limit, {plain(joint.effort, 'N m')}, in "
        f"{100 * shares[k]:.0f} % of the samples of a run with {law} on the servo {cell.plant}; correct the limit of "
        "effort in the robot's file if it is too small, or take a smaller --payload"
    )
