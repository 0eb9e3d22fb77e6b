"""Any change that can alter a command after a passed rehearsal is named, and prevents a drive."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.build.compiler import Compiler
from dmframe.common.errors import DriveError
from dmframe.drive import identity, load_limits, records, rehearse, robots, run_on_robot
from dmframe.drive.rehearse import Condition
from dmframe.drive.robots import Kind

CONDITIONS = rehearse.conditions
ROBOTS = Path(__file__).parents[3] / "plants" / "dmframe_plants"
BLOCK = """
from typing import ClassVar, final
import {helper} as helper
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Input, Output

@final
class My(AbstractBlock):
    inputs = (Input("q", "n", "rad"), Input("q_d", "n", "rad"), Input("dq_d", "n", "rad/s", derivative_of="q_d"))
    outputs = (Output("dq_r", "n", "rad/s"),)
    rate: Scalar = Positive("", "1/s")

    def equations(self, u, x, p):
        return Equations(outputs={{"dq_r": u.dq_d - helper.SIGN * p.rate * (u.q - u.q_d)}})
"""
GRAPH = """
dmframe: 1
robot: arm.urdf
clock: 2 ms
duration: 0.1 s
tolerance: 0.1 rad
start: {arm.q: [0.7, 1.0]}
blocks:
  path: {type: sinusoid, center: [45 deg, 60 deg], amplitude: [3 deg, 4 deg], rate: [0.9 rad/s, 1.4 rad/s]}
  task: {type: "my.py:My", rate: 2}
  inverse: {type: kinematic_command}
  servo: {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm: {type: manipulator, viscous: [1, 0.5]}
"""
LIMITS = "dmframe-limits: 1\nspeed: 2 rad/s\nacceleration: 500 rad/s^2\n"


class Bench:
    """A graph with a block and a robot of its own, and what drives it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.limits = folder, folder / "limits.yaml"
        self.helper = f"helper_{folder.parent.name.replace('-', '_')}"
        (folder / "my.py").write_text(BLOCK.format(helper=self.helper))
        (folder / f"{self.helper}.py").write_text("SIGN = 1.0\n")
        (folder / "graph.yaml").write_text(GRAPH)
        self.limits.write_text(LIMITS)
        shutil.copy(ROBOTS / "arm2" / "arm2.urdf", folder / "arm.urdf")

    def graph(self) -> dm.Graph:
        return dm.load(self.folder / "graph.yaml")

    def rehearse(self, graph: dm.Graph | None = None, **options: Any) -> rehearse.Rehearsal:
        return (graph or self.graph()).rehearse(
            **{"limits": self.limits, "engine": "interpreted", "ramp": 0, **options}
        )

    def drive(self, graph: dm.Graph | None = None, **options: Any) -> Any:
        given = {"limits": self.limits, "engine": "interpreted", "ramp": 0, **options}
        return (graph or self.graph()).drive("real:host", **given)

    def edit(self, name: str, before: str, after: str) -> None:
        text = (self.folder / name).read_text()
        assert before in text
        (self.folder / name).write_text(text.replace(before, after))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    make = robots.KINDS["sim"].make
    monkeypatch.setitem(robots.KINDS, "real", Kind(real=True, make=lambda rest, *others: make("", *others)))
    monkeypatch.setattr(rehearse, "conditions", lambda *_: [Condition("nothing, the ideal robot", {})])
    folder = tmp_path / "own"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    return Bench(folder)


def test_what_was_rehearsed_is_driven_and_nothing_before_it(bench: Bench) -> None:
    with pytest.raises(DriveError, match="expected a passed rehearsal of exactly this graph, found none"):
        bench.drive()
    assert records.store(bench.rehearse())
    assert bench.drive().recording.time.size == 51
    assert bench.drive(bench.graph().until(0.04)).recording.time.size == 21  # for a shorter duration too


SETTINGS: dict[str, tuple[Any, str]] = {
    "task.rate": (3, r"graph: blocks.task.rate was 2.0, is 3.0"),
    "path.rate": (1.0, r"graph: blocks.path.rate"),
    "path.center": ([0.8, 1.0], r"graph: blocks.path.center"),
    "servo.K_P": ([50, 30], r"graph: blocks.servo.K_P"),
    "arm.viscous": ([1, 0.4], r"graph: blocks.arm.viscous"),
    "clock": ("4 ms", r"graph: clock was 0.002, is 0.004"),
    "seed": (7, r"graph: seed is new"),
    "jitter": ("0.1 ms", r"graph: jitter is new"),
    "solver.step": ("0.1 ms", r"graph: solver.step"),
    "start": ({"arm.q": [0.7, 1.1]}, r"graph: start.arm.q"),
}


@pytest.mark.parametrize("key", SETTINGS)
def test_another_setting_of_the_graph_is_refused_and_named(bench: Bench, key: str) -> None:
    records.store(bench.rehearse())
    value, named = SETTINGS[key]
    with pytest.raises(DriveError, match=named):
        bench.drive(bench.graph().set({key: value}))


def masses(bench: Bench) -> None:
    bench.edit("arm.urdf", '<mass value="', '<mass value="5')


FILES: dict[str, tuple[Callable[[Bench], None], str]] = {
    "sign of the feedback": (lambda b: b.edit("my.py", "u.dq_d -", "u.dq_d +"), r"block source: my.py"),
    "a comment": (lambda b: b.edit("my.py", "@final", "# final\n@final"), r"block source: my.py"),
    "what the block imports": (lambda b: b.edit(f"{b.helper}.py", "1.0", "1.5"), r"block source: helper_"),
    "masses": (masses, r"robot model: arm.urdf"),
    "speed": (lambda b: b.edit("limits.yaml", "speed: 2", "speed: 1.9"), r"limits: speed was \[.*is \['1.9', '1.9'\]"),
    "acceleration": (lambda b: b.edit("limits.yaml", "500", "501"), r"limits: acceleration"),
    "halt": (lambda b: b.limits.write_text(f"{LIMITS}halt: 10 rad/s^2\n"), r"limits: halt was 20.0, is 10.0"),
    "deviation": (lambda b: b.limits.write_text(f"{LIMITS}deviation: 0.3\n"), r"limits: deviation was 0.2, is 0.3"),
    "lost": (lambda b: b.limits.write_text(f"{LIMITS}lost: 9\n"), r"limits: lost was 5, is 9"),
    "box": (lambda b: b.limits.write_text(f"{LIMITS}box: {{x: [-3, 3]}}\n"), r"limits: box"),
    "position": (lambda b: b.limits.write_text(f"{LIMITS}position: {{joint1: [-1, 1]}}\n"), r"limits: lower"),
}


@pytest.mark.parametrize("what", FILES)
def test_another_file_is_refused_and_named(bench: Bench, what: str) -> None:
    records.store(bench.rehearse())
    alter, named = FILES[what]
    alter(bench)
    with pytest.raises(DriveError, match=named):
        bench.drive()


def test_another_payload_engine_or_drive_is_refused_and_named(bench: Bench) -> None:
    records.store(bench.rehearse(payload=0.0))
    with pytest.raises(DriveError, match=r"payload: at the tool \[kg\] was 0.0, is"):
        bench.drive()
    assert bench.drive(payload=0.0).recording.time.size == 51
    with pytest.raises(DriveError, match="engine: kind was interpreted, is compiled"):
        bench.drive(payload=0.0, engine="compiled")
    with pytest.raises(DriveError, match=r"drive: ramp \[s\] was 0.0, is 0.5"):
        bench.drive(payload=0.0, ramp="0.5 s")
    with pytest.raises(DriveError, match=r"drive: ramp \[s\] was 0.0, is 1.0"):
        bench.drive(payload=0.0, ramp=None)
    with pytest.raises(DriveError, match=r"drive: patience \[s\] was default, is 0.2"):
        bench.drive(payload=0.0, patience=0.2)
    with pytest.raises(DriveError, match=r"expected a drive of at most 100 ms, .* found 110 ms"):
        bench.drive(payload=0.0, until=0.11)


VERSIONS: dict[str, tuple[Callable[[pytest.MonkeyPatch], None], str]] = {
    "version": (lambda m: m.setattr(identity, "own_version", lambda: "9"), r"dmframe: version was .* is 9"),
    "source": (lambda m: m.setattr(identity, "_framework", lambda: "0" * 64), r"dmframe: source$"),
    "library": (lambda m: m.setattr(identity, "_installed", lambda name: "9"), r"library: casadi was .*, is 9"),
    "machine": (lambda m: m.setattr(platform, "machine", lambda: "pdp11"), r"engine: machine was .*, is pdp11"),
}


def test_a_rehearsal_takes_the_times_of_its_drive(bench: Bench) -> None:
    slow = {"ramp": "0.05 s", "patience": "0.2 s"}
    records.store(bench.rehearse(**slow))
    assert bench.drive(**slow).recording.time.size > 51  # the first motion takes longer
    with pytest.raises(DriveError, match="drive: ramp"):
        bench.drive()


def test_a_condition_of_a_rehearsal_has_the_ramp_of_the_drive(bench: Bench) -> None:
    assert [each.ramp for each in CONDITIONS(0.008, 40.0, 0.0, 1.5) if each.about == "a ramp of 1.5 s"] == [1.5]
    assert not any(each.ramp for each in CONDITIONS(0.008, 40.0, 0.0, 0.0))
    graph, tried = bench.graph(), [Condition("nothing", {}), Condition("a ramp", {}, ramp=0.05)]
    plain, slow = rehearse.rehearsed(graph, engine="interpreted", tried=tried).outcomes
    assert plain.error != slow.error


@pytest.mark.parametrize("what", VERSIONS)
def test_another_version_is_refused_and_named(bench: Bench, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    records.store(bench.rehearse())
    alter, named = VERSIONS[what]
    alter(monkeypatch)
    with pytest.raises(DriveError, match=named):
        bench.drive()


def test_another_compiler_or_flags_are_another_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "find_compiler", lambda: Compiler(("cc",), "cc 1"))
    one = identity._engine("compiled")
    monkeypatch.setattr(identity, "find_compiler", lambda: Compiler(("cc",), "cc 2"))
    monkeypatch.setattr(identity, "FLAGS", (("-Ofast",),))
    found = identity.differences({"engine": one}, {"engine": identity._engine("compiled"), identity.LOOP: {}})
    assert found[0] == "engine: compiler was cc 1, is cc 2"
    assert found[1].startswith("engine: flags")


def test_a_block_file_that_is_put_back_after_it_was_loaded_opens_nothing(bench: Bench) -> None:
    records.store(bench.rehearse())
    bench.edit("my.py", "u.dq_d -", "u.dq_d +")
    turned = bench.graph()
    bench.edit("my.py", "u.dq_d +", "u.dq_d -")
    with pytest.raises(DriveError, match=r"block source: my.py"):
        bench.drive(turned)
    assert bench.drive().recording.time.size == 51


def test_what_no_file_shows_is_seen_in_the_closed_loop_that_drives(bench: Bench) -> None:
    records.store(bench.rehearse(payload=1.0))
    graph = bench.graph()
    diagram = graph.diagram
    loop = diagram.loop
    inertia = next(item for item in loop.parameters if item.label == "robot.inertia")
    heavier = replace(inertia, value=5 * inertia.value)
    parameters = tuple(heavier if item is inertia else item for item in loop.parameters)
    vars(graph)["diagram"] = replace(diagram, loop=replace(loop, parameters=parameters))
    limits = load_limits(bench.limits, graph.robot)
    with pytest.raises(DriveError, match=r"Changes since its rehearsal of .*: closed loop: field"):
        run_on_robot(graph, "real:host", limits=limits, payload=1.0, ramp=0, engine="interpreted")


def notes(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "state").rglob("*.json"))


