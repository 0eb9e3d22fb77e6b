"""The joint path on which the tool follows its desired path: inverse kinematics, pose by pose, in floating point."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.diagram.model import hashes
from dmframe.errors import ValueFault

Array = NDArray[np.float64]
Progress = Callable[[float], None]

REACHED: Final = 1e-9
"""A pose is on the path if the tool is this close [m, or rad where joints follow a path]."""

CLOSED: Final = 1e-6
"""A joint path closes after a period if it misses its first pose by less [rad]."""

_LEAST_STEP: Final = 1e-9
_NEWTON: Final = 12
_MOST_POSES: Final = 20_000
_LARGEST_DENOMINATOR: Final = 64


@final
@dataclass(frozen=True)
class Leave:
    """Where the tool cannot follow its path any further.

    Parameters
    ----------
    time
        [s]; 0 on the way from the start onto the path.
    q
        (n,) the last pose found.
    goal
        Where the tool should be.
    distance
        How far from there the nearest pose that Newton's method finds leaves it [m].
    approach
        True on the way from the start onto the path.
    """

    time: float
    q: Array
    goal: Array
    distance: float
    approach: bool


@final
@dataclass(frozen=True)
class JointPath:
    """Poses, each joined to the next by a straight line.

    Parameters
    ----------
    times
        (N,) [s]; 0 on the way from the start onto the path.
    poses
        (N, n) [rad], [m] for prismatic joints.
    span
        How much of the desired path is covered [s].
    period
        After which the desired path repeats itself, and the joint path with it [s]; 0 for a point, None where it does
        not.
    leave
        Where the tool leaves the path; None where it follows it to the end.
    """

    times: Array
    poses: Array
    span: float
    period: float | None
    leave: Leave | None


@final
@dataclass(frozen=True)
class Reach:
    """What follows the path, and the path: q -> s, q -> its Jacobian, and t -> s_d, arrays each."""

    actual: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    goal: Callable[[float], Array]


def joint_path(
    reach: Reach, start: Array, duration: float, period: float | None, stride: float, progress: Progress | None = None
) -> JointPath:
    """Follow the desired path from the pose `start`, by Newton's method with the shortest steps.

    A start off the path is led onto it first, along the straight line of the tool. The whole duration is followed, or one
    period where both paths close.

    Parameters
    ----------
    period
        Of the desired path [s]; 0 for a point, None where it does not repeat itself.
    stride
        The most that a joint moves from pose to pose [rad].
    progress
        Called with the share that is done.

    Raises
    ------
    ValueFault
        The path has too many poses.
    """
    first, onto = reach.actual(start), reach.goal(0.0)
    times, poses, leave = [0.0], [start], None
    if np.linalg.norm(first - onto) > REACHED:
        _, poses, leave = _follow(reach, lambda share: first + share * (onto - first), start, 1.0, stride, None)
        times = [0.0] * len(poses)
        if leave is not None:
            leave = Leave(0.0, leave.q, leave.goal, leave.distance, True)
    span = duration if period is None else min(period, duration)
    if leave is None and span > 0:
        begin = poses[-1]
        more, further, leave = _follow(reach, reach.goal, begin, span, stride, progress)
        if period is not None and span < duration and leave is None:
            if np.max(np.abs(further[-1] - begin)) > CLOSED:  # a redundant robot, or another branch
                period, span = None, duration
                more, further, leave = _follow(reach, reach.goal, begin, span, stride, progress)
        times, poses = times + more[1:], poses + further[1:]
    return JointPath(np.array(times), np.array(poses), span, period, leave)


def _follow(
    reach: Reach, curve: Callable[[float], Array], start: Array, end: float, stride: float, progress: Progress | None
) -> tuple[list[float], list[Array], Leave | None]:
    times, poses, step = [0.0], [start], end / 64
    while times[-1] < end:
        then = min(times[-1] + step, end)
        found, distance = _newton(reach, poses[-1], curve(then))
        moved = float(np.max(np.abs(found - poses[-1])))
        if distance <= REACHED and moved <= stride:
            times.append(then)
            poses.append(found)
            step *= 1.5 if moved < stride / 2 else 1.0
            if len(poses) > _MOST_POSES:
                text = f"expected a path of at most {_MOST_POSES} poses, found {then:.4g} of {end:.4g} s covered by them"
                raise ValueFault(f"path: {text}; shorten the duration, or widen the tube")
            if progress is not None:
                progress(then / end)
        elif step > _LEAST_STEP * end:
            step /= 2
        else:
            return times, poses, Leave(times[-1], poses[-1], curve(then), distance, False)
    return times, poses, None


def _newton(reach: Reach, q: Array, goal: Array) -> tuple[Array, float]:
    best, least = q, math.inf
    for _ in range(_NEWTON):
        missing = goal - reach.actual(q)
        distance = float(np.linalg.norm(missing))
        if not distance < least:  # also where it is not a number
            break
        best, least = q, distance
        if least <= REACHED * 1e-3:
            break
        q = q + np.linalg.lstsq(reach.slope(q), missing, rcond=None)[0]
    return best, least


def period_of(trajectory: Any, time: Any) -> float | None:
    """After which an expression in time repeats itself by construction [s]: 0 for a constant, None for any other.

    Time must stand in sines and cosines alone, with angles of constant rates that have a common divisor.
    """
    rates = set[float]()
    instant, seen = hashes(time), set[int]()
    waiting = [trajectory[i] for i in range(trajectory.numel())]
    while waiting:
        item = waiting.pop()
        if item.element_hash() in seen:
            continue
        seen.add(item.element_hash())
        if item.element_hash() in instant:
            return None
        if item.is_op(ca.OP_SIN) or item.is_op(ca.OP_COS):
            rate = ca.simplify(ca.jacobian(item.dep(0), time))
            if not rate.is_constant():
                return None
            rates.add(abs(float(rate)))
        else:
            waiting += [item.dep(i) for i in range(item.n_dep())]
    return _common_period(sorted(rates - {0.0}))


def _common_period(rates: list[float]) -> float | None:
    if not rates:
        return 0.0
    ratios = [Fraction(rate / rates[0]).limit_denominator(_LARGEST_DENOMINATOR) for rate in rates]
    if any(abs(float(ratio) * rates[0] - rate) > 1e-12 * rate for ratio, rate in zip(ratios, rates, strict=True)):
        return None
    turns = math.lcm(*(ratio.denominator for ratio in ratios))
    return 2 * math.pi / rates[0] * turns / math.gcd(*(int(ratio * turns) for ratio in ratios))
