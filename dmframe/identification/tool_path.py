"""Tool paths within the joint positions and velocities of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array
from dmframe.robot.chain import SerialChain
from dmframe.robot.symbolic import SymbolicRobot

SCALES: Final = 0.85 ** np.arange(16)
"""Factors of the radii that are tried, the largest first."""
STEP: Final = 0.05
"""Interval between the points of a path that are checked [s]."""
SINGULAR: Final = 0.05
"""Smallest ratio of the singular values of J on a path."""
FASTER: Final = 1.0
"""Largest velocity of a joint, relative to that of its commands in the log."""
REACHED: Final = 1e-5
"""Distance from the path at which a pose is found [m]."""


@final
@dataclass(frozen=True, eq=False)
class Place:
    """Where paths lie.

    Parameters
    ----------
    q
        Pose at their centre [rad].
    center
        Tool position there [m].
    plane
        xy, xz or yz.
    scale
        Factor of their radii.
    spread
        Frobenius norm of J at the centre [m/rad].
    """

    q: Array
    center: Array
    plane: str
    scale: float
    spread: float


def place_of(chain: SerialChain, log: Log, paths: Sequence[Mapping[str, Any]], seconds: float) -> Place | None:
    """The place at which all paths, as parameters of `epicycles`, are largest; None if none of the scales fits.

    A path fits if its joint positions are within those of the log and the robot's limits, if their velocities are below
    the largest commands of the log, and if J is far from singular.
    """
    inside = _Inside(chain, log, seconds)
    center, J = inside.tool(inside.middle)
    spread = float(np.linalg.norm(J))
    for scale in SCALES:
        for plane in ("xy", "xz", "yz") if chain.m == 3 else ("xy",):
            if all(inside.fits(center + scale * _circles(path, plane, inside.times, chain.m)) for path in paths):
                return Place(inside.middle, center, plane, float(scale), spread)
    return None


def _circles(path: Mapping[str, Any], plane: str, t: Array, m: int) -> Array:
    """Tool positions relative to the centre, (len(t), m) [m]."""
    found = np.zeros((len(t), m))
    first, second = ("xyz".index(axis) for axis in plane)
    for radius, rate, phase in zip(path["radius"], path["rate"], path["phase"], strict=True):
        found[:, first] += radius * np.cos(rate * t + phase)
        found[:, second] += radius * np.sin(rate * t + phase)
    return found


@final
class _Inside:
    """Which paths are within the joint positions and velocities of a log."""

    def __init__(self, chain: SerialChain, log: Log, seconds: float) -> None:
        limits = np.array([[joint.lower, joint.upper] for joint in chain.joints])
        self.low = np.maximum(np.min(log.q, axis=0), limits[:, 0])
        self.high = np.minimum(np.max(log.q, axis=0), limits[:, 1])
        self.fastest = FASTER * np.max(np.abs(log.u), axis=0)
        self.middle = 0.5 * (self.low + self.high)
        self.times = np.arange(0.0, seconds, STEP)
        robot, q = SymbolicRobot(chain), ca.SX.sym("q", chain.n)
        symbols = [constant.symbol for constant in robot.constants]
        self._numbers = [ca.DM(list(value)) for value in robot.values().values()]
        self._tool = ca.Function("tool", [q, *symbols], [robot.position(q), robot.jacobian(q)])

    def tool(self, q: Array) -> tuple[Array, Array]:
        """Position of the tool, (m,), and J, (m, n)."""
        x, J = self._tool(q, *self._numbers)
        return np.array(x).ravel(), np.array(J)

    def fits(self, points: Array) -> bool:
        """True if the joints follow these positions of the tool within the log's range."""
        q, before = self.middle, None
        for goal in points:
            for _ in range(20 if before is None else 4):
                x, J = self.tool(q)
                values = np.linalg.svd(J, compute_uv=False)
                if values[-1] < SINGULAR * values[0]:
                    return False
                if np.linalg.norm(goal - x) < REACHED:
                    break
                q = q + np.linalg.solve(J, goal - x)
            else:
                return False
            fast = before is not None and np.any(np.abs(q - before) > STEP * self.fastest)
            if fast or np.any(q < self.low) or np.any(q > self.high):
                return False
            before = q
        return True
