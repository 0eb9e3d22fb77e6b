"""Joints that follow another one, and units by the kind of joint."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.block.sizes import Sizes, parameter_arrays
from dmframe.catalogue import block_types
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, RobotError, ValueFault
from dmframe.common.units import Stated, joint_place, joint_quantity, of_sliding
from dmframe.diagram import Diagram
from dmframe.robot.chain import SerialChain


def _link(name: str, mass: float) -> str:
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


def _joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    limit = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="1 0 0"/>'
        f"{limit}{more}</joint>"
    )


MIMIC = '<mimic joint="lead" multiplier="-2" offset="0.1"/>'


def robot(folder: Path, mimic: str = MIMIC, second: str = "") -> Path:
    path = folder / "gripper.urdf"
    path.write_text(
        "<robot name='gripper'>"
        + _link("base", 1)
        + "".join(_link(name, 1) for name in ("arm", "left", "right", "third"))
        + _joint("turn", "revolute", "base", "arm").replace("1 0 0", "0 0 1")
        + _joint("lead", "prismatic", "arm", "left")
        + _joint("follow", "prismatic", "arm", "right", mimic)
        + _joint("last", "prismatic", "arm", "third", second)
        + "</robot>",
        encoding="utf-8",
    )
    return path


def masses_along_x(chain: SerialChain) -> float:
    """The sum of mass times position of all links that the one free joint moves."""
    inertia = chain.model.inertias[1]
    return float(inertia.mass * inertia.lever[0])


@pytest.mark.parametrize(
    ("hold", "expected"),
    [
        ({"lead": 0.3}, 0.3 + (0.1 - 0.6)),
        ({}, 0.1),
        ({"lead": 0.3, "follow": -0.5}, 0.3 - 0.5),
        ({"follow": 0.7}, 0.7),
        ({"lead": 0.3, "last": 0.2}, 0.3 - 0.5 + 0.2),
    ],
)
def test_a_joint_that_follows_is_where_its_leader_puts_it(
    hold: dict[str, float], expected: float, tmp_path: Path
) -> None:
    chain = SerialChain.from_urdf(robot(tmp_path), free=["turn"], hold=hold)
    assert masses_along_x(chain) == pytest.approx(expected)


def test_a_joint_may_follow_one_that_follows(tmp_path: Path) -> None:
    path = robot(tmp_path, second='<mimic joint="follow" multiplier="3" offset="1"/>')
    chain = SerialChain.from_urdf(path, free=["turn"], hold={"lead": 0.3})
    assert masses_along_x(chain) == pytest.approx(0.3 - 0.5 + (3 * -0.5 + 1))


@pytest.mark.parametrize(
    ("mimic", "second", "free", "hold", "text"),
    [
        (MIMIC, "", ["turn"], {"lead": 0.3, "follow": 0.3}, "follow follows lead: expected it held at -0.5, found 0.3"),
        (MIMIC, "", ["turn", "lead"], {}, "joint follow follows lead, which is free; hold lead, or follow"),
        ('<mimic joint="unknown"/>', "", ["turn"], {}, "joint follow mimics unknown: expected the name of a joint"),
        ('<mimic joint="last"/>', '<mimic joint="follow"/>', ["turn"], {}, "follows itself through"),
    ],
)
def test_what_no_law_puts_anywhere_is_refused(
    mimic: str, second: str, free: list[str], hold: dict[str, float], text: str, tmp_path: Path
) -> None:
    with pytest.raises(RobotError) as message:
        SerialChain.from_urdf(robot(tmp_path, mimic, second), free=free, hold=hold)
    assert text in str(message.value)


def graph(folder: Path, hold: str, start: str = "[0.2]", free: str = "[turn]") -> str:
    robot(folder)
    still = f"[{', '.join(['0.1'] * (free.count(',') + 1))}]"
    blocks = (
        f"{{path: {{type: sinusoid, center: {still}, amplitude: {still}, rate: {still}}}, "
        "task: {type: joint_tracking, alpha_bar: 2},\n"
        "  law: {type: kinematic_command}, servo: {type: pi_servo, K_P: 9, K_I: 9}, arm: {type: manipulator}}"
    )
    text = (
        "dmframe: 1\ntitle: gripper\nclock: 8 ms\nduration: 1 s\n"
        f"robot: {{model: gripper.urdf, free: {free}, hold: {hold}}}\nstart: {{q: {start}}}\nblocks: {blocks}\n"
    )
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(("hold", "expected"), [("{lead: 30 cm}", 0.3), ("{lead: 0.3 m}", 0.3), ("{lead: 0.3}", 0.3)])
def test_a_joint_that_slides_is_held_at_a_length(hold: str, expected: float, tmp_path: Path) -> None:
    loaded = dm.load(graph(tmp_path, hold))
    assert masses_along_x(loaded.robot) == pytest.approx(expected + 0.1 - 2 * expected)
    assert pickle.loads(pickle.dumps(loaded)).robot == loaded.robot
    run = loaded.run(0.02, progress=False)
    run.save(tmp_path / "kept")
    assert dm.load(tmp_path / "kept" / "graph.yaml").robot == loaded.robot


def test_a_unit_of_another_kind_of_joint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DmframeError, match=r"joint lead is prismatic: expected a length, as 0\.1 m; found 0\.5235"):
        dm.load(graph(tmp_path, "{lead: 30 deg}"))
    with pytest.raises(ValueFault, match=r"joint turn is revolute: expected an angle, as 30 deg; found 0\.1 m"):
        SerialChain.from_urdf(robot(tmp_path), free=["lead"], hold={"turn": Stated(0.1, "m"), "follow": 0.0})
    with pytest.raises(DmframeError, match="expected a quantity in rad"):
        dm.load(graph(tmp_path, "{lead: 3 kg}"))


def test_a_start_has_the_unit_of_its_joint(tmp_path: Path) -> None:
    both = "[turn, lead]"
    given = "{follow: 0 m}"
    assert dm.load(graph(tmp_path, "{lead: 0.1 m}", "[20 deg]")).run(0.02, progress=False)["arm.q"][0] == (
        pytest.approx(np.deg2rad(20))
    )
    run = dm.load(graph(tmp_path, given, "[20 deg, 30 cm]", both)).run(0.02, progress=False)
    np.testing.assert_allclose(run["arm.q"][0], [np.deg2rad(20), 0.3])
    with pytest.raises(DmframeError, match=r"start\.q: expected a number in m of lead, found 0\.34"):
        dm.load(graph(tmp_path, given, "[20 deg, 20 deg]", both)).run(0.02, progress=False)
    with pytest.raises(DmframeError, match=r"start\.q: expected a number in rad of turn, found 0\.3 m"):
        dm.load(graph(tmp_path, given, "[30 cm, 0]", both)).run(0.02, progress=False)


def test_the_option_takes_lengths_too(tmp_path: Path) -> None:
    words = ["regressor", str(robot(tmp_path)), "--free", "turn", "--hold", "lead=30 cm"]
    assert CliRunner().invoke(app, words).exit_code == 0
    message = CliRunner().invoke(app, [*words[:-1], "lead=30 deg"]).exception
    assert "joint lead is prismatic: expected a length" in str(message)


@pytest.mark.parametrize(
    ("value", "expected", "unit"),
    [("30 cm", 0.3, "m"), ("180 deg", np.pi, "rad"), ("0.5", 0.5, None), (0.5, 0.5, None), ("-1e-1 m", -0.1, "m")],
)
def test_a_place_keeps_the_unit_that_was_stated(value: str | float, expected: float, unit: str | None) -> None:
    found = joint_place(value)
    assert found == pytest.approx(expected)
    assert getattr(found, "unit", None) == unit
    again = pickle.loads(pickle.dumps(found))
    assert (again, getattr(again, "unit", None)) == (found, unit)


@pytest.mark.parametrize(
    ("posture", "fault"),
    [
        (["30 deg", "10 cm"], ""),
        ([0.5, 0.1], ""),
        (0.1, ""),
        (["30 deg", "30 deg"], "expected a quantity in m for lead: it slides; found 0.523599 rad"),
        (["10 cm", "10 cm"], "expected a quantity in rad for turn: it turns; found 0.1 m"),
        ("30 deg", "expected a quantity in m for lead: it slides; found 0.523599 rad"),
    ],
)
def test_a_posture_in_a_graph_has_the_unit_of_each_joint(posture: object, fault: str, tmp_path: Path) -> None:
    chain = SerialChain.from_urdf(robot(tmp_path, mimic=""), free=["turn", "lead"], tool="left")
    block = block_types()["null_space_posture"](K_null=1.0, q_0=posture)
    sizes = Sizes()
    sizes.bind("n", 2, "robot")
    arrays, faults = parameter_arrays("posture", block, sizes, robot=chain)
    assert [error.text for error in faults] == [f"posture.q_0: {fault}"] * bool(fault)
    if isinstance(posture, list) and not fault:
        np.testing.assert_allclose(arrays["q_0"], [np.pi / 6 if posture[0] == "30 deg" else 0.5, 0.1])


def test_rates_of_joints_have_the_unit_of_each_joint_and_other_quantities_one() -> None:
    assert of_sliding("rad/s^2") == "m/s^2"
    assert not of_sliding("rad^2")
    assert joint_quantity("3 cm/s", "rad/s") == pytest.approx(0.03)
    with pytest.raises(DmframeError, match="expected a quantity in 1/s"):
        block_types()["null_space_posture"](K_null="1 m", q_0=0.0)
    with pytest.raises(DmframeError, match=r"q_d: expected a quantity in rad for a revolute joint; found 0\.1 m"):
        Diagram.build({"posture": block_types()["setpoint"](q_d=["10 cm"])})
