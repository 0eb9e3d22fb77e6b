"""Which meshes a page draws for a robot, and when it draws tubes instead."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.page.scene import meshes_of
from dmframe.robot.chain import SerialChain

CUBE = np.array([[x, y, z] for x in (0.0, 0.2) for y in (0.0, 0.2) for z in (0.0, 0.2)])
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LIMIT = '<limit lower="-3" upper="3" velocity="3" effort="100"/>'


def robot(folder: Path, shapes: tuple[str, str], kind: str = "revolute") -> Path:
    """A robot file with two links with the given collision shapes."""
    text = '<robot name="made"><link name="base"/>'
    for k, shape in enumerate(shapes):
        before, x = ("base", 0) if k == 0 else ("link0", 0.3)
        text += (
            f'<link name="link{k}"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>{INERTIA}</inertial>'
            f'<collision><geometry>{shape}</geometry></collision></link><joint name="j{k}" type="{kind}">'
            f'<parent link="{before}"/><child link="link{k}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
        )
    path = folder / "made.urdf"
    path.write_text(f"{text}</robot>")
    return path


def mesh(folder: Path, corners: np.ndarray, name: str = "mesh") -> str:
    """A file of triangles, as referenced by a robot file."""
    triangles = [struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in FACES]
    (folder / f"{name}.stl").write_bytes(bytes(80) + struct.pack("<I", len(triangles)) + b"".join(triangles))
    return f'<mesh filename="{name}.stl"/>'


def drawn(path: Path, **options: Any) -> list[dict[str, Any]]:
    chain = SerialChain.from_urdf(path, tool=(0.3, 0.0, 0.0), axes="xy", **options)
    return meshes_of(chain, path, dict(options.get("hold", {})))


def test_meshes_of_all_joints_are_drawn(tmp_path):
    cube = mesh(tmp_path, CUBE)
    assert [(found["joint"], found["faces"]) for found in drawn(robot(tmp_path, (cube, cube)))] == [(0, 6), (1, 6)]


def test_a_fixed_joint_with_a_mimic_does_not_move(tmp_path):
    """As in the gripper of talos_left_arm.urdf of example-robot-data."""
    cube = mesh(tmp_path, CUBE)
    path = robot(tmp_path, (cube, cube))
    finger = (
        '<link name="finger"/><joint name="f" type="fixed"><parent link="link1"/><child link="finger"/>'
        '<mimic joint="j1" multiplier="-1" offset="0.5"/></joint></robot>'
    )
    path.write_text(path.read_text().replace("</robot>", finger))
    assert [(found["joint"], found["faces"]) for found in drawn(path)] == [(0, 6), (1, 6)]


@pytest.mark.parametrize("wrong", [1000.0, 0.001, np.nan, np.inf], ids=["millimetres", "kilometres", "nan", "inf"])
def test_a_mesh_of_another_unit_or_without_numbers_is_not_drawn(tmp_path, wrong):
    cube = mesh(tmp_path, CUBE * wrong if np.isfinite(wrong) else np.where(CUBE > 0, wrong, CUBE))
    assert drawn(robot(tmp_path, (cube, cube))) == []


@pytest.mark.parametrize("content", [b"", b"not a mesh", bytes(84)])
def test_a_mesh_that_is_broken_is_not_drawn(tmp_path, content):
    cube = mesh(tmp_path, CUBE)
    (tmp_path / "mesh.stl").write_bytes(content)
    assert drawn(robot(tmp_path, (cube, cube))) == []


def test_a_robot_of_which_meshes_show_a_part_alone_is_drawn_as_tubes(tmp_path):
    assert drawn(robot(tmp_path, (mesh(tmp_path, CUBE), '<box size="0.1 0.1 0.1"/>'))) == []


def test_what_hangs_on_a_held_joint_without_limits_keeps_its_form_and_is_turned(tmp_path):
    cube = mesh(tmp_path, CUBE)
    path = robot(tmp_path, (cube, cube), "continuous")
    base, _ = drawn(path, free=["j1"], hold={"j0": math.radians(30)})
    wide = 0.2 * (math.cos(math.radians(30)) + math.sin(math.radians(30)))
    np.testing.assert_allclose(np.subtract(base["high"], base["low"]), [wide, wide, 0.2], atol=1e-6)
