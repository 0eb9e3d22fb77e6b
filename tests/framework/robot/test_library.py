from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from dmframe.common.errors import DmframeError, MissingError, RobotError, UnknownNameError, ValueFault
from dmframe.robot import library
from dmframe.robot.library import find_robot, load, robots, robots_in

MODEL = Path(find_robot("arm2").urdf)


def write_robot(folder, name, text, model=True):
    place = folder / name
    place.mkdir(parents=True)
    (place / "robot.toml").write_text(text)
    if model:
        shutil.copy(MODEL, place / "arm2.urdf")
    return place


GOOD = 'description = "an arm"\nurdf = "arm2.urdf"\ntool = "tool"\naxes = "xz"\n'


def test_packaged_robots_are_found_through_their_entry_point():
    assert {"arm2", "arm3", "fr3", "gen3", "iiwa14", "panda", "pendulum", "so101", "ur10", "ur10e", "z1"} <= set(
        robots()
    )
    assert list(robots()) == sorted(robots())


def test_a_source_states_its_defaults():
    source = find_robot("panda")
    assert (source.tool, source.axes, source.free) == ("panda_hand_tcp", "xyz", None)
    assert source.hold == {"panda_finger_joint1": 0.0}
    assert source.description
    assert source.urdf.is_file()


@pytest.mark.parametrize("name", ["ur11", "ur20", "panda2"])
def test_an_unknown_robot_is_never_taken_for_the_spelling_of_another_one(name):
    with pytest.raises(UnknownNameError) as caught:
        find_robot(name)
    assert str(caught.value) == f"robot {name}: unknown robot; choose from {', '.join(robots())}"
    assert caught.value.path == ("robot", "model")


def test_letters_of_another_case_and_a_graph_have_a_hint() -> None:
    with pytest.raises(UnknownNameError, match=r"robot UR10: unknown robot; did you mean ur10\?$"):
        find_robot("UR10")
    with pytest.raises(ValueFault, match=r"robot mine\.yaml: expected the name or the file of a robot, found a graph"):
        find_robot("mine.yaml")


def test_a_path_is_relative_to_the_graph_before_the_current_folder(tmp_path, monkeypatch):
    here, graphs = tmp_path / "here", tmp_path / "graphs"
    for folder in (here, graphs):
        folder.mkdir()
        shutil.copy(MODEL, folder / "mine.urdf")
    shutil.copy(MODEL, here / "only_here.urdf")
    monkeypatch.chdir(here)
    assert find_robot("mine.urdf", graphs).urdf == graphs / "mine.urdf"
    assert find_robot("only_here.urdf", graphs).urdf == Path("only_here.urdf")
    assert load("mine.urdf", base=graphs, axes="xz").name == "mine"


def test_a_path_to_nowhere_is_reported():
    with pytest.raises(MissingError, match=r"robot nowhere\.urdf: expected a URDF file, found none at nowhere\.urdf"):
        load("nowhere.urdf")


def test_what_a_graph_gives_goes_before_the_defaults():
    chain = load("arm2", tool=(0.1, 0.0, 0.0), axes="z", free=["joint2"], friction_velocity=0.1)
    assert (chain.joint_names, chain.axes, chain.friction_velocity) == (("joint2",), "z", 0.1)
    assert chain.name == "arm2"


def test_a_graphs_hold_extends_the_robots_own():
    assert load("panda", hold={"panda_joint3": 0.5}).n == 6
    assert load("z1", free=["joint1", "jointGripper"], tool="gripperMover").joint_names == ("joint1", "jointGripper")


def test_a_held_joint_is_no_longer_free_by_default(tmp_path, monkeypatch):
    write_robot(tmp_path, "mine", GOOD + 'free = ["joint1", "joint2"]\n')
    monkeypatch.setattr(library, "robots", lambda: {source.name: source for source in robots_in(tmp_path)})
    assert load("mine").n == 2
    assert load("mine", hold={"joint1": 0.2}).joint_names == ("joint2",)


def test_without_pinocchio_a_robot_names_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(MissingError, match=r"ur10\.urdf: robots need the package pin \(Pinocchio\), which is not"):
        load("ur10")
    assert find_robot("ur10").urdf.is_file()


class Entry:
    def __init__(self, value):
        self.value = value


def test_a_registered_package_that_is_not_there_is_reported(monkeypatch):
    monkeypatch.setattr(library, "_points", lambda path: [Entry("no_such_package")])
    with pytest.raises(RobotError, match="robots of no_such_package: expected an installed package, found none"):
        robots()


def test_two_robots_of_one_name_are_refused(tmp_path, monkeypatch):
    for package in ("first_robots", "second_robots"):
        write_robot(tmp_path / package, "mine", GOOD)
        (tmp_path / package / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(library, "_points", lambda path: [Entry("first_robots"), Entry("second_robots")])
    with pytest.raises(RobotError, match=r"mine: defined twice, in .*first_robots.mine and .*second_robots.mine"):
        robots()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("description = ", "robot mine: robot.toml: expected a readable TOML file: "),
        ('urdf = "arm2.urdf"\n', "robot mine: robot.toml: expected a text as description, found None"),
        ('description = "an arm"\n', "robot mine: robot.toml: expected a text as urdf, found None"),
        (GOOD + "frame = 1\n", "robot mine: robot.toml: frame: unknown key; "),
        (GOOD + 'hold = "joint1"\n', "robot mine: robot.toml: expected hold as a table of joint = angle in rad, found"),
        (GOOD + "free = 1\n", "robot mine: robot.toml: expected free as a list of joint names, found 1"),
    ],
)
def test_a_bad_robot_file_is_reported_with_its_robot(tmp_path, text, reason):
    write_robot(tmp_path, "mine", text, model=False)
    with pytest.raises(DmframeError) as caught:
        robots_in(tmp_path)
    assert str(caught.value).startswith(reason)