def test_one_flipped_bit_of_the_note_makes_it_none(bench: Bench, tmp_path: Path) -> None:
    records.store(bench.rehearse())
    (note,) = notes(tmp_path)
    graph, whole = bench.graph(), note.read_bytes()
    _ = graph.diagram
    for place in range(0, len(whole), len(whole) // 12):
        note.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 7)]) + whole[place + 1 :])
        with pytest.raises(DriveError, match="is damaged or was edited"):
            bench.drive(graph)
    note.write_bytes(whole)
    assert bench.drive(graph).recording.time.size == 51


def test_a_note_edited_by_hand_or_cut_off_is_none(bench: Bench, tmp_path: Path) -> None:
    bench.edit("my.py", "u.dq_d -", "u.dq_d + 0 *")
    found = replace(bench.rehearse(), outcomes=[])
    records.store(found)
    (note,) = notes(tmp_path)
    held = json.loads(note.read_text())
    for text in (json.dumps({**held, "until": 1e9}, indent=1), note.read_text()[:-40], "{", ""):
        note.write_text(text)
        with pytest.raises(DriveError, match="is damaged or was edited"):
            bench.drive()


def test_what_is_cut_short_chosen_or_failed_is_not_kept(bench: Bench, tmp_path: Path) -> None:
    assert not records.store(bench.rehearse(until=0.05))
    graph = bench.graph()
    own = rehearse.rehearsed(graph, engine="interpreted", tried=[Condition("nothing, the ideal robot", {})])
    assert not records.store(own)
    assert not notes(tmp_path)
    whole = bench.rehearse()
    assert records.store(whole)
    failed = [replace(outcome, why="too late") for outcome in whole.outcomes]
    assert not records.store(replace(whole, outcomes=failed))
    assert not notes(tmp_path)


def test_a_user_without_a_home_is_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(records.platformdirs, "user_state_dir", lambda *_, **__: "~")
    with pytest.raises(DriveError, match="expected a home folder"):
        bench.drive()


@pytest.mark.parametrize("folder", ["site-packages", "dist-packages"])
def test_a_package_of_another_environment_is_a_library_and_a_users_module_is_not(folder: str, tmp_path: Path) -> None:
    assert identity._is_library(tmp_path / folder / "numpy" / "__init__.py")
    assert not identity._is_library(tmp_path / "numpy" / "__init__.py")
