"""The exported controller of ros2_control in a small manager, with stand-ins of ROS 2 that share no code with it.

``ROS2_CONTROL`` may name a checkout of ros2_control with fmt's headers next to it in ``fmt``: then the controller is
compiled against its real headers and base classes, and only the layer below them is replaced.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from xml.sax.saxutils import escape

import numpy as np
import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner

import dmframe as dm
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, EngineError
from dmframe.export.ros2 import _quoted, _read_as_xml, _read_back, package_of

CC, CXX = shutil.which("gcc"), shutil.which("g++")
needs_compilers = pytest.mark.skipif(CC is None or CXX is None, reason="needs gcc and g++")
STAND_INS = Path(__file__).parent / "ros2"
PLAIN = ("-ffp-contract=off", "-fno-tree-vectorize")
STRICT = (
    "-std=c++17",
    "-O0",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-pedantic",
    "-Wshadow",
    "-Wconversion",
    "-Werror",
)
NAME, SAMPLES, T = "ur10_fast", 1000, 0.008
PATH = 9  # x_d, its first and second derivative
FULL = ("interfaces.target=target",)


@cache
def package() -> Path:
    folder = Path(mkdtemp(prefix="ros2-")) / NAME
    dm.load(NAME).export(folder, "ros2")
    return folder


@cache
def manager(real: str) -> Path:
    """The program of manager and controller; `real` names a checkout of ros2_control, or nothing."""
    folder, place = package(), Path(mkdtemp(prefix="manager-"))
    law, program = place / "law.o", place / "manager"
    c_file = str(next(file for file in (folder / "src").glob("*.c")))
    subprocess.run([str(CC), "-std=c99", "-O0", *PLAIN, "-c", c_file, "-o", str(law)], check=True)
    below, sources = STAND_INS / "ros", ["src/controller.cpp", str(STAND_INS / "manager.cpp")]
    words = [*STRICT, f"-I{below}", f"-I{STAND_INS / 'control'}"]
    if real:
        base = Path(real)
        sources += [
            str(base / room / "src" / f"{name}.cpp")
            for room, name in (
                ("controller_interface", "chainable_controller_interface"),
                ("controller_interface", "controller_interface_base"),
                ("hardware_interface", "lexical_casts"),
            )
        ]
        own = [
            base / name / "include" for name in ("controller_interface", "hardware_interface", "joint_limits", "fmt")
        ]
        words = ["-std=c++17", "-O0", "-ffp-contract=off", "-Wall", "-Wextra", "-DFMT_HEADER_ONLY", f"-I{below}"]
        words += [f"-isystem{path}" for path in own]
    done = subprocess.run(
        [str(CXX), *words, "-Iinclude", "-Isrc", *sources, str(law), "-o", str(program)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:4000]
    ours = [line for line in done.stderr.splitlines() if "warning" in line and "src/controller.cpp" in line]
    assert not ours
    return program


class Answer:
    """The manager's output."""

    def __init__(self, done: subprocess.CompletedProcess[str], states: int) -> None:
        lines = done.stdout.splitlines()
        self.messages, self.status = done.stderr, done.returncode
        self.reference, self.states = lines[0], lines[1 : 1 + states]
        rows = [line.split() for line in lines[1 + states :]]
        self.results = [int(row[0]) for row in rows[:-1]]
        self.allocations = [int(row[1]) for row in rows[:-1]]
        self.commands = np.array([[float.fromhex(word) for word in row[2:]] for row in rows[:-1]])
        self.last = [float.fromhex(word) for word in rows[-1][1:]]


