"""A path of the joints as a block `waypoints`: at rest at its ends, within the robot's limits, of few points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, final

import numpy as np

from dmframe.common.errors import RobotError
from dmframe.common.units import plain
from dmframe.design.path_file import Array, PathFile
from dmframe.design.tool_path import Kinematics, followed
from dmframe.robot.chain import SerialChain

DENSE: Final = 2000
"""Points at which a path is compared with the limits, and with its block."""
ALONG: Final = 400
"""Points of a tool path at which the inverse kinematics are solved."""
FEWEST, MOST, MANY = 8, 64, 512
"""Numbers of points of a block that are tried, in powers of two: up to `MOST` in a design, `MANY` in another graph."""
DEVIATION: Final = 2e-4
"""Deviation of the block from the path at which no more points are added [rad, m]."""
REFUSED: Final = 5e-3
"""Deviation at which the path is refused [rad, m]."""
RESTING: Final = 0.02
"""Velocity at an end, relative to the largest, up to which the path counts as resting there."""
RAMP: Final = 1.0
"""Shortest time in which a path that starts with a velocity reaches it [s]."""
ACCELERATION: Final = 1.3
"""Largest acceleration of a joint that the compared laws and the channel of a UR admit [rad/s^2, m/s^2]."""
CLOSED: Final = 1e-3
"""Distance of the ends of a path that counts as closed [rad, m]."""
DIGITS: Final = 8

After = Literal["stays", "repeats", "returns"]


@final
@dataclass(frozen=True, eq=False)
class Points:
    """Points of a block `waypoints`, with their velocities and accelerations, and what was changed."""

    times: Array
    q: Array
    dq: Array
    ddq: Array
    deviation: float
    notes: tuple[str, ...] = ()

    @property
    def after(self) -> After:
        """What a repeated path does at its end."""
        return "repeats" if np.array_equal(self.q[0], self.q[-1]) else "returns"

    @property
    def period(self) -> float:
        """Time after which the repeated path is at its start again [s]."""
        return float(self.times[-1] - self.times[0]) * (1 if self.after == "repeats" else 2)

    @property
    def extent(self) -> tuple[Array, Array]:
        """Least and largest positions (n, 2), and largest velocities (n,), at the points."""
        return np.column_stack([self.q.min(axis=0), self.q.max(axis=0)]), np.max(np.abs(self.dq), axis=0)

    def slower(self, factor: float) -> Points:
        """The same points, passed with a velocity that is smaller by a factor."""
        rates = self.dq / factor, self.ddq / factor**2
        return Points(self.times * factor, self.q, *rates, self.deviation, self.notes)

    def block(self, kind: str, after: After, of: str = "q_d") -> dict[str, Any]:
        """Block of a graph file; `of` is the name of its points."""
        tables = {of: self.q, f"d{of}": self.dq, f"dd{of}": self.ddq}
        found: dict[str, Any] = {"type": kind, "times": _numbers(self.times)}
        found |= {name: [_numbers(row) for row in rows] for name, rows in tables.items()}
        return found | ({} if after == "stays" else {"after": after})


def points_of(
    file: PathFile, chain: SerialChain, near: Array, hardest: float = ACCELERATION, most: int = MOST
) -> Points:
    """The path of a file for the joints of a robot.

    A path of the tool is followed by inverse kinematics. A path that starts or ends with a velocity is passed more
    slowly there, so that it starts and ends at rest.

    Parameters
    ----------
    near
        Posture near which a path of the tool starts [rad, m].
    hardest
        Largest acceleration of a joint [rad/s^2, m/s^2].
    most
        Largest number of points.

    Raises
    ------
    RobotError
        The path leaves the reach, the range, the velocity or the acceleration of the robot, or has too much detail.
    """
    path, end, notes = _interpolated(file), float(file.times[-1]), [*file.notes]
    if file.kind != "joints":
        times = np.linspace(0.0, end, ALONG)
        goals = path(times)
        path = _spline(times, followed(Kinematics(chain, turns=file.kind == "pose"), goals, near))
        notes.append("the joint positions of the tool's path are computed by inverse kinematics")
    path, duration, ramped = _at_rest(path, end)
    if ramped:
        notes.append(_slower(ramped))
    t = np.linspace(0.0, duration, DENSE)
    check_limits(t, path(t), chain, hardest)
    return fitted(path, duration, tuple(notes), most=most)


def tool_points_of(file: PathFile, axes: str) -> Points:
    """The positions of the tool of a file, in the task's coordinates, without a robot; see `points_of`."""
    columns = ["xyz".index(axis) for axis in axes]
    path, duration, ramped = _at_rest(_interpolated(replace(file, rows=file.rows[:, columns])), float(file.times[-1]))
    return fitted(path, duration, (*file.notes, *([_slower(ramped)] if ramped else [])), "m", MANY)


def _slower(ramp: float) -> str:
    return f"the path starts or ends with a velocity, and is passed more slowly for {ramp:.3g} s there"


