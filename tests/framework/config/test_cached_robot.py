"""The cache of robots' chains, with all their inputs as the key."""

from __future__ import annotations

import importlib.util
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
import dmframe_plants
from dmframe.common.errors import MissingError, RobotError
from dmframe.config import cached_robot as module
from dmframe.config.cached_robot import cached_robot
from dmframe.remembered import recorder
from dmframe.remembered.front import Call
from dmframe.robot.library import load, robots


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """An empty cache, and the robots that were read from their files."""
    found = list[str]()

    def reading(name: str, **given: Any) -> Any:
        found.append(name)
        return load(name, **given)

    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "load", reading)
    return found


def test_each_packaged_robot_is_recalled_as_it_was_read(reads: list[str]) -> None:
    for name in robots():
        read = cached_robot(name, Path())
        again = cached_robot(name, Path())
        assert again == read
        assert hash(again) == hash(read)
        assert repr(again) == repr(read)
        assert "model" not in vars(again)
    assert reads == list(robots())
    last = cached_robot(name, Path())
    assert (last.model_tool, last.model.njoints) == (read.model_tool, read.model.njoints)
    assert reads == [*robots(), name]  # for the model
    with pytest.raises(AttributeError, match="no attribute 'mode'"):
        _ = last.mode


def test_a_loop_of_a_recalled_robot_is_built_without_its_file(reads: list[str]) -> None:
    for _ in range(2):
        loop = dm.load("pendulum").diagram.loop
    assert loop.state.numel() > 0
    assert reads == ["pendulum"]


def test_a_recalled_robot_is_pickled_with_the_way_to_its_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path / "cache"))
    read, recalled = cached_robot("arm2", Path()), cached_robot("arm2", Path())
    again = pickle.loads(pickle.dumps(recalled))
    assert again == recalled == read
    assert again.model.njoints == read.model.njoints


def test_a_robot_is_read_again_after_a_change_of_an_input(
    reads: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    urdf = tmp_path / "mine.urdf"
    shutil.copy(Path(dmframe_plants.__path__[0]) / "arm2" / "arm2.urdf", urdf)

    def count(**given: Any) -> int:
        _ = cached_robot("mine.urdf", tmp_path, **given)
        return len(reads)

    assert [count(), count()] == [1, 1]
    assert count(axes="x") == count(axes="x") == 2
    urdf.write_text(urdf.read_text().replace("</robot>", "<!-- --></robot>"))
    assert count() == count() == 3
    other = tmp_path / "site"
    (other / "thing-1.dist-info").mkdir(parents=True)
    monkeypatch.setattr(sys, "path", [*sys.path, str(other)])
    assert count() == count() == 4
    (other / "thing-1.dist-info").rename(other / "thing-2.dist-info")
    assert count() == count() == 5
    monkeypatch.setattr(module.robot_package, "__path__", [str(tmp_path / "sources")])
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "chain.py").write_text("# read otherwise\n")
    assert count() == count() == 6


def test_a_file_that_changed_since_is_not_taken_for_the_model(reads: list[str], tmp_path: Path) -> None:
    urdf = tmp_path / "mine.urdf"
    shutil.copy(Path(dmframe_plants.__path__[0]) / "arm2" / "arm2.urdf", urdf)
    _ = cached_robot("mine.urdf", tmp_path)
    recalled = cached_robot("mine.urdf", tmp_path)
    urdf.write_text(urdf.read_text() + "\n")
    with pytest.raises(RobotError, match=r"mine.urdf: the file has changed since"):
        _ = recalled.model


def test_what_a_recalled_robot_was_made_from_is_an_input_of_a_verdict(reads: list[str], tmp_path: Path) -> None:
    _ = cached_robot("arm2", Path())
    watching = recorder.begin(Call("verify", ("x",)))
    try:
        _ = cached_robot("arm2", Path())
    finally:
        recorder.end()
    assert reads == ["arm2"]
    assert watching is not None
    names = list(watching.names())
    assert ("content", str(robots()["arm2"].urdf)) in names
    assert any(kind == "library" and "pinocchio" in name for kind, name in names)


def test_faults_are_those_of_reading(reads: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(MissingError, match="expected a URDF file, found none"):
        cached_robot("none.urdf", tmp_path)
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pinocchio" else find_spec(name))
    assert cached_robot("arm2", Path()) == cached_robot("arm2", Path())
    assert reads == ["none.urdf", "arm2", "arm2"]
