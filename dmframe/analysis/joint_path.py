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

from dmframe.block.model import symbols_in
from dmframe.errors import ValueFault

Array = NDArray[np.float64]
Progress = Callable[[float], None]

REACHED: Final = 1e-9
"""A pose is on the path if the tool is this close [m, or rad where joints follow a path]."""

CLOSED: Final = 1e-6
"""A joint path closes after a period if it misses its first pose by less [rad]."""

_LEAST_STEP: Final = 1e-9
_NEWTON: Final = 12
_SEEDS: Final = 12
_MOST_POSES: Final = 20_000
_LARGEST_DENOMINATOR: Final = 64


@final
@dataclass(frozen=True)
class Leave:
    """Where the tool cannot follow its path any further.

    Parameters
    ----------
    time
        [s].
    q
        (n,) the last pose found.
    later, goal
        A time soon after [s], and where the tool should then be.
    distance
        From there to the nearest point that any pose found reaches [m]; about 0 where poses reach it, but none near
        `q`: the way there passes a singularity.
    """

    time: float
    q: Array
    later: float
    goal: Array
    distance: float


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

    @property
    def hulls(self) -> tuple[Array, Array]:
        """The smallest and largest joint positions of each straight line, (N - 1, n) each."""
        first, last = (self.poses[:-1], self.poses[1:]) if len(self.poses) > 1 else (self.poses, self.poses)
        return np.minimum(first, last), np.maximum(first, last)

    def distance(self, q: Array) -> Array:
        """How wide a tube must be to hold each of the poses q (k, n), a run's for example: (k,) [rad]."""
        low, high = self.hulls
        outside = (np.max(np.maximum(low - pose, pose - high), axis=1) for pose in q)
        return np.maximum([np.min(away) for away in outside], 0.0)


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

    A start off the path is led onto it first, the tool on a straight line. The whole duration is followed, or one
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
    poses, leave = _approach(reach, start, stride)
    times = [0.0] * len(poses)
    span = duration if period is None else min(period, duration)
    if leave is None and span > 0:
        begin = poses[-1]
        more, further, leave = _follow(reach, reach.goal, begin, span, stride, progress)
        opens = leave is None and span < duration and np.max(np.abs(further[-1] - begin)) > CLOSED
        if opens:  # a redundant robot, or another branch
            period, span = None, duration
            more, further, leave = _follow(reach, reach.goal, begin, span, stride, progress)
        times, poses = times + more[1:], poses + further[1:]
    return JointPath(np.array(times), np.array(poses), span, period, leave)


def _approach(reach: Reach, start: Array, stride: float) -> tuple[list[Array], Leave | None]:
    """From the start onto the path: the tool on a straight line, or, where that passes a singularity, the joints."""
    first, onto = reach.actual(start), reach.goal(0.0)
    if np.linalg.norm(first - onto) <= REACHED:
        return [start], None
    _, poses, leave = _follow(reach, lambda share: first + share * (onto - first), start, 1.0, stride, None)
    if leave is None:
        return poses, None
    there, distance = _nearest(reach, start, onto)
    if distance > REACHED:
        return poses, Leave(0.0, poses[-1], 0.0, onto, distance)
    count = int(np.ceil(np.max(np.abs(there - start)) / stride)) + 1
    return list(np.linspace(start, there, count)), None


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
                text = (
                    f"expected a path of at most {_MOST_POSES} poses, found {then:.4g} of {end:.4g} s covered by them"
                )
                raise ValueFault(f"path: {text}; shorten the duration, or widen the tube")
            if progress is not None:
                progress(then / end)
        elif step > _LEAST_STEP * end:
            step /= 2
        else:
            later = min(times[-1] + end / 100, end)
            _, distance = _nearest(reach, poses[-1], curve(later))
            return times, poses, Leave(times[-1], poses[-1], later, curve(later), distance)
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


def _nearest(reach: Reach, q: Array, goal: Array) -> tuple[Array, float]:
    """The pose found whose tool is nearest to the goal, first from q, then from anywhere; and the distance."""
    from scipy.optimize import least_squares

    rng, best, least = np.random.default_rng(0), q, math.inf
    for seed in (q, *rng.uniform(-np.pi, np.pi, (_SEEDS, len(q)))):
        found = least_squares(
            lambda x: reach.actual(x) - goal, seed, jac=reach.slope, xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        pose, distance = _newton(reach, np.asarray(found.x), goal)
        if distance < least:
            best, least = pose, distance
        if least <= REACHED:
            break
    return best, least


def period_of(trajectory: Any, time: Any) -> float | None:
    """After which an expression in time repeats itself by construction [s]: 0 for a constant, None for any other.

    Time must stand in sines and cosines alone, with angles of constant rates that have a common divisor.
    """
    rates = set[float]()
    instant, seen = symbols_in([time]), set[int]()
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