def answered(rows: np.ndarray, *words: str, rate: int = 125, real: str = "") -> Answer:
    text = "\n".join(" ".join(map(float.hex, map(float, row))) for row in rows)
    done = subprocess.run(
        [str(manager(real)), str(rate), *words], input=text, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return Answer(done, rows.shape[1] - 2 - PATH)


@cache
def run() -> tuple[np.ndarray, np.ndarray]:
    """Measurements and commands of a simulated robot."""
    found = dm.load(NAME).run(SAMPLES * T, engine="interpreted", progress=False).recording
    measured = np.hstack([found[label][:SAMPLES] for label in ("arm.q", "arm.dq", "servo.q_c")])
    return measured, found["inverse.dq_c"][:SAMPLES]


def rows_of(measured: np.ndarray, pace: float = -1.0, periods: float = 1.0) -> np.ndarray:
    before = np.tile([periods * T, pace, *[np.nan] * PATH], (len(measured), 1))
    return np.hstack([before, measured])


@needs_compilers
def test_it_commands_what_a_simulation_does_over_1000_updates_and_allocates_no_memory() -> None:
    measured, commanded = run()
    found = answered(rows_of(measured), *FULL)
    assert found.results == [0] * SAMPLES
    # only the tool position comes from another expression: of the lengths, not of the plant's parameters
    np.testing.assert_allclose(found.commands, commanded, rtol=0, atol=1e-12)
    assert found.allocations == [0] * SAMPLES
    assert found.last == [0.0] * 3
    assert found.reference.split()[:3] == ["law/pace", "law/path.x_d.0", "law/path.x_d.1"]
    assert found.reference.split()[-1] == "law/path.ddx_d.2"
    assert found.states[0] == "shoulder_pan_joint/position"
    assert found.states[-1] == "elbow_joint/target"


@needs_compilers
def test_another_number_is_another_command() -> None:
    measured, commanded = run()
    found = answered(rows_of(measured[:50]), *FULL, "task.gamma=0.80001")
    assert np.max(np.abs(found.commands - commanded[:50])) > 1e-9


@needs_compilers
def test_without_a_target_it_takes_what_it_has_commanded() -> None:
    measured, commanded = run()
    found = answered(rows_of(measured[:, :6]))
    assert "the measured start plus the integral of the commands" in found.messages
    # this servo's target starts at the arm's position
    np.testing.assert_allclose(found.commands, commanded, rtol=0, atol=1e-9)


@needs_compilers
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("place", [0, 3, 8])
def test_what_is_not_finite_is_an_error_and_zeros_until_it_is_activated_again(bad: float, place: int) -> None:
    measured, _ = run()
    rows = rows_of(measured[:10])
    rows[4, 2 + PATH + place] = bad
    found = answered(rows, *FULL)
    assert found.results == [0] * 4 + [1] * 6
    assert np.all(found.commands[4:] == 0)
    assert np.any(found.commands[3] != 0)
    assert "stopped: a state interface is not finite" in found.messages
    assert found.allocations == [0] * 10


@needs_compilers
@pytest.mark.parametrize(
    ("pace", "periods", "text"), [(1.5, 1, "pace: expected a number"), (1, 7, "samples were lost")]
)
def test_a_wrong_pace_and_updates_that_stay_away_are_errors(pace: float, periods: float, text: str) -> None:
    rows = rows_of(run()[0][:10], pace=1.0)
    rows[5, 0], rows[5, 1] = periods * T, pace
    found = answered(rows, *FULL)
    assert found.results == [0] * 5 + [1] * 5
    assert text in found.messages


@needs_compilers
def test_at_half_a_pace_and_over_lost_updates_it_does_what_a_drive_does() -> None:
    from dmframe.runtime.robot import Sample
    from dmframe.runtime.scaled import ScaledController

    measured = run()[0][:40]
    paces = np.where(np.arange(40) < 10, 1.0, 0.5)
    rows = rows_of(measured, pace=1.0)
    rows[:, 1] = paces
    rows[20, 0] = 3 * T
    found = answered(rows, *FULL)
    graph = dm.load(NAME)
    scaled = ScaledController(graph.diagram, graph.controller(engine="interpreted"))
    time, behind, expected = 0.0, 0.0, []
    for k, (row, pace) in enumerate(zip(measured, paces, strict=True)):
        missed = 2 if k == 20 else 0
        if k:
            time += (1 + missed) * T
            behind += (1 - paces[k - 1]) * (1 + missed) * T
        sample = Sample(time, *row.reshape(3, 3), x=graph_x(graph, row[:3]), missed=missed)
        if k == 0:
            scaled.begin(sample)
        assert scaled.step(sample, time - behind, pace)
        expected.append(pace * scaled.command)
    np.testing.assert_allclose(found.commands, expected, rtol=0, atol=1e-9)
    assert np.max(np.abs(found.commands[10:] - run()[1][10:40])) > 1e-3


@needs_compilers
def test_a_controller_before_it_may_give_the_path_as_a_whole() -> None:
    measured, commanded = run()
    rows, t = rows_of(measured, pace=1.0), np.arange(SAMPLES) * T
    s, c, o = np.sin(t), np.cos(t), np.zeros(SAMPLES)
    center = np.array([-0.07, 0.67, 0.55])
    circle = [center + 0.15 * np.array([s, c, o]).T, 0.15 * np.array([c, -s, o]).T, 0.15 * np.array([-s, -c, o]).T]
    rows[:, 2 : 2 + PATH] = np.hstack(circle)
    found = answered(rows, *FULL, "path.radius=0.01")  # which would be its own
    np.testing.assert_allclose(found.commands, commanded, rtol=0, atol=1e-9)
    assert found.allocations == [0] * SAMPLES
    rows[:, 2] += 0.01
    assert np.max(np.abs(answered(rows[:20], *FULL).commands - commanded[:20])) > 1e-3
    rows[5, 4] = np.nan
    partly = answered(rows[:10], *FULL)
    assert partly.results == [0] * 5 + [1] * 5
    assert "path: expected all of its numbers, or none" in partly.messages


def graph_x(graph: dm.Graph, q: np.ndarray) -> np.ndarray:
    from dmframe.drive.robots import _tool

    return _tool(graph.robot)(q)


@needs_compilers
@pytest.mark.parametrize(
    ("words", "rate", "text"),
    [
        (["joints=elbow_joint"], 125, "joints: expected 3 names, found 1"),
        (["task.gamma=nan"], 125, "task.gamma: expected finite numbers"),
        (["path.center=1"], 125, "path.center: expected 3 numbers, found 1"),
        ([], 500, "update_rate: expected 125 Hz, the clock of the law, found 500 Hz"),
    ],
)
def test_what_cannot_be_configured_is_reported(words: list[str], rate: int, text: str) -> None:
    done = subprocess.run([str(manager("")), str(rate), *words], input="", capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert text in done.stderr


@needs_compilers
def test_it_does_the_same_on_the_real_headers_and_bases() -> None:
    real = os.environ.get("ROS2_CONTROL", "")
    if not real:
        pytest.skip("ROS2_CONTROL names no checkout of ros2_control")
    measured, commanded = run()
    found = answered(rows_of(measured), *FULL, real=real)
    assert found.results == [0] * SAMPLES
    np.testing.assert_allclose(found.commands, commanded, rtol=0, atol=1e-12)
    assert found.allocations == [0] * SAMPLES
    rows = rows_of(measured[:10])
    rows[4, 2 + PATH] = np.nan
    bad = answered(rows, *FULL, real=real)
    assert bad.results == [0] * 4 + [1] * 6
    assert np.all(bad.commands[4:] == 0)


AMENT = """\
macro(pluginlib_export_plugin_description_file base file)
  if(NOT EXISTS ${CMAKE_CURRENT_SOURCE_DIR}/${file})
    message(FATAL_ERROR "no ${file}")
  endif()
endmacro()
foreach(word export_targets export_dependencies package)
  cmake_language(EVAL CODE "macro(ament_${word})\nendmacro()")
endforeach()
enable_testing()
set(BUILD_TESTING ON)
"""


@needs_compilers
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
def test_cmake_builds_the_package_and_its_own_test_passes(tmp_path: Path) -> None:
    found = dict[str, str]()
    for name in ("controller_interface", "hardware_interface", "pluginlib", "rclcpp", "rclcpp_lifecycle"):
        target = f"{name}::{name}"
        folders = f"{STAND_INS / 'ros'} {STAND_INS / 'control'}"
        text = f"add_library({target} INTERFACE IMPORTED)\ntarget_include_directories({target} INTERFACE {folders})\n"
        found[name] = text
    for name, text in (found | {"ament_cmake": AMENT}).items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}Config.cmake").write_text(text, encoding="utf-8")
    options = [f"-D{name}_DIR={tmp_path / name}" for name in (*found, "ament_cmake")]
    build = tmp_path / "build"
    for words in (
        ["cmake", "-S", str(package()), "-B", str(build), *options],
        ["cmake", "--build", str(build)],
        ["ctest", "--test-dir", str(build), "--no-tests=error"],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning" not in done.stderr.lower(), done.stderr


def test_its_files_name_one_another() -> None:
    folder, name = package(), f"dmframe_{NAME}"
    assert ET.parse(folder / "package.xml").findtext("name") == name
    plugin = ET.parse(folder / "controller.xml").getroot()
    assert plugin.attrib["path"] == name
    assert plugin[0].attrib["type"] == f"{name}::Controller"
    settings = YAML(typ="safe").load(folder / "config" / "controllers.yaml")
    assert settings["controller_manager"]["ros__parameters"][name]["type"] == f"{name}/Controller"
    own = settings[name]["ros__parameters"]
    assert own["task.gamma"] == [0.8]
    assert own["joints"] == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    readme = (folder / "README.md").read_text(encoding="utf-8")
    assert "not tested in ROS 2, nor on a robot" in readme
    assert "| `dynamics.Gamma` | 36 | 1 |" in readme
    for file in folder.rglob("*"):
        assert file.is_dir() or "DM_NAMES" not in file.read_text(encoding="utf-8")
    build = (folder / "CMakeLists.txt").read_text(encoding="utf-8")
    for file in ("src/controller.cpp", f"src/{NAME}.c", "test/replay.c"):
        assert file in build
        assert (folder / file).exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["pendulum_kinematic"], "expected a clock such as 8 ms, found continuous"),
        (["ur10_slow"], "a clock with a whole number of samples a second"),
        (["ur10_fast_position"], "only command is the joint velocities"),
    ],
)
def test_what_cannot_be_exported_is_reported(
    words: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["export", words[0], "new", "--ros2", *words[1:]])
    assert isinstance(done.exception, DmframeError)
    assert text in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_names_of_joints_read_back_as_they_are_whatever_they_look_like() -> None:
    names = [
        "${a}",
        "true",
        "1e3",
        "a: b",
        "yes",
        "null",
        "- x",
        "#c",
        'q"q',
        "l'l",
        "ü",
        "a, b",
        "[",
        "{",
        "~",
        "\\n",
        "@",
    ]
    for version in ((1, 1), (1, 2)):
        parser = YAML(typ="safe", pure=True)
        parser.version = version
        assert parser.load(f"joints: {_quoted(names)}\n") == {"joints": names}
    text = f"own:\n  ros__parameters:\n    joints: {_quoted(names)}\n"
    assert _read_back("graph", text, "own", names, []) == text
    with pytest.raises(DmframeError, match="does not read back as written"):
        _read_back("graph", f"own:\n  ros__parameters:\n    joints: [{', '.join(names)}]\n", "own", names, [])
    with pytest.raises(DmframeError, match="does not read back as written"):
        _read_back("graph", "own:\n  ros__parameters:\n    joints: [true]\n", "own", ["true"], [])


@pytest.mark.parametrize(("name", "package"), [("ur10_fast", "dmframe_ur10_fast"), ("_2__Arms_", "dmframe_2_arms")])
def test_names_are_those_of_packages(name: str, package: str) -> None:
    assert package_of(name) == package


@pytest.mark.parametrize("title", ["${a}", "true", "1e3", "a: b", '"', "<x>", "ünï &amp; ]]>", "", "long " * 2000])
@pytest.mark.parametrize("file", ["package.xml", "controller.xml"])
def test_a_title_reads_back_as_it_is_whatever_it_looks_like(file: str, title: str) -> None:
    text = _read_as_xml("graph", file, {"DM_PACKAGE": "own", "DM_TITLE": escape(title)})
    (found,) = (item.text or "" for item in ET.fromstring(text.encode()).iter("description"))
    assert found.removesuffix(", as a controller of ros2_control") == title


@pytest.mark.parametrize("title", ["<x>", "a & b", "bell\a"])
def test_a_title_that_is_not_xml_is_refused(title: str) -> None:
    with pytest.raises(EngineError, match=r"graph: package\.xml is not recovered by a parser"):
        _read_as_xml("graph", "package.xml", {"DM_PACKAGE": "own", "DM_TITLE": title})
