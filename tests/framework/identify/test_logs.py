"""Logs of other programs: ROS 2 bags, recordings of ur_rtde, Parquet, results of a drive."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError, MissingError
from dmframe.identification.checked import checked_log
from dmframe.identification.columns import signals_of
from dmframe.identification.identify import chain_of
from dmframe.identification.log import Log
from dmframe.identification.table import read_table
from tests.framework.identify.plants import steps

T = 0.008
CHAIN = chain_of("ur10_slow")
JOINTS = CHAIN.joint_names


def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, positions and commands; positions lag by 24 ms."""
    u = steps(T, 10.0, 0)
    q = 1.0 + T * np.cumsum(np.vstack([np.zeros((3, 3)), u[:-3]]), axis=0)
    return T * np.arange(len(u)), q, u


def read(path: Path) -> Log:
    table = read_table(path, JOINTS)
    signals, _ = signals_of(table, 3)
    return checked_log(signals, CHAIN, table.name).log


def is_same(log: Log, tolerance: float = 1e-9) -> None:
    t, q, u = moved()
    first = len(t) - len(log.time)
    assert log.time == pytest.approx(t[first:] - t[first], abs=1e-6)
    assert log.q == pytest.approx(q[first:], abs=tolerance)
    assert log.u == pytest.approx(u[first:-1], abs=1e-6)


@pytest.mark.parametrize("velocities", [True, False])
def test_a_recording_of_ur_rtde_is_read_by_its_own_names(velocities: bool, tmp_path: Path) -> None:
    t, q, u = moved()
    q_c = 1.0 + T * np.vstack([np.zeros(3), np.cumsum(u[:-1], axis=0)])
    names = ["timestamp", *(f"actual_q_{j}" for j in range(3)), *(f"actual_qd_{j}" for j in range(3))]
    names += [f"target_q_{j}" for j in range(3)]
    rows = [1000.0 + t, q, np.gradient(q, T, axis=0), q_c]
    if velocities:
        names, rows = [*names, *(f"target_qd_{j}" for j in range(3))], [*rows, u]
    head = ",".join([*names, "actual_current_0"])
    np.savetxt(tmp_path / "r.csv", np.column_stack([*rows, 0 * t]), delimiter=",", header=head, comments="")
    log = read(tmp_path / "r.csv")
    assert log.u == pytest.approx(u[:-1], abs=1e-6)
    assert log.ahead == pytest.approx(0, abs=1e-9)


def test_a_parquet_file_is_the_csv_file(tmp_path: Path) -> None:
    polars = pytest.importorskip("polars")
    t, q, u = moved()
    columns = {"t": t} | {f"q_{j + 1}": q[:, j] for j in range(3)} | {f"dq_c_{j + 1}": u[:, j] for j in range(3)}
    polars.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    is_same(read(tmp_path / "log.parquet"))
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "log.parquet").read_bytes()[:500])
    with pytest.raises(DmframeError, match="expected a Parquet file of numbers"):
        read(tmp_path / "cut.parquet")
    polars.DataFrame(columns | {"note": ["a"] * len(t)}).write_parquet(tmp_path / "words.parquet")
    with pytest.raises(DmframeError, match="expected a Parquet file of numbers"):
        read(tmp_path / "words.parquet")


def test_the_results_of_a_drive_are_read_and_changed_ones_refused(tmp_path: Path) -> None:
    dm.experiment("pendulum", out=tmp_path, seconds=6)
    drive = dm.load(tmp_path / "experiment.yaml").drive("sim:2")
    drive.save(tmp_path / "log")
    for path in (tmp_path / "log", tmp_path / "log" / "signals.nc"):
        table = read_table(path, ("joint1",))
        assert list(table.columns) == ["t", "q_1", "dq_c_1"]
        assert table.columns["dq_c_1"] == pytest.approx(drive.recording.beside["robot.sent"].values[:, 0])
        assert table.columns["q_1"] == pytest.approx(drive.recording["arm.q"][:, 0])
    with (tmp_path / "log" / "signals.nc").open("r+b") as file:
        file.seek(3000)
        file.write(b"changed")
    with pytest.raises(MissingError, match="expected unchanged files"):
        read_table(tmp_path / "log", ("joint1",))
    with pytest.raises(MissingError, match="log file"):
        read_table(tmp_path, ("joint1",))


