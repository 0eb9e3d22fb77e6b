"""Divergence of a run whose states stay finite: an error that grows beyond the extent of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.robot.chain import SerialChain
from dmframe.simulate.bounds import Divergence, ranges

PARTS: Final = 8
"""Parts of a run whose errors are compared."""
GROWS: Final = 1.2
"""Ratio of the RMS in the last part to that in the fourth from which on an error counts as growing."""
LEAST: Final = 0.1
"""Fraction of the arm's reach, or of a joint's range, below which no error counts as divergence."""


def growth(diagram: Diagram, columns: Mapping[str, np.ndarray], times: np.ndarray) -> Divergence | None:
    r"""Divergence of the tracking error at the end of a whole run; None if it does not grow, or is within the motion.

    With the parts k = 1...8 of the run, the error e = s - s_d diverges if

    .. math::

        \mathrm{RMS}_8 = \max_k \mathrm{RMS}_k, \quad \mathrm{RMS}_8 > 1.2\, \mathrm{RMS}_4, \quad
        \mathrm{RMS}_8 > \max\big(|e(0)|,\; \max_t |s_d(t) - s_d(0)|,\; L\big)

    A robot that stands still from the start would have a smaller error. L is `LEAST` times the reach for a tool, and
    times the smallest range of a joint, a turn without limits, for joints.

    Parameters
    ----------
    columns
        By label: (N, rows).
    times
        (N,) [s].
    """
    goal, robot = diagram.loop.goal, diagram.robot
    if (
        goal is None
        or not isinstance(robot, SerialChain)
        or len(times) < PARTS
        or not {goal.desired, goal.actual} <= columns.keys()
    ):
        return None
    unit = next(signal.unit for signal in diagram.loop.outputs if signal.label == goal.actual)
    desired, actual = columns[goal.desired], columns[goal.actual]
    error = np.linalg.norm(actual - desired, axis=1)
    rms = [float(np.sqrt(np.mean(part**2))) for part in np.array_split(error, PARTS)]
    extent = float(np.max(np.linalg.norm(desired - desired[0], axis=1)))
    scale = max(extent, float(error[0]), LEAST * _size(robot, unit))
    if not (rms[-1] == max(rms) and rms[-1] > GROWS * rms[PARTS // 2 - 1] and rms[-1] > scale):
        return None
    element = int(np.argmax(np.abs(actual[-1] - desired[-1])))
    block, _, state = goal.actual.partition(".")
    how = (
        f"is far from {goal.desired}: the error of all elements grows to {plain(rms[-1], unit)} RMS in the last eighth,"
        f" more than the {plain(scale, unit)} of a robot at rest,"
    )
    return Divergence(block, state, element, float(times[-1]), how)


def _size(robot: SerialChain, unit: str) -> float:
    """Reach of the tool [m], or the smallest range of a joint, at most a turn [rad]; zero in other units."""
    if unit == "m":
        steps = [*(joint.translation for joint in robot.joints), robot.tool]
        return float(sum(np.linalg.norm(np.array(step, dtype=float)) for step in steps))
    if unit == "rad":
        lower, upper = ranges(robot)
        return float(min(2 * np.pi, np.min(upper - lower)))
    return 0.0
