"""The proposed excitation respects its limits, is the same in all files, and determines the servo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from virtual_robots import robot, runs

import dmframe as dm
from dmframe.common.errors import DmframeError, OutputError
from dmframe.identification.excitation import Excitation, Room, excitation
from dmframe.identification.joint_box import Obstacles
from dmframe.identification.subject import subject_of
from tests.framework.identify.plants import START, Hidden, record, write

N = 4


def plan(reach: float, acceleration: float, seconds: float, seed: int) -> tuple[Room, Excitation]:
    start = np.arange(N) / 3
    room = Room(start, start - reach, start + reach / 2, np.full(N, 0.4), np.full(N, acceleration))
    return room, excitation(room, 0.008, seconds, seed)


@pytest.mark.parametrize("acceleration", [np.inf, 2.0, 0.3])
@pytest.mark.parametrize("reach", [0.3, 0.03])
@pytest.mark.parametrize("seconds", [6.0, 20.0, 30.0])
def test_steps_stay_in_the_box_and_begin_and_end_at_rest_at_the_start(
    acceleration: float, reach: float, seconds: float
) -> None:
    for seed in range(5):
        room, found = plan(reach, acceleration, seconds, seed)
        q, u = room.start + np.vstack([np.zeros(N), np.cumsum(0.008 * found.dq_c[:-1], axis=0)]), found.dq_c
        assert len(u) == round(seconds / 0.008)
        assert np.all((q >= room.lower - 1e-9) & (q <= room.upper + 1e-9))
        assert q[-1] == pytest.approx(room.start, abs=1e-9)
        assert np.all(np.abs(u[:60]) < 1e-12)
        assert np.all(np.abs(u[-60:]) < 1e-12)
        assert np.max(np.abs(u)) <= 0.4 + 1e-12
        assert np.max(np.abs(np.diff(u, axis=0))) <= 0.008 * acceleration + 1e-9
        assert np.all(u.max(0) > 0)
        assert np.all(u.min(0) < 0)


def test_joints_do_not_move_in_step() -> None:
    _, found = plan(0.3, np.inf, 20.0, 0)
    changes = [set(np.flatnonzero(np.diff(column))) for column in found.dq_c.T]
    assert all(len(own) > 20 for own in changes)
    assert len(set.union(*changes)) > 0.9 * sum(map(len, changes))


def test_the_files_state_one_motion_and_the_virtual_robot_moves_along_the_script(tmp_path: Path) -> None:
    found = dm.experiment("ur10_slow", out=tmp_path, period=0.008, seconds=6)
    table = np.genfromtxt(tmp_path / "experiment.csv", delimiter=",", names=True)
    commands = np.column_stack([table[f"dq_c_{j}"] for j in (1, 2, 3)])
    graph = dm.load(tmp_path / "experiment.yaml")
    driven = graph.drive("sim").recording
    assert np.max(np.abs(driven["inverse.dq_c"][: len(commands)] - commands)) < 1e-8
    held = runs(robot("ur10_slow", series="cb3"), (tmp_path / "experiment.script").read_text())
    assert "its last line is done" in held.messages[-1]
    assert held.target.q[:3] == pytest.approx(found.room.start, abs=1e-5)
    assert held.target.q[3:] == pytest.approx([0, -np.pi / 2, 0], abs=1e-9)  # held joints of the graph


def test_the_path_of_a_ur10_is_free_of_collisions_by_distances(tmp_path: Path) -> None:
    found = dm.experiment("ur10_slow", seconds=6)
    source = subject_of("ur10")
    chain, q = source.chain, source.spread(source.start[None])[0]
    obstacles = Obstacles(chain, source.shapes, None)
    shapes, data = obstacles.geometry, pin.GeometryData(obstacles.geometry)
    for row in found.plan.q_c[::10]:
        q[:3], q[3:] = row, [0, -np.pi / 2, 0]
        pin.computeDistances(chain.model, obstacles.data, shapes, data, q)
        for pair, result in zip(shapes.collisionPairs, data.distanceResults, strict=True):
            joints = [shapes.geometryObjects[i].parentJoint for i in (pair.first, pair.second)]
            if min(joints) < 3 < max(joints) or max(joints) <= 3:  # the fixed wrist is one body with the forearm
                assert result.min_distance > 0


def test_a_start_in_collision_and_a_floor_are_refused() -> None:
    folded = "ur10"
    with pytest.raises(DmframeError, match=r"the robot collides there \(.*link and .*link\)"):
        dm.experiment(folded, start=[0, -1, 3.0, 0, 0, 0])
    with pytest.raises(DmframeError, match=r"collides there \(the floor\)"):
        dm.experiment("ur10_slow", floor=0.9)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"period": 0}, "period: expected 0.0005 to 0.05 s, found 0"),
        ({"period": float("nan")}, "period: expected 0.0005 to 0.05 s, found nan"),
        ({"seed": -1}, "seed: expected a whole number of 0 or above, found -1"),
        ({"seconds": 31}, "seconds: expected 6 to 30 s, found 31"),
        ({"start": [0, 0]}, "start: expected 3 finite joint positions"),
        ({"start": [0, float("nan"), 0]}, "start: expected 3 finite joint positions"),
        ({"start": [9, 0, 0]}, "outside its limits"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, object], text: str) -> None:
    with pytest.raises(DmframeError, match=text):
        dm.experiment("ur10_slow", **options)  # type: ignore[arg-type]


def test_an_unknown_robot_is_refused() -> None:
    with pytest.raises(DmframeError, match="ur11: unknown graph or robot"):
        dm.experiment("ur11")


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "e").write_text("a file")
    with pytest.raises(OutputError):
        dm.experiment("pendulum", out=tmp_path / "e", seconds=6)
    assert [path.name for path in tmp_path.iterdir()] == ["e"]


def test_a_robot_without_a_servo_of_velocities_gets_no_graph(tmp_path: Path) -> None:
    found = dm.experiment("pd_torque", out=tmp_path, seconds=6)
    assert any("no experiment.yaml: pd_torque has no servo that takes joint vel" in text for text in found.notices)
    assert not (tmp_path / "experiment.yaml").exists()


LIMITS = """
dmframe-limits: 1
speed: 0.2
acceleration: 1 rad/s^2
"""


def test_limits_of_speed_and_acceleration_hold_for_the_driven_commands(tmp_path: Path) -> None:
    (tmp_path / "limits.yaml").write_text(LIMITS)
    made = dm.experiment("pendulum", out=tmp_path, limits=tmp_path / "limits.yaml", seconds=8)
    driven = dm.load(tmp_path / "experiment.yaml").drive("sim", limits=tmp_path / "limits.yaml")
    sent = driven.recording.beside["robot.sent"].values
    assert 0.05 < np.max(np.abs(sent)) <= 0.1 + 1e-12
    assert np.max(np.abs(np.diff(sent, axis=0))) <= 0.008 * 1.0 + 1e-9
    assert not [text for text in driven.recording.notices if "gate limited" in text]
    assert np.max(np.abs(sent[: made.plan.count] - made.plan.dq_c)) < 1e-9


ARM = """<robot name="slide">
<link name="base"/>
{links}
</robot>"""
LINK = """<link name="l{k}"><inertial><mass value="{m}"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{k}" type="{kind}"><parent link="{parent}"/><child link="l{k}"/><origin xyz="0 0 0.2"/>
<axis xyz="{axis}"/>{limit}</joint>"""


def test_seven_joints_without_limits_and_a_prismatic_one_get_a_box_of_their_own(tmp_path: Path) -> None:
    kinds = ["continuous", "prismatic", *["continuous"] * 5]
    links = "".join(
        LINK.format(
            k=k,
            m=3 - 0.3 * k,
            kind=kind,
            parent=f"l{k - 1}" if k else "base",
            axis=("0 0 1", "0 1 0", "1 0 0")[k % 3],
            limit='<limit lower="0" upper="0.5" velocity="0" effort="0"/>' if kind == "prismatic" else "",
        )
        for k, kind in enumerate(kinds)
    )
    file = tmp_path / "slide.urdf"
    file.write_text(ARM.format(links=links))
    found = dm.experiment(str(file), out=tmp_path / "e", seconds=6)
    assert np.all(np.abs(found.plan.q_c - found.room.start) <= np.array([0.3, 0.06, *[0.3] * 5]) + 1e-9)
    assert 0 < found.plan.q_c[:, 1].min() < found.plan.q_c[:, 1].max() < 0.5
    assert any("self-collision is not checked: the robot's file has no collision" in text for text in found.notices)
    assert not (tmp_path / "e" / "experiment.script").exists()
    assert dm.load(tmp_path / "e" / "experiment.yaml").diagram.robot.n == 7


def test_a_mesh_that_is_missing_is_named() -> None:
    source = subject_of("ur10")
    assert source.shapes is not None
    tree, folder = source.shapes
    assert not Obstacles(source.chain, (tree, folder), None).notes
    next(tree.iterfind(".//collision//mesh")).set("filename", "package://arm/meshes/link.stl")
    notes = Obstacles(source.chain, (tree, folder), None).notes
    assert notes == ["self-collision is not checked: the mesh package://arm/meshes/link.stl was not found"]


def test_the_log_of_a_drive_determines_the_servo_and_the_delay(tmp_path: Path) -> None:
    dm.experiment("pendulum", out=tmp_path / "e", seconds=8)
    graph = tmp_path / "e" / "experiment.yaml"
    dm.load(graph).drive("sim:2").save(tmp_path / "log")
    check_servo(tmp_path / "log", graph, 2)


def test_the_log_of_a_driven_ur10_determines_its_servo_and_the_delay(tmp_path: Path) -> None:
    dm.experiment("ur10_slow", out=tmp_path / "e")
    graph = tmp_path / "e" / "experiment.yaml"
    dm.load(graph).drive("sim:1").save(tmp_path / "log")
    check_servo(tmp_path / "log", graph, 1)


def check_servo(log: Path, graph: Path, delay: int) -> None:
    values = {leaf.label: np.asarray(leaf.value).ravel() for leaf in dm.load(graph).diagram.loop.parameters}
    found = dm.identify(log, str(graph))
    assert found.kind == "pid"
    assert found.servo["k_P"][0] == pytest.approx(values["servo.K_P"] / values["servo.K_D"], rel=0.005)
    assert found.servo["k_I"][0] == pytest.approx(values["servo.K_I"] / values["servo.K_D"], rel=0.005)
    assert found.delay[0] == pytest.approx(delay, abs=0.01)


def test_the_prediction_agrees_with_the_intervals_of_a_hidden_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = dm.experiment("ur10_slow", period=0.008, start=START)
    monkeypatch.setattr("tests.framework.identify.plants.steps", lambda *_: made.plan.dq_c)
    k_P, k_I = np.full(3, 5.0), np.full(3, 4.0)
    found = dm.identify(write(tmp_path / "log.csv", *record(Hidden(k_P, k_P, k_I))), "ur10_slow")
    between = found.servo["k_P"][1]
    assert np.all((between[:, 0] <= k_P) & (k_P <= between[:, 1]))
    half = (between[:, 1] - between[:, 0]) / 2 / k_P
    assert np.all((half < 4 * made.predicted.k_P) & (half > made.predicted.k_P / 4))
