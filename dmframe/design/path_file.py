"""Read a path from a CSV file or a ROS ``trajectory_msgs/JointTrajectory`` in YAML or JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from dmframe.common.errors import MissingError, ValueFault, listed
from dmframe.common.files import expanded
from dmframe.identification.table import read_table
from dmframe.robot.chain import SerialChain

Array = np.ndarray
Kind = Literal["joints", "position", "pose"]

TRAJECTORIES: Final = (".yaml", ".yml", ".json")
TIMES: Final = ("t", "time", "timestamp", "time_s", "t_s", "time_from_start")
POSITION: Final = (("x", "y", "z"), ("x_1", "x_2", "x_3"), ("px", "py", "pz"), ("tool_x", "tool_y", "tool_z"))
QUATERNION: Final = (("qx", "qy", "qz", "qw"), ("ox", "oy", "oz", "ow"))
VECTOR: Final = (("rx", "ry", "rz"),)
"""Names of columns: of the tool's position [m], and of its orientation as a quaternion or a rotation vector [rad]."""
NESTED: Final = ("joint_trajectory", "trajectory", "goal")
"""Keys of messages that contain a JointTrajectory."""
DURATION: Final = (("sec", "secs"), ("nanosec", "nsec", "nsecs"))
"""Keys of a duration: seconds and nanoseconds."""
LARGEST: Final = 64 * 2**20
"""Largest file of a trajectory [bytes]."""
UNIT: Final = 0.01
"""Largest deviation of a quaternion's length from 1."""


@final
@dataclass(frozen=True, eq=False)
class PathFile:
    """Points of a path at increasing times from 0.

    Parameters
    ----------
    name
        The file.
    kind
        Whether the rows are positions of the joints (N, n) [rad, m], of the tool (N, 3) [m], or of the tool with its
        orientation as a rotation vector (N, 6) [m, rad].
    velocities, accelerations
        Of the rows, if the file has them.
    notes
        What was assumed or ignored.
    """

    name: str
    kind: Kind
    times: Array
    rows: Array
    velocities: Array | None = None
    accelerations: Array | None = None
    notes: tuple[str, ...] = ()


def read_path(path: str | Path, chain: SerialChain) -> PathFile:
    """Read a path of the joints or of the tool of a robot.

    A CSV file has a header with a column of times [s], and columns of the joints, by their names or as ``q_1``, or of
    the tool, ``x``, ``y`` and ``z``, in the frame of the robot's base; for its orientation a quaternion ``qx``, ``qy``,
    ``qz``, ``qw`` or a rotation vector ``rx``, ``ry``, ``rz``. Joint angles in degrees have names that end in ``_deg``.

    Raises
    ------
    MissingError, ValueFault
        There is no such file, or it has no path of this robot.
    """
    file = expanded(path)
    if file.is_dir() or not file.exists():
        raise MissingError(
            f"expected the file of a path, found {'a folder' if file.is_dir() else 'none'}", location=str(file)
        )
    found = _trajectory(file, chain) if file.suffix.lower() in TRAJECTORIES else _table(file, chain)
    return _checked(found)


def _checked(found: PathFile) -> PathFile:
    where, times = found.name, found.times
    if len(times) < 2:
        raise ValueFault(f"expected at least 2 points of a path, found {len(times)}", location=where)
    for name in ("times", "rows", "velocities", "accelerations"):
        values = getattr(found, name)
        if values is not None and not np.all(np.isfinite(values)):
            row = int(np.argwhere(~np.isfinite(values))[0][0]) + 1
            raise ValueFault(f"expected finite numbers, found another value in {name} of point {row}", location=where)
    steps = np.diff(times)
    if np.any(steps <= 0):
        k = int(np.argmax(steps <= 0)) + 1
        text = f"expected increasing times, found {times[k]:g} s at point {k + 1} after {times[k - 1]:g} s"
        raise ValueFault(text, location=where)
    if np.ptp(found.rows, axis=0).max() < 1e-9:
        raise ValueFault(
            "expected a path that moves, found one point; a point needs no design of a path", location=where
        )
    return found


def _table(file: Path, chain: SerialChain) -> PathFile:
    columns, where = read_table(file, chain.joint_names).columns, str(file)
    lower = {name.lower(): name for name in columns}
    time = next((lower[name] for name in TIMES if name in lower), None)
    if time is None:
        raise MissingError(f"expected a column t with the time [s], found {listed(list(columns))}", location=where)
    times = np.asarray(columns[time], dtype=float)
    if (joints := _joint_columns(columns, chain)) is not None:
        return PathFile(where, "joints", times - times[:1], joints)
    position = next((names for names in POSITION if all(name in lower for name in names)), None)
    if position is None:
        raise MissingError(
            f"expected columns {listed(list(chain.joint_names))} or q_1 to q_{chain.n} [rad] of the joints, or x, y, z "
            f"[m] of the tool, found {listed(list(columns))}",
            location=where,
        )
    rows = np.column_stack([columns[lower[name]] for name in position])
    for names in (*QUATERNION, *VECTOR):
        if all(name in lower for name in names):
            turn = np.column_stack([columns[lower[name]] for name in names])
            turn = _vectors(turn, where) if len(names) == 4 else turn
            return PathFile(where, "pose", times - times[:1], np.column_stack([rows, turn]))
    return PathFile(where, "position", times - times[:1], rows)


