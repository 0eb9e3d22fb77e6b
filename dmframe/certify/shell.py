r"""The spherical shell about the first joint's origin that contains a chain's tool at all joint positions.

With the offsets :math:`t_i` between the revolute joints, and from the last of them to the tool,

.. math::

    \max(0, 2 \max_i l_i - \sum_i l_i) \le |W (x - o_1)| \le \sum_i l_i

where :math:`o_1` is the origin of the first revolute joint, the rows of W are orthonormal task directions along which
no prismatic joint moves, and :math:`l_i = |W R_i t_i|`. This is a number if W has three rows, or if all joints turn
about one axis orthogonal to W's two rows; otherwise only an interval is known. A prismatic joint has no end stops in
the simulated model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

ROUNDING: Final = 1e-9
"""Fraction of the outer radius by which a shell is enlarged; it exceeds all rounding errors."""
PARALLEL: Final = 1e-10
"""Sine of an angle that is due to rounding."""


@final
@dataclass(frozen=True)
class Shell:
    """Bounds of ``|across @ (x - center)|``.

    Parameters
    ----------
    center : (m,), m
        Origin of the first revolute joint, in task coordinates.
    across : (k, m)
        W: orthonormal rows.
    inner, outer : m
        The bounds.
    slides
        True if directions of prismatic joints were left out.
    """

    center: np.ndarray
    across: np.ndarray
    inner: float
    outer: float
    slides: bool


def shell_of(robot: Any) -> Shell | None:
    """The shell of a robot's tool; None without a revolute joint, or if prismatic joints span all task directions."""
    chain = robot.chain
    task = np.eye(3)[["xyz".index(axis) for axis in chain.axes]]
    walked = _walked(chain)
    if walked is None or not walked.turns:
        return None
    across = _without(walked.slides @ task.T)
    if not len(across):
        return None
    first, *others = walked.offsets
    ends = [_ends(offset, across @ task, axis) for offset, axis in zip(others, walked.axes, strict=True)]
    outer = math.fsum(upper for _, upper in ends)
    inner = max(lower + upper for lower, upper in ends) - outer
    return Shell(
        task @ first, across, max(0.0, inner - ROUNDING * outer), (1 + ROUNDING) * outer, bool(len(walked.slides))
    )


def largest_jacobian(chain: Any) -> float | None:
    r"""Upper bound of the norm of the position Jacobian at all joint positions [m/rad]; None with a prismatic joint.

    Column j is at most as long as the chain from joint j to the tool, :math:`r_j = \sum_{i \ge j} l_i`, and
    :math:`|J|^2 \le \sum_j r_j^2`.
    """
    walked = _walked(chain)
    if walked is None or len(walked.slides) or not walked.turns:
        return None
    lengths = [float(np.linalg.norm(offset)) for offset in walked.offsets[1:]]
    reaches = np.cumsum(lengths[::-1])
    return (1 + ROUNDING) * float(np.linalg.norm(reaches))


@final
@dataclass(frozen=True)
class _Walked:
    """A chain at q = 0, in coordinates of the base.

    `offsets`: sums of translations before the first revolute joint, between each two, and after the last. `axes`: for
    each but the first its constant axis, or None. `slides`: directions that span all prismatic motions.
    """

    turns: int
    offsets: tuple[np.ndarray, ...]
    axes: tuple[np.ndarray | None, ...]
    slides: np.ndarray


def _walked(chain: Any) -> _Walked | None:
    """None if a prismatic joint follows joints with different axes, and so moves in all directions."""
    turned, offsets, axes = np.eye(3), [np.zeros(3)], list[np.ndarray | None]()
    slides = list[np.ndarray]()
    for joint in chain.joints:
        offsets[-1] = offsets[-1] + turned @ np.array([float(x) for x in joint.translation])
        turned = turned @ np.array([[float(x) for x in row] for row in joint.rotation])
        axis = turned @ np.array([float(x) for x in joint.axis])
        if joint.kind == "revolute":
            one = not axes or (axes[-1] is not None and float(np.linalg.norm(np.cross(axes[-1], axis))) < PARALLEL)
            axes.append(axis if one else None)
            offsets.append(np.zeros(3))
        elif axes and axes[-1] is None:
            return None
        else:
            slides += _swept(axis, axes[-1] if axes else None)
    offsets[-1] = offsets[-1] + turned @ np.array([float(x) for x in chain.tool])
    return _Walked(len(axes), tuple(offsets), tuple(axes), np.array(slides).reshape(-1, 3))


def _swept(direction: np.ndarray, axis: np.ndarray | None) -> list[np.ndarray]:
    """Directions that span a direction rotated about an axis."""
    if axis is None:
        return [direction]
    along = (axis @ direction) * axis
    off = direction - along
    sizes = [np.linalg.norm(along), np.linalg.norm(off)]
    return [along] * bool(sizes[0] > PARALLEL) + [off, np.cross(axis, off)] * bool(sizes[1] > PARALLEL)


def _without(directions: np.ndarray) -> np.ndarray:
    """Orthonormal basis, by rows, of the orthogonal complement of these rows."""
    if not len(directions):
        return np.eye(directions.shape[1])
    _, sizes, right = np.linalg.svd(directions)
    return right[int(np.sum(sizes > PARALLEL)) :]


def _ends(offset: np.ndarray, across: np.ndarray, axis: np.ndarray | None) -> tuple[float, float]:
    """Bounds of l_i."""
    size = float(np.linalg.norm(offset))
    if len(across) == 3:
        return size, size
    if axis is not None and float(np.linalg.norm(across @ axis)) < PARALLEL:
        flat = float(np.linalg.norm(offset - (axis @ offset) * axis))
        return (flat if len(across) == 2 else 0.0), flat
    return 0.0, size