def fitted(
    path: Callable[[Array], Array], duration: float, notes: tuple[str, ...] = (), unit: str = "rad", most: int = MOST
) -> Points:
    """Points of a path that rests at its ends, with velocities and accelerations; see `points_of`."""
    t = np.linspace(0.0, duration, DENSE)
    q = path(t)
    spline, count = _spline(t, q), FEWEST
    closed = np.max(np.abs(q[0] - q[-1])) < CLOSED
    while True:
        times = _rounded(np.linspace(0.0, duration, count + 1))
        rows, rates, second = (_rounded(spline(times, k)) for k in range(3))
        rates[[0, -1]], second[[0, -1]] = 0.0, 0.0
        if closed:
            rows[-1] = rows[0]
        found = Points(times, rows, rates, second, 0.0, notes)
        deviation = float(np.max(np.abs(followed_by(found, t) - q)))
        if deviation <= DEVIATION or count >= most:
            break
        count *= 2
    if deviation > REFUSED:
        raise RobotError(
            f"expected a path that {most} points describe, found a deviation of {plain(deviation, unit)}; cut it into "
            "parts"
        )
    said = (f"{count + 1} points describe the path, with a deviation of at most {plain(deviation, unit)}",)
    return Points(times, rows, rates, second, deviation, (*notes, *said))


def followed_by(points: Points, t: Array) -> Array:
    """The path of the block at some times, (len(t), n)."""
    widths = np.diff(points.times)
    tau = np.clip((t[:, None] - points.times[:-1]) / widths, 0.0, 1.0)
    steps = tau**3 * (10 - 15 * tau + 6 * tau**2)
    before = np.column_stack([np.ones(len(t)), steps])
    weights = before - np.column_stack([steps, np.zeros(len(t))])
    since = t[:, None] - points.times
    return np.asarray(weights @ points.q + (weights * since) @ points.dq + (weights * since**2 / 2) @ points.ddq)


def check_limits(t: Array, q: Array, chain: SerialChain, hardest: float) -> None:
    """Raise `RobotError` for a path outside of the range, the velocity or the acceleration of a joint."""
    dq = np.gradient(q, t, axis=0)
    ddq = np.gradient(dq, t, axis=0)[2:-2]
    for j, joint in enumerate(chain.joints):
        unit = "rad" if joint.kind == "revolute" else "m"
        low, high = float(q[:, j].min()), float(q[:, j].max())
        if low < joint.lower - 1e-6 or high > joint.upper + 1e-6:
            k = int(np.argmin(q[:, j]) if low < joint.lower - 1e-6 else np.argmax(q[:, j]))
            raise RobotError(
                f"the path leaves the range of {joint.name}, {joint.lower:.4g} to {joint.upper:.4g} {unit}: "
                f"{q[k, j]:.4g} {unit} after {t[k]:.3g} s"
            )
    rates = [np.max(np.abs(values), axis=0) for values in (dq, ddq)]
    limits = speeds(chain)
    slower = np.maximum(rates[0] / limits, np.sqrt(rates[1] / hardest))
    j = int(np.argmax(slower))
    if slower[j] <= 1:
        return
    joint, unit = chain.joints[j], "rad" if chain.joints[j].kind == "revolute" else "m"
    need = f"a velocity of {plain(rates[0][j], f'{unit}/s')}, whose limit is {plain(joint.velocity, f'{unit}/s')}"
    if rates[0][j] <= limits[j]:
        need = (
            f"an acceleration of {plain(rates[1][j], f'{unit}/s^2')}, and the compared laws are for at most "
            f"{hardest:g} {unit}/s^2"
        )
    raise RobotError(f"the path requires of {joint.name} {need}: pass it in {slower[j]:.3g} times its time")


def speeds(chain: SerialChain) -> Array:
    """Velocity limits of the joints; infinite if there are none, for which some files have 0."""
    return np.array([joint.velocity if joint.velocity > 0 else np.inf for joint in chain.joints])


def _interpolated(file: PathFile) -> Any:
    """The path between its points: as a ROS controller does if there are velocities, else a cubic spline."""
    from scipy.interpolate import BPoly, CubicHermiteSpline

    if file.velocities is None:
        return _spline(file.times, file.rows)
    if file.accelerations is None:
        return CubicHermiteSpline(file.times, file.rows, file.velocities)
    both = np.stack([file.rows, file.velocities, file.accelerations], axis=1)
    return BPoly.from_derivatives(file.times, both)


def _spline(times: Array, rows: Array) -> Any:
    """Cubic spline through points; not-a-knot at the ends, a line for two points."""
    from scipy.interpolate import CubicSpline, make_interp_spline

    if len(times) < 4:
        return make_interp_spline(times, rows, k=len(times) - 1)
    return CubicSpline(times, rows)


def _at_rest(path: Callable[[Array], Array], end: float) -> tuple[Callable[[Array], Array], float, float]:
    """The path with rest at its ends, its duration, and the time of a ramp; zero if it rests there already.

    The time on the path s has the rate 10 r^3 - 15 r^4 + 6 r^5 of the elapsed fraction r of a ramp, whose integral over
    the ramp is half of its duration.
    """
    t = np.linspace(0.0, end, DENSE)
    speed = np.linalg.norm(np.gradient(path(t), t, axis=0), axis=1)
    if max(speed[0], speed[-1]) <= RESTING * max(float(speed.max()), 1e-12):
        return path, end, 0.0
    ramp = min(max(RAMP, end / 8), end)
    duration = end + ramp

    def gone(elapsed: Array) -> Array:
        r = np.clip(elapsed / ramp, 0.0, 1.0)
        return np.asarray(ramp * (2.5 * r**4 - 3 * r**5 + r**6) + np.maximum(elapsed - ramp, 0.0))

    def slowed(times: Array) -> Array:
        forward, backward = gone(times), end - gone(duration - times)
        return path(np.where(times < duration / 2, forward, backward))

    return slowed, duration, ramp


def _rounded(values: Array) -> Array:
    return np.array([float(f"{x:.{DIGITS}g}") if abs(x) > 1e-9 else 0.0 for x in values.ravel()]).reshape(values.shape)


def _numbers(values: Array) -> list[float]:
    return [float(x) for x in values]
