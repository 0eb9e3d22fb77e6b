"""Joint path along which the tool follows its desired path: inverse kinematics in floating point.

A step between two poses is accepted only if `dmframe.analysis.path_tube` proves that the exact joint path is close to
the line between them over the whole time interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.path_tube import PathTube
from dmframe.block.model import symbols_in
from dmframe.common.errors import ValueFault

Array = NDArray[np.float64]
Progress = Callable[[float], None]

REACHED: Final = 1e-9
"""A pose is on the path if the tool is this close [m, or rad where joints follow a path]."""

CLOSED: Final = 1e-6
"""Largest difference between the first pose and the one after a period of a closed joint path [rad]."""

_LEAST_STEP: Final = 1e-9
_DOUBTED: Final = 1e-3
"""Longest step without a proof, as a fraction of the duration."""

_JUMP: Final = 1e-3
"""Least displacement within the shortest step that counts as a jump of the path [m]."""

_NEWTON: Final = 12
_SEEDS: Final = 12
_MOST_POSES: Final = 20_000
_LARGEST_DENOMINATOR: Final = 64
_AT_ONCE: Final = 4096
_MOST_INTERVALS: Final = 200_000
"""Maximum number of enclosed time intervals of a periodic path; the proof covers no later time."""


@final
@dataclass(frozen=True)
class PathExit:
    """First time at which the tool cannot follow its desired path.

    Parameters
    ----------
    time
        [s].
    q
        (n,) the last pose found.
    later, goal
        A time shortly after [s], and the desired tool position at that time.
    distance
        Distance from `goal` to the nearest reachable point found [m]. About 0 if other poses reach it but none near `q`
        does: the path passes a singularity, or the desired path jumps.
    jump
        Jump of the desired path at `time` [m]; 0 without a jump.
    """

    time: float
    q: Array
    later: float
    goal: Array
    distance: float
    jump: float = 0.0


@final
@dataclass(frozen=True)
class Unproved:
    """First time from which the exact joint path is not proved to be close to the poses [s], with pose and reason."""

    time: float
    q: Array
    reason: str


@final
@dataclass(frozen=True)
class JointPath:
    """Joint path: poses connected by straight lines.

    Parameters
    ----------
    times
        (N,) [s]; 0 for the approach from the start to the path.
    poses
        (N, n) [rad], [m] for prismatic joints.
    span
        Covered duration of the desired path [s].
    period
        Period of the desired path and of the joint path [s]; 0 for a point, None for an aperiodic path.
    path_exit
        Where the tool cannot follow the path; None if it follows it to the end.
    line_distance
        (N - 1, n) proved bound on the distance of the exact joint path from each line over its whole time interval
        [rad]; 0 for the approach. None for a user's path.
    until
        The exact joint path is enclosed from 0 to this time [s].
    unproved
        Where the enclosure could not be proved; None if it was.
    """

    times: Array
    poses: Array
    span: float
    period: float | None
    path_exit: PathExit | None
    line_distance: Array | None = None
    until: float = 0.0
    unproved: Unproved | None = None

    @property
    def hulls(self) -> tuple[Array, Array]:
        """The smallest and largest joint positions of each straight line, (N - 1, n) each."""
        first, last = (self.poses[:-1], self.poses[1:]) if len(self.poses) > 1 else (self.poses, self.poses)
        return np.minimum(first, last), np.maximum(first, last)

    @property
    def has_approach(self) -> bool:
        """True if an approach connects the start to the path."""
        return self.line_distance is not None and len(self.line_distance) > 1 and not np.any(self.line_distance[0])

    def distance(self, q: Array) -> Array:
        """Largest distance in any joint of each pose of q (k, n) from the path: (k,) [rad]."""
        low, high = self.hulls
        outside = (np.max(np.maximum(low - pose, pose - high), axis=1) for pose in q)
        return np.maximum([np.min(away) for away in outside], 0.0)


@final
@dataclass(frozen=True)
class ToolPath:
    """Tool position s(q), its Jacobian, and desired position s_d(t), as arrays."""

    actual: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    goal: Callable[[float], Array]


def joint_path(
    reach: ToolPath,
    start: Array,
    duration: float,
    period: float | None,
    stride: float,
    tube: PathTube | str,
    progress: Progress | None = None,
) -> JointPath:
    """Follow the desired path from the pose `start` by Newton's method with minimum-norm steps.

    A start off the path is first connected to it, the tool on a straight line. The whole duration is followed, or one
    period if both paths are closed; later periods are proved to have the same joint path.

    Parameters
    ----------
    period
        Period of the desired path [s]; 0 for a point, None for an aperiodic one.
    stride
        Largest joint displacement between poses [rad].
    tube
        Proof that the exact path is close to the lines, or the reason for its absence.
    progress
        Called with the completed fraction.

    Raises
    ------
    ValueFault
        The path has too many poses.
    """
    poses, path_exit = _approach(reach, start, stride)
    if path_exit is not None:
        return JointPath(np.zeros(len(poses)), np.array(poses), 0.0, period, path_exit)
    onto, until = len(poses) - 1, 0.0
    for repeats in (period, None) if duration > 0 else (0.0,):
        walk = _Walk([0.0], [poses[-1]], [])
        span = duration if repeats is None else min(repeats, duration)
        path_exit = _follow(reach, reach.goal, walk, span, stride, tube, progress) if span > 0 else None
        closes = path_exit is None and (span < duration or not span)
        if closes and np.max(np.abs(walk.poses[-1] - walk.poses[0])) > CLOSED:
            continue  # a redundant robot, or another branch
        if closes and walk.unproved is None:
            proved = _repeated(tube, walk, span, duration)
            if proved is None:  # not periodic, although its expression is
                continue
            until = proved
        else:
            until = span if walk.unproved is None and path_exit is None else 0.0
        break
    line_distance = np.vstack([np.zeros((onto, len(start))), *walk.line_distance])
    times = np.array([0.0] * onto + walk.times)
    return JointPath(
        times, np.array(poses[:-1] + walk.poses), span, repeats, path_exit, line_distance, until, walk.unproved
    )


@dataclass
class _Walk:
    """Poses found so far, and proved distance bounds of the lines between them."""

    times: list[float]
    poses: list[Array]
    line_distance: list[Array]
    unproved: Unproved | None = None

    def proved(self, tube: PathTube | str | None, then: float, pose: Array) -> str:
        """Append the next pose; returns the reason if its line is not proved, else an empty text."""
        if tube is None or self.unproved is not None:
            return self._take(then, pose, np.full(len(pose), np.nan))
        if isinstance(tube, str):
            return tube
        found = tube.over(self.poses[-1][None], pose[None], np.array(self.times[-1:]), np.array([then]))
        return found.reason or self._take(then, pose, found.most[0])

    def _take(self, then: float, pose: Array, line_distance: Array) -> str:
        self.times.append(then)
        self.poses.append(pose)
        self.line_distance.append(line_distance)
        return ""


def _repeated(tube: PathTube | str, walk: _Walk, span: float, duration: float) -> float | None:
    """Time up to which later periods are proved to have the same joint path; None if the first one is not.

    A constant path is one line of zero length over the whole duration.
    """
    if isinstance(tube, str):
        return _undecided(walk, tube)
    if not span:
        rest = np.array(walk.poses)
        found = tube.over(rest, rest, np.zeros(1), np.array([duration]))
        if found.reason:
            return None
        walk.line_distance.append(found.most[0])
        walk.times, walk.poses = [0.0, 0.0], [rest[0], rest[0]]
        return duration
    ends, poses, most = np.array(walk.times), np.array(walk.poses), np.array(walk.line_distance)
    count = min(int(np.ceil(duration / span)), max(_MOST_INTERVALS // len(most), 1))
    for turn in range(1, count):
        shifted = np.append(ends[:-1] + turn * span, (turn + 1) * span)  # the next period begins where this one ends
        for k in range(0, len(most), _AT_ONCE):
            here = slice(k, min(k + _AT_ONCE, len(most)))
            found = tube.over(poses[:-1][here], poses[1:][here], shifted[:-1][here], shifted[1:][here])
            if found.reason:
                return None
            most[here] = np.maximum(most[here], found.most)
    walk.line_distance[:] = list(most)
    return min(count * span, duration)


def _undecided(walk: _Walk, reason: str) -> float:
    walk.unproved = Unproved(0.0, walk.poses[0], reason)
    return 0.0


def _approach(reach: ToolPath, start: Array, stride: float) -> tuple[list[Array], PathExit | None]:
    """Approach from the start to the path, the tool on a straight line or, past a singularity, the joints."""
    first, onto = reach.actual(start), reach.goal(0.0)
    if np.linalg.norm(first - onto) <= REACHED:
        return [start], None
    walk = _Walk([0.0], [start], [])
    path_exit = _follow(reach, lambda fraction: first + fraction * (onto - first), walk, 1.0, stride, None, None)
    if path_exit is None:
        return walk.poses, None
    there, distance = _nearest(reach, start, onto)
    if distance > REACHED:
        return walk.poses, PathExit(0.0, walk.poses[-1], 0.0, onto, distance)
    count = int(np.ceil(np.max(np.abs(there - start)) / stride)) + 1
    return list(np.linspace(start, there, count)), None


def _follow(
    reach: ToolPath,
    curve: Callable[[float], Array],
    walk: _Walk,
    end: float,
    stride: float,
    tube: PathTube | str | None,
    progress: Progress | None,
) -> PathExit | None:
    """Follow a curve; steps are halved until they are short enough and, with a tube, proved."""
    step, longest = end / 64, end
    while walk.times[-1] < end:
        time, pose = walk.times[-1], walk.poses[-1]
        then = min(time + step, end)
        found, distance = _newton(reach, pose, curve(then))
        moved = float(np.max(np.abs(found - pose)))
        reached = distance <= REACHED and moved <= stride
        reason = walk.proved(tube, then, found) if reached else ""
        if reached and not reason:
            step = min(step * (1.5 if moved < stride / 2 else 1.0), longest)
            if len(walk.poses) > _MOST_POSES:
                text = (
                    f"expected a path of at most {_MOST_POSES} poses, found {then:.4g} of {end:.4g} s covered by them"
                )
                raise ValueFault(f"path: {text}; shorten the duration, or widen the tube")
            if progress is not None:
                progress(then / end)
        elif step > _LEAST_STEP * end and not (reached and isinstance(tube, str)):
            step /= 2
        elif reached:  # no proof from here on; the search for poses continues
            walk.unproved, longest = Unproved(time, pose, reason), end * _DOUBTED
        else:
            return _exit_at(reach, curve, time, pose, then, end)
    return None


def _exit_at(
    reach: ToolPath, curve: Callable[[float], Array], time: float, pose: Array, then: float, end: float
) -> PathExit:
    """Reason why no pose near the last one follows the path."""
    jump = float(np.linalg.norm(curve(then) - curve(time)))
    if jump > _JUMP:
        return PathExit(time, pose, then, curve(then), 0.0, jump)
    later = min(time + end / 100, end)
    _, distance = _nearest(reach, pose, curve(later))
    if distance <= REACHED:  # reachable at `then`: take a later time
        _, nearer = _nearest(reach, pose, curve(then))
        later, distance = (then, nearer) if nearer > REACHED else (later, distance)
    return PathExit(time, pose, later, curve(later), distance)


def _newton(reach: ToolPath, q: Array, goal: Array) -> tuple[Array, float]:
    best, least = q, math.inf
    for _ in range(_NEWTON):
        missing = goal - reach.actual(q)
        distance = float(np.linalg.norm(missing))
        if not distance < least:  # also for NaN
            break
        best, least = q, distance
        if least <= REACHED * 1e-3:
            break
        q = q + np.linalg.lstsq(reach.slope(q), missing, rcond=None)[0]
    return best, least


def _nearest(reach: ToolPath, q: Array, goal: Array) -> tuple[Array, float]:
    """Pose whose tool is nearest to the goal, searched from q and then from random poses; and its distance."""
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
    """Period of an expression in time, by its structure [s]: 0 for a constant, None for an aperiodic expression.

    Time must occur only in sines and cosines of angles with constant, commensurable rates.
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
