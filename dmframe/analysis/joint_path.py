"""The joint path on which the tool follows its desired path: inverse kinematics, pose by pose, in floating point.

A step from pose to pose is taken only where `dmframe.analysis.path_tube` proves that the exact joint path lies close to
the line between them over the whole interval of time.
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
"""A joint path closes after a period if it misses its first pose by less [rad]."""

_LEAST_STEP: Final = 1e-9
_DOUBTED: Final = 1e-3
"""The longest step, as a share of the duration, once nothing is proved any more."""

_JUMP: Final = 1e-3
"""A path that moves by more [m] within the shortest step jumps."""

_NEWTON: Final = 12
_SEEDS: Final = 12
_MOST_POSES: Final = 20_000
_LARGEST_DENOMINATOR: Final = 64
_AT_ONCE: Final = 4096
_MOST_INTERVALS: Final = 200_000
"""Of a path that repeats itself, intervals of time that are enclosed; the claim ends where they do."""


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
        `q`: the way there passes a singularity, or the desired path jumps.
    jump
        By how much the desired path jumps at `time` [m]; 0 where it does not.
    """

    time: float
    q: Array
    later: float
    goal: Array
    distance: float
    jump: float = 0.0


@final
@dataclass(frozen=True)
class Doubt:
    """From where on the exact joint path is not proved to lie close to the poses: the time [s], the pose and why."""

    time: float
    q: Array
    reason: str


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
    apart
        (N - 1, n) bound on the distance of the exact joint path from each line, proved over its whole time interval
        [rad]; 0 on the way onto the path. None for a path that was given.
    until
        The exact joint path is enclosed from 0 to this time [s].
    doubt
        Where that could not be proved; None where it is.
    """

    times: Array
    poses: Array
    span: float
    period: float | None
    leave: Leave | None
    apart: Array | None = None
    until: float = 0.0
    doubt: Doubt | None = None

    @property
    def hulls(self) -> tuple[Array, Array]:
        """The smallest and largest joint positions of each straight line, (N - 1, n) each."""
        first, last = (self.poses[:-1], self.poses[1:]) if len(self.poses) > 1 else (self.poses, self.poses)
        return np.minimum(first, last), np.maximum(first, last)

    @property
    def led(self) -> bool:
        """Whether a way leads from the start onto the path."""
        return self.apart is not None and len(self.apart) > 1 and not np.any(self.apart[0])

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
    reach: Reach,
    start: Array,
    duration: float,
    period: float | None,
    stride: float,
    tube: PathTube | str,
    progress: Progress | None = None,
) -> JointPath:
    """Follow the desired path from the pose `start`, by Newton's method with the shortest steps.

    A start off the path is led onto it first, the tool on a straight line. The whole duration is followed, or one
    period where both paths close; that the path is then the same in later periods is proved too.

    Parameters
    ----------
    period
        Of the desired path [s]; 0 for a point, None where it does not repeat itself.
    stride
        The most that a joint moves from pose to pose [rad].
    tube
        What proves that the exact path lies close to the lines; or why there is no such proof.
    progress
        Called with the share that is done.

    Raises
    ------
    ValueFault
        The path has too many poses.
    """
    way, leave = _approach(reach, start, stride)
    if leave is not None:
        return JointPath(np.zeros(len(way)), np.array(way), 0.0, period, leave)
    onto, until = len(way) - 1, 0.0
    for repeats in (period, None) if duration > 0 else (0.0,):
        walk = _Walk([0.0], [way[-1]], [])
        span = duration if repeats is None else min(repeats, duration)
        leave = _follow(reach, reach.goal, walk, span, stride, tube, progress) if span > 0 else None
        again = leave is None and (span < duration or not span)
        if again and np.max(np.abs(walk.poses[-1] - walk.poses[0])) > CLOSED:
            continue  # a redundant robot, or another branch
        if again and walk.doubt is None:
            held = _repeated(tube, walk, span, duration)
            if held is None:  # it does not repeat itself as its expression promised
                continue
            until = held
        else:
            until = span if walk.doubt is None and leave is None else 0.0
        break
    apart = np.vstack([np.zeros((onto, len(start))), *walk.apart])
    times = np.array([0.0] * onto + walk.times)
    return JointPath(times, np.array(way[:-1] + walk.poses), span, repeats, leave, apart, until, walk.doubt)


@dataclass
class _Walk:
    """The poses found so far; what is proved of the lines between them, up to the first where nothing is."""

    times: list[float]
    poses: list[Array]
    apart: list[Array]
    doubt: Doubt | None = None

    def proved(self, tube: PathTube | str | None, then: float, pose: Array) -> str:
        """Take the next pose; empty, or why its line is not proved."""
        if tube is None or self.doubt is not None:
            return self._take(then, pose, np.full(len(pose), np.nan))
        if isinstance(tube, str):
            return tube
        found = tube.over(self.poses[-1][None], pose[None], np.array(self.times[-1:]), np.array([then]))
        return found.reason or self._take(then, pose, found.most[0])

    def _take(self, then: float, pose: Array, apart: Array) -> str:
        self.times.append(then)
        self.poses.append(pose)
        self.apart.append(apart)
        return ""


def _repeated(tube: PathTube | str, walk: _Walk, span: float, duration: float) -> float | None:
    """Up to which time later periods are proved to follow the same joint path; None where the first that is not is.

    A path that rests is one line of no length, over the whole duration.
    """
    if isinstance(tube, str):
        return _doubted(walk, tube)
    if not span:
        rest = np.array(walk.poses)
        found = tube.over(rest, rest, np.zeros(1), np.array([duration]))
        if found.reason:
            return None
        walk.apart.append(found.most[0])
        walk.times, walk.poses = [0.0, 0.0], [rest[0], rest[0]]
        return duration
    ends, poses, most = np.array(walk.times), np.array(walk.poses), np.array(walk.apart)
    count = min(int(np.ceil(duration / span)), max(_MOST_INTERVALS // len(most), 1))
    for turn in range(1, count):
        shifted = np.append(ends[:-1] + turn * span, (turn + 1) * span)  # the next period begins where this one ends
        for k in range(0, len(most), _AT_ONCE):
            here = slice(k, min(k + _AT_ONCE, len(most)))
            found = tube.over(poses[:-1][here], poses[1:][here], shifted[:-1][here], shifted[1:][here])
            if found.reason:
                return None
            most[here] = np.maximum(most[here], found.most)
    walk.apart[:] = list(most)
    return min(count * span, duration)


def _doubted(walk: _Walk, reason: str) -> float:
    walk.doubt = Doubt(0.0, walk.poses[0], reason)
    return 0.0


def _approach(reach: Reach, start: Array, stride: float) -> tuple[list[Array], Leave | None]:
    """From the start onto the path: the tool on a straight line, or, where that passes a singularity, the joints."""
    first, onto = reach.actual(start), reach.goal(0.0)
    if np.linalg.norm(first - onto) <= REACHED:
        return [start], None
    walk = _Walk([0.0], [start], [])
    leave = _follow(reach, lambda share: first + share * (onto - first), walk, 1.0, stride, None, None)
    if leave is None:
        return walk.poses, None
    there, distance = _nearest(reach, start, onto)
    if distance > REACHED:
        return walk.poses, Leave(0.0, walk.poses[-1], 0.0, onto, distance)
    count = int(np.ceil(np.max(np.abs(there - start)) / stride)) + 1
    return list(np.linspace(start, there, count)), None


def _follow(
    reach: Reach,
    curve: Callable[[float], Array],
    walk: _Walk,
    end: float,
    stride: float,
    tube: PathTube | str | None,
    progress: Progress | None,
) -> Leave | None:
    """Walk along a curve; a step is halved until it is short enough, and proved where there is a tube."""
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
        elif reached:  # nothing is proved from here on; whether the tool can follow its path is still to be seen
            walk.doubt, longest = Doubt(time, pose, reason), end * _DOUBTED
        else:
            return _left(reach, curve, time, pose, then, end)
    return None


def _left(reach: Reach, curve: Callable[[float], Array], time: float, pose: Array, then: float, end: float) -> Leave:
    """Why no pose near the last one puts the tool on its path an instant later."""
    jump = float(np.linalg.norm(curve(then) - curve(time)))
    if jump > _JUMP:
        return Leave(time, pose, then, curve(then), 0.0, jump)
    later = min(time + end / 100, end)
    _, distance = _nearest(reach, pose, curve(later))
    if distance <= REACHED:  # a short way out of reach
        _, nearer = _nearest(reach, pose, curve(then))
        later, distance = (then, nearer) if nearer > REACHED else (later, distance)
    return Leave(time, pose, later, curve(later), distance)


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
