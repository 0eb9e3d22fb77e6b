"""A race on a planar arm, whose two laws differ in numbers only and share machine code."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from dmframe.race.plan import Race
from dmframe.race.read import load_race
from dmframe.race.run import Finished, run_race
from dmframe.study.executor import InProcess

LAW = """\
dmframe: 1
robot: arm2
clock: 4 ms
duration: 1 s
start: {near: [0.5, 0.5]}
blocks:
  path:     {type: circle, center: [0.5, 0.3], radius: 0.1, rate: 1 rad/s}
  geometry: {type: kinematics}
  task:     {type: known_tracking, gamma: 4}
  inverse:  {type: kinematic_command}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator}
"""

RACE = """\
dmframe-race: 1
title: A planar arm
robot: arm2
start: {near: [0.5, 0.5]}
duration: 0.8 s
entrant: tuned
clocks: [20 ms]
plants:
  first:  {servo: {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}, arm: {type: manipulator}}
  second: {servo: {type: pi_servo, K_P: [90, 45], K_I: [360, 180]}, arm: {type: manipulator}}
paths:
  circle: {type: epicycles, center: [0.5, 0.3], radius: [0.1], rate: [2], phase: [0]}
  other:  {type: epicycles, center: [0.5, 0.3], radius: [0.08], rate: [-3], phase: [1]}
realities: {ideal: {}}
laws:
  tuned: {graph: law.yaml, tune: {task.gamma: {per_clock: [0.02, 2]}}}
  weak:  {graph: law.yaml, tune: {task.gamma: [1, 4]}}
training: {plants: first, paths: circle, realities: ideal}
budget: 4
"""

Make = Callable[..., Race]


def made(folder: Path, *changes: tuple[str, str]) -> Race:
    """The race with replaced parts of its text, in a folder with its law."""
    text = RACE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "small.yaml").write_text(text, encoding="utf-8")
    if not (folder / "law.yaml").exists():
        (folder / "law.yaml").write_text(LAW, encoding="utf-8")
    return load_race(folder / "small.yaml")


@pytest.fixture
def race(tmp_path: Path) -> Make:
    """Makes the race with replaced parts of its text."""
    return partial(made, tmp_path)


@pytest.fixture(scope="session")
def done(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The unchanged race, run once."""
    folder = tmp_path_factory.mktemp("race")
    return run_race(made(folder), folder / "out", executor=InProcess)


@pytest.fixture
def out(done: Finished, tmp_path: Path) -> Path:
    """A copy of its results."""
    return Path(shutil.copytree(done.folder, tmp_path / "out"))
