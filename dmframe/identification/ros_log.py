"""Columns of a log from a ROS 2 bag (sqlite3 or mcap), with the library rosbags, without ROS.

Positions are those of ``sensor_msgs/JointState``; commands are those of a forward command controller
(``std_msgs/Float64MultiArray``, held until the next), or positions and references of a joint trajectory controller
(``control_msgs/JointTrajectoryControllerState``). A ``trajectory_msgs/JointTrajectory`` has only some points of the
command, between which the controller interpolates, and is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import MissingError, ValueFault, listed
from dmframe.common.version import installing
from dmframe.identification.log import Array

STATES: Final = "sensor_msgs/msg/JointState"
ARRAYS: Final = "std_msgs/msg/Float64MultiArray"
TRACKED: Final = "control_msgs/msg/JointTrajectoryControllerState"
NAME: Final = "joint_states"
"""Topic of the robot's own positions, if several have them."""
VARIED: Final = 1e-6
"""Range of a command that counts as varied [rad/s, rad]."""
REMEDY: Final = "convert the bag to a CSV file with columns t, q_1, ..., dq_c_1, ..."


@final
@dataclass
class _Topic:
    """Messages of a topic: instants of the bag and of the header [s], and rows by signal."""

    name: str
    kind: str
    at: list[float] = field(default_factory=list)
    stamp: list[float] = field(default_factory=list)
    rows: dict[str, list[Array]] = field(default_factory=dict)

    def add(self, at: int, message: Any, rows: dict[str, Array]) -> None:
        if not rows or (self.rows and set(rows) != set(self.rows)):
            return
        header = getattr(message, "header", None)
        self.at.append(1e-9 * at)
        self.stamp.append(np.nan if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec)
        for name, row in rows.items():
            self.rows.setdefault(name, []).append(row)

    @property
    def varies(self) -> bool:
        return any(np.ptp(rows, axis=0).max() > VARIED for rows in self.rows.values())

    @property
    def time(self) -> Array:
        """Header stamps if they are those of the bag's clock, but for a constant below a second; else its instants."""
        at, stamp = np.array(self.at), np.array(self.stamp)
        return stamp if np.all(np.abs(stamp - at) < 1) else at


def is_bag(path: Path) -> bool:
    """True for the folder or a file of a ROS 2 bag."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix in (".db3", ".mcap")


def bag_files(path: Path) -> list[Path]:
    """Files of a bag."""
    return sorted(path.iterdir()) if path.is_dir() else [path]


def bag_columns(path: Path, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Time, positions and commands of a bag by plain names, for joints by their names in the robot's file.

    Raises
    ------
    MissingError
        The package rosbags is not installed, or the bag lacks positions or commands of these joints.
    ValueFault
        The bag is damaged, or which topic is the command is not clear.
    """
    where = str(path)
    topics = _topics(path, joints)
    moved = [topic for topic in topics if topic.kind != "q" and topic.varies]
    tracked = [topic for topic in moved if "q" in topic.rows]
    if len(moved) > 1:
        raise ValueFault(
            f"expected commands in one topic, found {listed([topic.name for topic in moved])}; {REMEDY}", location=where
        )
    if not moved:
        raise MissingError(
            f"expected varying commands of {len(joints)} joints: std_msgs/Float64MultiArray of a forward velocity or "
            "position controller, or control_msgs/JointTrajectoryControllerState with the joints' names; record such a "
            f"topic, or {REMEDY}",
            location=where,
        )
    if tracked:
        rows = {name: np.array(own) for name, own in tracked[0].rows.items()}
        return _columns(tracked[0].time, rows)
    states = [topic for topic in topics if topic.kind == "q"]
    named = [topic for topic in states if topic.name.rpartition("/")[2] == NAME]
    if len(states) > 1 and len(named) != 1:
        raise ValueFault(
            f"expected positions in one topic, found {listed([topic.name for topic in states])}; {REMEDY}",
            location=where,
        )
    if not states:
        raise MissingError(
            f"expected a topic sensor_msgs/JointState with positions of {listed(list(joints))}, found none; {REMEDY}",
            location=where,
        )
    return _held((named or states)[0], moved[0])


