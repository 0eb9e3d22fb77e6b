"""A planar arm, small and fast, and studies of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dmframe.common import plotting
from dmframe.study import execute, report, tune_page
from dmframe.study.execute import State, run_study
from dmframe.study.executor import InProcess
from dmframe.study.plan import Study
from dmframe.study.read import load_study

ARM = """\
dmframe: 1
title: A planar arm
robot: arm2
clock: 4 ms
duration: 1 s
start: {near: [0.5, 0.5]}
blocks:
  path:     {type: circle, center: [0.5, 0.3], radius: 0.1, rate: 1 rad/s}
  geometry: {type: kinematics}
  task:     {type: known_tracking, gamma: 0.8}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5]}
"""

Make = Callable[..., Study]


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM, encoding="utf-8")
    return path


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies run in this process."""
    monkeypatch.setattr(execute, "Pool", lambda study, workers: InProcess(study))


@pytest.fixture
def finish() -> Callable[..., State]:
    """Continue a study in this process, for any executor with which it began."""

    def finished(study: Any, out: Path) -> State:
        return run_study(study, out, executor=InProcess(study))

    return finished


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made but not drawn, which takes most of a report's time: for tests that read only the words."""
    without_drawing(monkeypatch)


@pytest.fixture(scope="module")
def undrawn_page() -> Callable[[Callable[[], Path]], Path]:
    """The same for one page that several tests read."""

    def made(page: Callable[[], Path]) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            without_drawing(patch)
            return page()

    return made


def without_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    def files_of(figure: object, name: str, about: str) -> dict[str, bytes]:
        return {f"{name}.svg": b"<svg></svg>"}

    monkeypatch.setattr(plotting, "settle", lambda figure: None)
    for module in (plotting, report):
        monkeypatch.setattr(module, "files_of", files_of)
    monkeypatch.setattr(tune_page, "figure_svg", lambda figure: "<svg></svg>")


@pytest.fixture
def study(arm: Path) -> Make:
    """Makes a study of the arm from the text below its first two lines."""

    def make(text: str, **options: Any) -> Study:
        file = arm.with_name("study.yaml")
        file.write_text(f"dmframe-study: 1\ngraph: arm.yaml\n{text}", encoding="utf-8")
        return load_study(file, **options)

    return make