CONTROL = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
"""
SHUFFLED = [2, 0, 1]


class Bag:
    """A bag that is written with rosbags."""

    def __init__(self, path: Path, *, mcap: bool = False) -> None:
        rosbags = pytest.importorskip("rosbags.rosbag2")
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(CONTROL, "control_msgs/msg/JointTrajectoryControllerState"))
        plugin = rosbags.StoragePlugin.MCAP if mcap else rosbags.StoragePlugin.SQLITE3
        self.writer, self.links = rosbags.Writer(path, version=9, storage_plugin=plugin), dict[str, Any]()

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def put(self, topic: str, kind: str, at: float, **values: Any) -> None:
        if topic not in self.links:
            self.links[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        message = self.type(kind)(**values)
        self.writer.write(self.links[topic], round(1e9 * at), self.store.serialize_cdr(message, kind))

    def header(self, t: float) -> Any:
        stamp = self.type("builtin_interfaces/msg/Time")(int(t), round(1e9 * (t % 1)))
        return self.type("std_msgs/msg/Header")(stamp, "")

    def state(self, t: float, names: list[str], q: np.ndarray, topic: str = "/joint_states") -> None:
        empty = np.zeros(0)
        self.put(
            topic,
            "sensor_msgs/msg/JointState",
            t + 2e-4,
            header=self.header(t),
            name=names,
            position=q,
            velocity=empty,
            effort=empty,
        )

    def array(self, t: float, row: np.ndarray, topic: str = "/forward_velocity_controller/commands") -> None:
        layout = self.type("std_msgs/msg/MultiArrayLayout")([], 0)
        self.put(topic, "std_msgs/msg/Float64MultiArray", t, layout=layout, data=row)

    def tracked(self, t: float, names: list[str], goal: np.ndarray, q: np.ndarray) -> None:
        empty, zero = np.zeros(0), self.type("builtin_interfaces/msg/Duration")(0, 0)

        def point(row: np.ndarray) -> Any:
            return self.type("trajectory_msgs/msg/JointTrajectoryPoint")(row, empty, empty, empty, zero)

        self.put(
            "/scaled_joint_trajectory_controller/controller_state",
            "control_msgs/msg/JointTrajectoryControllerState",
            t + 1e-4,
            header=self.header(t),
            joint_names=names,
            reference=point(goal),
            feedback=point(q),
            error=point(empty),
            output=point(empty),
        )


def velocity_bag(path: Path, *, mcap: bool = False, more: Callable[[Bag, float], None] | None = None) -> Path:
    t, q, u = moved()
    names = [JOINTS[k] for k in SHUFFLED]
    with Bag(path, mcap=mcap) as bag:
        for k in range(len(t)):
            bag.state(100 + t[k], names, q[k][SHUFFLED])
            bag.state(100 + t[k] + 1e-3, ["finger_joint"], q[k][:1])  # a gripper on the same topic
            if k == 0 or np.any(u[k] != u[k - 1]):
                bag.array(100 + t[k] - 1e-4, u[k])
            if more is not None:
                more(bag, 100 + t[k])
    return path


@pytest.mark.parametrize("mcap", [False, True], ids=["sqlite3", "mcap"])
def test_a_bag_with_velocity_commands_is_read_by_the_names_of_joints(mcap: bool, tmp_path: Path) -> None:
    path = velocity_bag(tmp_path / "bag", mcap=mcap)
    is_same(read(path))
    if mcap:
        is_same(read(next(path.glob("*.mcap"))))
    else:
        is_same(read(next(path.glob("*.db3"))))


def test_a_bag_of_a_trajectory_controller_is_read_from_its_state(tmp_path: Path) -> None:
    t, q, u = moved()
    q_c = 1.0 + T * np.vstack([np.zeros(3), np.cumsum(u[:-1], axis=0)])
    with Bag(tmp_path / "bag") as bag:
        for k in range(len(t)):
            bag.tracked(100 + t[k], [JOINTS[j] for j in SHUFFLED], q_c[k][SHUFFLED], q[k][SHUFFLED])
            bag.state(100 + t[k], list(JOINTS), q[k])
    log = read(tmp_path / "bag")
    assert log.q == pytest.approx(q, abs=1e-12)
    assert log.u == pytest.approx(u[:-1], abs=1e-3)  # stamps have nanoseconds


def test_a_bag_without_a_clear_command_or_without_the_joints_is_refused(tmp_path: Path) -> None:
    def second(bag: Bag, t: float) -> None:
        bag.array(t, np.sin([t, 2 * t, 3 * t]), "/forward_position_controller/commands")

    with pytest.raises(DmframeError, match="expected commands in one topic, found /forward_velocity_controller/comm"):
        read(velocity_bag(tmp_path / "two", more=second))
    t, q, _ = moved()
    with Bag(tmp_path / "none") as bag:
        for k in range(300):
            bag.state(t[k], list(JOINTS), q[k])
    with pytest.raises(MissingError, match="expected varying commands of 3 joints"):
        read(tmp_path / "none")
    with Bag(tmp_path / "other") as bag:
        for k in range(300):
            bag.state(t[k], ["a", "b", "c"], q[k])
            bag.array(t[k], q[k])
    with pytest.raises(MissingError, match="expected a topic sensor_msgs/JointState with positions of shoulder_pan"):
        read(tmp_path / "other")


def test_a_damaged_bag_is_refused(tmp_path: Path) -> None:
    path = velocity_bag(tmp_path / "bag", mcap=True)
    file = next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(DmframeError, match="expected a ROS 2 bag"):
        read(path)
    (tmp_path / "x.db3").write_bytes(b"no bag")
    with pytest.raises(DmframeError, match="expected a ROS 2 bag"):
        read(tmp_path / "x.db3")


def test_without_rosbags_a_bag_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "metadata.yaml").write_text("")
    for name in ("rosbags", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingError, match=r'needs the package rosbags, .* pip install .*\[ros\]"'):
        read(tmp_path)