def _held(positions: _Topic, commands: _Topic) -> dict[str, np.ndarray]:
    """Positions, and at each the last command before it; velocity commands are zero before the first."""
    time, (name, rows) = positions.time, next(iter(commands.rows.items()))
    own = np.array(rows)
    # a position command is unknown before the first one
    known = np.searchsorted(np.array(commands.at), time, side="right") - 1
    used = slice(None) if name == "dq_c" else known >= 0
    held = np.where(known[:, None] >= 0, own[np.maximum(known, 0)], 0.0)
    return _columns(time[used], {"q": np.array(positions.rows["q"])[used], name: held[used]})


def _columns(time: Array, rows: dict[str, Array]) -> dict[str, np.ndarray]:
    found = {"t": time - time[0] if len(time) else time}
    for stem, own in rows.items():
        found |= {f"{stem}_{j}": own[:, j - 1] for j in range(1, own.shape[1] + 1)}
    return found


def _topics(path: Path, joints: Sequence[str]) -> list[_Topic]:
    """Topics with positions or commands of all the joints."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingError(
            f"reading a ROS bag needs the package rosbags, which is not installed; {installing('ros')}",
            location=str(path),
        ) from None
    found = dict[str, _Topic]()
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            readers = {STATES: _of_state, ARRAYS: _of_array, TRACKED: _of_tracked}
            wanted = [connection for connection in reader.connections if connection.msgtype in readers]
            for connection, at, raw in reader.messages(connections=wanted) if wanted else ():
                message = reader.deserialize(raw, connection.msgtype)
                name, read = connection.topic, readers[connection.msgtype]
                topic = found.setdefault(name, _Topic(name, "q" if connection.msgtype == STATES else "command"))
                topic.add(at, message, read(message, name, joints))
    except (AnyReaderError, OSError, ValueError, KeyError, AssertionError) as error:
        raise ValueFault(f"expected a ROS 2 bag: {error}", location=str(path)) from None
    return [topic for topic in found.values() if topic.at]


_Read = Callable[[Any, str, Sequence[str]], dict[str, Array]]


def _of_state(message: Any, topic: str, joints: Sequence[str]) -> dict[str, Array]:
    return _by_name(message.name, {"q": message.position}, joints)


def _of_array(message: Any, topic: str, joints: Sequence[str]) -> dict[str, Array]:
    """Commands without names: in the order of the controller's joints, which is that of the robot's file."""
    row, stem = np.asarray(message.data, dtype=float), {"velocity": "dq_c", "position": "q_c"}
    named = [name for word, name in stem.items() if word in topic]
    return {named[0]: row} if len(named) == 1 and len(row) == len(joints) else {}


def _of_tracked(message: Any, topic: str, joints: Sequence[str]) -> dict[str, Array]:
    """Positions and references; before ROS 2 Iron they are called actual and desired."""
    old = hasattr(message, "desired") and not len(getattr(getattr(message, "reference", None), "positions", ()))
    goal, actual = (message.desired, message.actual) if old else (message.reference, message.feedback)
    given = {"q": actual.positions, "q_c": goal.positions}
    if len(goal.velocities):
        given["dq_c"] = goal.velocities
    return _by_name(message.joint_names, given, joints)


def _by_name(names: Sequence[str], given: dict[str, Any], joints: Sequence[str]) -> dict[str, Array]:
    """Rows in the order of `joints`; none for a message without all of them, as of a gripper."""
    if not set(joints) <= set(names) or any(len(row) != len(names) for row in given.values()):
        return {}
    order = [list(names).index(joint) for joint in joints]
    return {stem: np.asarray(row, dtype=float)[order] for stem, row in given.items()}
