"""Paths on which laws are tuned and compared: of the joints, of the tool, or the user's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from dmframe.common.errors import RobotError
from dmframe.design.family import Block, rounded
from dmframe.design.path_file import Array
from dmframe.design.points import Points, fitted, speeds
from dmframe.design.tool_path import Kinematics, followed
from dmframe.graph.first import FirstGraph
from dmframe.robot.chain import SerialChain

TRAINING: Final = "repeating"
NEVER: Final = "wander"
AGAIN: Final = "cycle"
OWN: Final = "path"
OWN_RATE: Final = "path_of_known_rate"
"""Names of the training path, of the held-out ones, and of the user's own path in their place."""
ACCELERATION: Final = 0.7
"""Largest acceleration of a joint, a half of what the channel of a UR admits [rad/s^2]."""
SLOWER: Final = 0.7
"""Fundamental frequency of the training path relative to the slowest joint of the first graph."""
FASTER: Final = 1.3
"""That of the repeating held-out path."""
HARMONICS: Final = 3
STRETCHED: Final = 1.25
"""Duration of the training path relative to the user's own."""
USUAL: Final = 48.0
"""Duration of the runs [s]."""
LONGEST: Final = 120.0
"""Longest duration of the runs, and of a user's path there and back [s]."""
SCALES: Final = 0.8 ** np.arange(14)
"""Sizes of the paths of the tool that are tried, relative to its reach times `LARGEST`."""
LARGEST: Final = 0.12
FEW: Final = 32
"""Largest number of points of such a path: more take longer to compile, and the path is that of its points."""
CURVE: Final = 120
"""Points at which a path of the tool is computed."""
TURN: Final = 0.2
"""Amplitude of the tool's rotation [rad]."""
SHARE: Final = 0.4
"""Fraction of the velocity limits that a path of the tool uses."""
PASS: Final = 5.0
"""Shortest time of a path of the tool [s]."""

Error = Literal["joints", "tool"]


@final
@dataclass(frozen=True, eq=False)
class Motion:
    """Paths as sections of a race file.

    Parameters
    ----------
    start
        Where they start [rad, m].
    ranges
        Least and largest positions of each joint on the path that is handed over, (n, 2) [rad, m].
    rates
        Largest velocities of each joint on it, (n,) [rad/s, m/s].
    handed
        The held-out path of the graph that is handed over.
    error
        Whose error is compared.
    seconds
        Duration of the runs [s].
    notes
        How a user's path was changed.
    """

    paths: Mapping[str, Block]
    start: list[float]
    ranges: Array
    rates: Array
    handed: str = NEVER
    error: Error = "joints"
    seconds: float = USUAL
    notes: tuple[str, ...] = ()


def motion_of(first: FirstGraph) -> Motion:
    """Paths of the joints about the centre of the first graph's path, with its amplitudes.

    Each joint starts at rest at an end of its range: a path that starts with a velocity requires an infinite
    acceleration.
    """
    path = first_path(first)
    center, amplitude, rate = (np.array(path[key], dtype=float) for key in ("center", "amplitude", "rate"))
    fastest = np.sqrt(ACCELERATION / np.maximum(amplitude, 1e-9))
    slower = min(1.0, float(np.min(fastest / np.maximum(rate, 1e-9))))
    phase = np.where(np.arange(center.size) % 2, -1.0, 1.0) * np.pi / 2
    base = float(f"{SLOWER * slower * rate.min():.3g}")
    again = float(f"{FASTER * base:.3g}")
    multiples = 1 + np.arange(center.size) % HARMONICS
    multiples = np.minimum(multiples, np.maximum(1, np.floor(fastest / base)))
    phase = np.array(rounded(phase))

    def moving(rates: Any, **more: float) -> Block:
        found = {"center": center, "amplitude": amplitude, "rate": rates, "phase": phase}
        return {"type": "sinusoid", **{key: rounded(value) for key, value in found.items()}, **more}

    paths = {
        TRAINING: moving(base * multiples, repeats=base),
        AGAIN: moving(np.full(center.size, again), repeats=again),
        NEVER: moving(slower * rate),
    }
    ranges = np.column_stack([center - np.abs(amplitude), center + np.abs(amplitude)])
    return Motion(paths, rounded(center + amplitude * np.sin(phase)), ranges, np.abs(amplitude * slower * rate))


def first_path(first: FirstGraph) -> Block:
    """Path of a first graph."""
    from ruamel.yaml import YAML

    found: Block = YAML(typ="safe").load(first.text)["blocks"]["path"]
    return found