def _joint_columns(columns: Mapping[str, Array], chain: SerialChain) -> Array | None:
    """Positions of the joints, by their names or numbers; None without columns for all of them."""
    for names in _namings(columns, chain):
        if all(name in columns or f"{name}_deg" in columns for name in names):
            return np.column_stack(
                [columns[name] if name in columns else np.radians(columns[f"{name}_deg"]) for name in names]
            )
    return None


def _namings(columns: Mapping[str, Array], chain: SerialChain) -> Iterator[Sequence[str]]:
    yield chain.joint_names
    for stem in ("q_", "q", "q_d_", "actual_q_", "target_q_", "joint_", "joint"):
        for first in (1, 0):
            names = [f"{stem}{first + k}" for k in range(chain.n)]
            of_more = [name for name in columns if re.fullmatch(rf"{stem}(\d+)(_deg)?", name)]
            if len(of_more) == chain.n:
                yield names


def _vectors(quaternions: Array, where: str) -> Array:
    """Rotation vectors of quaternions (x, y, z, w), continuous from row to row [rad]."""
    from scipy.spatial.transform import Rotation

    lengths = np.linalg.norm(quaternions, axis=1)
    if np.any(np.abs(lengths - 1) > UNIT):
        row = int(np.argmax(np.abs(lengths - 1) > UNIT))
        raise ValueFault(
            f"expected quaternions of length 1, found a length of {lengths[row]:.3g} at point {row + 1}", location=where
        )
    return np.asarray(Rotation.from_quat(quaternions).as_rotvec())


def _trajectory(file: Path, chain: SerialChain) -> PathFile:
    where, data = str(file), _message(file)
    names, points = data.get("joint_names"), data.get("points")
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise ValueFault(
            "expected a trajectory_msgs/JointTrajectory with joint_names and points, found keys "
            f"{listed([str(key) for key in data]) or 'of none'}",
            location=where,
        )
    absent = [joint for joint in chain.joint_names if joint not in names]
    if absent:
        raise MissingError(
            f"joint_names: expected the joints of the robot, {listed(list(chain.joint_names))}; missing: "
            f"{listed(absent)}; found {listed([str(name) for name in names])}",
            location=where,
        )
    order = [names.index(joint) for joint in chain.joint_names]
    times = np.array([_duration(point, k, where) for k, point in enumerate(points, 1)])
    rows = {key: _rows(points, key, names, order, where) for key in ("positions", "velocities", "accelerations")}
    if rows["positions"] is None:
        raise MissingError("expected positions in each point, found none", location=where)
    others = [str(name) for name in names if name not in chain.joint_names]
    notes = (f"joints of the file that the arm does not have are ignored: {listed(others)}",) if others else ()
    if rows["velocities"] is None:
        rows["accelerations"] = None
    rates = rows["velocities"], rows["accelerations"]
    return PathFile(where, "joints", times - times[:1], rows["positions"], *rates, notes)


def _message(file: Path) -> dict[str, Any]:
    """The mapping of the trajectory; the first document of the file."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    where = str(file)
    try:
        if file.stat().st_size > LARGEST:
            raise ValueFault(f"expected at most {LARGEST >> 20} MiB, found more", location=where)
        found = next(iter(YAML(typ="safe").load_all(file.read_text(encoding="utf-8"))), None)
    except OSError as error:
        raise MissingError(f"expected a readable file: {error.strerror}", location=where) from None
    except (YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        reason = " ".join(str(getattr(error, "problem", "") or error).split())[:200]
        raise ValueFault(f"expected YAML or JSON with a JointTrajectory: {reason}", location=where) from None
    for _ in range(4):
        inner = next((found[key] for key in NESTED if isinstance(found, dict) and key in found), None)
        if inner is None:
            break
        found = inner
    if not isinstance(found, dict):
        raise ValueFault("expected a JointTrajectory, found no mapping", location=where)
    return found


def _duration(point: Any, k: int, where: str) -> float:
    """``time_from_start`` of a point [s], as ROS 1 and ROS 2 write it, or a number."""
    given = point.get("time_from_start") if isinstance(point, dict) else None
    if isinstance(given, dict):
        parts = [next((given[key] for key in keys if key in given), 0) for keys in DURATION]
        if all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts):
            return float(parts[0]) + 1e-9 * float(parts[1])
    elif isinstance(given, int | float) and not isinstance(given, bool):
        return float(given)
    raise ValueFault(f"points[{k}]: expected time_from_start with sec and nanosec, found {given!r}", location=where)


def _rows(points: list[Any], key: str, names: list[Any], order: list[int], where: str) -> Array | None:
    """Rows of a key in the order of the robot's joints; None if no point has them."""
    rows = [point.get(key) or [] for point in points]
    if not any(len(row) if isinstance(row, list) else 1 for row in rows):
        return None
    for k, row in enumerate(rows, 1):
        numbers = isinstance(row, list) and all(type(value) in (int, float) for value in row)
        if not numbers or len(row) != len(names):
            found = f"{len(row)} values" if isinstance(row, list) else repr(row)[:40]
            raise ValueFault(
                f"points[{k}].{key}: expected {len(names)} numbers, one a joint, found {found}", location=where
            )
    return np.array(rows, dtype=float)[:, order]
