"""Limits for a drive of the designed graph, with which it is rehearsed."""

from __future__ import annotations

from typing import Final

import numpy as np

from dmframe.design.motion import Motion
from dmframe.design.points import speeds
from dmframe.identification.race_text import dumped
from dmframe.robot.chain import SerialChain

AROUND: Final = 0.3
"""Distance of a position limit from the path [rad]."""
FASTER: Final = 2.0
LEAST: Final = 0.3
"""Velocity limit relative to the path, and its least value [rad/s]."""
ACCELERATION: Final = 15.0
"""Acceleration limit of commands [rad/s^2], about ten times what the channel of a UR passes on."""


def limits_text(motion: Motion, chain: SerialChain) -> str:
    """A file for ``dmframe drive --limits``: the path with margins, inside the limits of the robot."""
    names = chain.joint_names
    ends = np.array([[joint.lower, joint.upper] for joint in chain.joints])
    low = np.maximum(motion.ranges[:, 0] - AROUND, ends[:, 0])
    high = np.minimum(motion.ranges[:, 1] + AROUND, ends[:, 1])
    fast = np.minimum(np.maximum(FASTER * motion.rates, LEAST), speeds(chain))
    data = {
        "dmframe-limits": 1,
        "speed": {name: _inside(value, -1) for name, value in zip(names, fast, strict=True)},
        "acceleration": ACCELERATION,
        "position": {name: [_inside(a, 1), _inside(b, -1)] for name, a, b in zip(names, low, high, strict=True)},
    }
    return dumped(data)


def _inside(value: float, way: float) -> float:
    """Round to the fewest significant digits, six or more, that lead in the direction `way`.

    Rounded to the nearest number, a limit could be outside of that of the robot, which is refused.
    """
    rounded = (float(f"{value:.{digits}g}") for digits in range(6, 18))
    return next(found for found in rounded if way * (found - value) >= 0)