def own_motion(points: Points, error: Error) -> Motion:
    """The user's path, repeated or there and back; the laws are tuned on the same path, passed more slowly.

    Raises
    ------
    RobotError
        The path takes too long.
    """
    if points.period > LONGEST:
        whole = "" if points.after == "repeats" else " there and back"
        raise RobotError(
            f"the path takes {points.period:.3g} s{whole}, and runs of at most {LONGEST:g} s are simulated; cut it "
            "into parts"
        )
    kind, slow = _kind(error), points.slower(STRETCHED)
    paths = {
        TRAINING: _repeated(slow, kind),
        OWN: points.block(kind, points.after),
        OWN_RATE: _repeated(points, kind),
    }
    seconds = min(max(USUAL, 2 * points.period), LONGEST)
    return Motion(paths, rounded(points.q[0]), *points.extent, OWN_RATE, error, seconds, points.notes)


def tool_motion(first: FirstGraph, chain: SerialChain, *, turns: bool) -> Motion:
    """Closed paths of the tool from the posture of the first graph, the largest that the robot follows.

    A circle for tuning; a figure of eight, whose rate is known, and a closed curve in space, whose rate is not, for
    comparison. The tool rests at the start of each pass.

    Raises
    ------
    RobotError
        The robot follows none of them.
    """
    kinematics = Kinematics(chain, turns=turns)
    near, reasons = np.array(first_path(first)["center"], dtype=float), list[str]()
    reach = sum(float(np.linalg.norm([float(x) for x in joint.translation])) for joint in chain.joints)
    for scale in SCALES:
        for axes in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            try:
                found = [
                    _closed(kinematics, near, curve, scale * LARGEST * reach, list(axes), turns=turns)
                    for curve in (_circle, _eight, _in_space)
                ]
            except RobotError as error:
                reasons.append(error.text)
                continue
            circle, eight, space = found
            paths = {
                TRAINING: _repeated(circle, _kind("tool")),
                AGAIN: _repeated(eight, _kind("tool")),
                NEVER: space.block(_kind("tool"), "repeats"),
            }
            return Motion(paths, rounded(circle.q[0]), *space.extent, NEVER, "tool")
    raise RobotError(f"the robot follows no path of the tool near its best posture: {reasons[-1]}")


def _closed(
    kinematics: Kinematics, near: Array, curve: Callable[[Array], Array], size: float, axes: list[int], *, turns: bool
) -> Points:
    """Points of a closed path of the tool, passed as fast as its limits allow."""
    import pinocchio as pin

    start = kinematics.pose(near)
    s = np.linspace(0.0, 1.0, CURVE)
    fraction = s**3 * (10 - 15 * s + 6 * s**2)
    places = np.zeros((CURVE, 3))
    places[:, axes] = size * curve(2 * np.pi * fraction)
    goals = np.tile(start, (CURVE, 1))
    goals[:, :3] += places
    if turns:
        turned = [
            pin.log3(pin.exp3(TURN * angle * np.eye(3)[axes[2]]) @ pin.exp3(start[3:]))
            for angle in np.sin(2 * np.pi * fraction)
        ]
        goals[:, 3:] = np.array(turned)
    q = followed(kinematics, goals, near)
    q[-1] = q[0]
    rate = np.max(np.abs(np.gradient(q, s, axis=0)), axis=0)
    second = np.max(np.abs(np.gradient(np.gradient(q, s, axis=0), s, axis=0)), axis=0)
    limits = SHARE * speeds(kinematics.chain)
    seconds = max(PASS, float(np.max(rate / limits)), float(np.sqrt(np.max(second) / ACCELERATION)))
    if seconds > LONGEST / 4:
        raise RobotError("its joints are too slow for it")
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(seconds * s, q, bc_type="clamped")
    return fitted(spline, seconds, most=FEW)


def _repeated(points: Points, kind: str) -> Block:
    return points.block(kind, points.after) | {"repeats": float(f"{2 * np.pi / points.period:.6g}")}


def _kind(error: Error) -> str:
    return "joint_waypoints" if error == "tool" else "waypoints"


def _circle(phi: Array) -> Array:
    return _rows(np.sin(phi), 1 - np.cos(phi), 0 * phi)


def _eight(phi: Array) -> Array:
    return _rows(np.sin(phi), np.sin(2 * phi) / 2, 0 * phi)


def _in_space(phi: Array) -> Array:
    return _rows(np.sin(phi), (1 - np.cos(2 * phi)) / 2, np.sin(3 * phi) / 3)


def _rows(*columns: Array) -> Array:
    return np.column_stack(columns)
