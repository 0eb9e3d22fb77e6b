"""The exported units in FMPy, compared with the simulation."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import DmframeError

fmpy = pytest.importorskip("fmpy")
GCC = shutil.which("gcc")
pytestmark = pytest.mark.skipif(GCC is None, reason="needs gcc")
PLAIN = ("-ffp-contract=off", "-fno-tree-vectorize")
Kind = Literal["fmi2", "fmi3"]
KINDS: tuple[Kind, ...] = ("fmi2", "fmi3")
NAME = "joint_tracking_pi"
"""For properties of the units of any graph."""


@cache
def exported(name: str, kind: Kind) -> tuple[Path, Path]:
    controller, robot = dm.load(name).export(Path(mkdtemp(prefix="units-")) / name, kind)
    return controller, robot


@cache
def extracted(file: Path) -> tuple[Any, str]:
    """A unit's description and its files, which its instances only read."""
    folder = mkdtemp(prefix="unit-")
    fmpy.extract(str(file), folder)
    return fmpy.read_model_description(str(file)), folder


class Unit:
    """One instance under FMPy, with numbers by label."""

    def __init__(self, file: Path, kind: Kind) -> None:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.kind = kind
        self.description, folder = extracted(file)
        self.at = dict[str, list[int]]()
        self.sizes, self.causality = dict[str, int](), dict[str, list[str]]()
        for item in self.description.modelVariables:
            label = item.name.partition("[")[0]
            self.at.setdefault(label, []).append(item.valueReference)
            size = int(item.dimensions[0].start) if item.dimensions else 1
            self.sizes[label] = self.sizes.get(label, 0) + size
            if label not in (kinds := self.causality.setdefault(item.causality, [])):
                kinds.append(label)
        self.fmu: Any = {"fmi2": FMU2Slave, "fmi3": FMU3Slave}[kind](
            guid=self.description.guid,
            unzipDirectory=folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=self.description.modelName,
        )
        self.fmu.instantiate()

    def initialise(self) -> None:
        if self.kind == "fmi2":
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)

    def get(self, label: str) -> np.ndarray:
        if self.kind == "fmi2":
            return np.array(self.fmu.getReal(self.at[label]))
        return np.array(self.fmu.getFloat64(self.at[label], nValues=self.sizes[label]))

    def set(self, label: str, values: np.ndarray) -> None:
        (self.fmu.setReal if self.kind == "fmi2" else self.fmu.setFloat64)(self.at[label], values.tolist())

    def step(self, t: float, h: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=h)


def coupled(name: str, kind: Kind, ticks: int, start: dict[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """Controller first, then the robot with its commands; the signals at each sample."""
    controller, robot = (Unit(file, kind) for file in exported(name, kind))
    T = dm.load(name).clock
    assert T is not None
    for unit in (controller, robot):
        for label, values in (start or {}).items():
            if label in unit.at:
                unit.set(label, values)
        unit.initialise()
    shown = [robot.get(label) for label in robot.causality["output"]]
    assert np.isfinite(np.concatenate(shown)).all()
    for unit in (controller, robot):
        unit.fmu.exitInitializationMode()
    recorded: dict[str, list[np.ndarray]] = {}
    t = 0.0
    for _ in range(ticks):
        for label in robot.causality["output"]:
            recorded.setdefault(label, []).append(robot.get(label))
            controller.set(label, recorded[label][-1])
        controller.step(t, T)
        for label in controller.causality["output"]:
            recorded.setdefault(label, []).append(controller.get(label))
            robot.set(label, recorded[label][-1])
        robot.step(t, T)
        t += T  # as masters do: a unit counts samples, so the rounding of sums has no effect
    return {label: np.array(rows) for label, rows in recorded.items()}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["ur10_fast", NAME])
def test_coupled_they_are_the_simulation_to_the_last_bit(
    name: str, kind: Kind, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", f"{GCC} {' '.join(PLAIN)}")
    graph, ticks = dm.load(name), 300
    assert graph.clock is not None
    run = graph.run(ticks * graph.clock, engine="compiled", progress=False).recording
    for label, values in coupled(name, kind, ticks).items():
        assert values.tobytes() == np.ascontiguousarray(run[label][:ticks]).tobytes(), label


@pytest.mark.parametrize("kind", KINDS)
def test_fmpy_finds_nothing_wrong_in_them(kind: Kind) -> None:
    from fmpy.validation import validate_fmu

    for file in exported("ur10_fast", kind):
        assert validate_fmu(str(file)) == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_that_starts_elsewhere_is_met_where_it_is(kind: Kind) -> None:
    q = np.array([1.4, -1.0, 1.0])
    graph = dm.load("ur10_fast").set({"start": {"arm.q": q.tolist(), "servo.q_c": q.tolist()}})
    run = graph.run("32 ms", progress=False)
    recorded = coupled(
        "ur10_fast", kind, 3, {"state.arm.q": q, "state.servo.q_c": q, "state.servo.i": run["servo.i"][0].to_numpy()}
    )
    np.testing.assert_allclose(recorded["arm.q"], run["arm.q"][:3], atol=1e-12)
    np.testing.assert_allclose(recorded["inverse.dq_c"], run["inverse.dq_c"][:3], atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_shows_where_it_starts_to_one_who_looks_only_when_it_is_initialised(kind: Kind) -> None:
    robot = Unit(exported(NAME, kind)[1], kind)
    robot.initialise()
    robot.fmu.exitInitializationMode()
    q = robot.get("arm.q")
    assert np.abs(q).max() > 0.1
    assert q.tolist() == robot.get("state.arm.q").tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_a_saved_state_is_returned_to(kind: Kind) -> None:
    robot = Unit(exported(NAME, kind)[1], kind)
    robot.initialise()
    robot.fmu.exitInitializationMode()
    robot.set("inverse.dq_c", np.array([0.1, -0.1, 0.2]))
    robot.step(0.0, 0.008)
    word = {"fmi2": "state", "fmi3": "State"}[kind]
    get, put = (getattr(robot.fmu, f"{verb}FMU{word}") for verb in ("get", "set"))
    kept = get()
    robot.step(0.008, 0.008)
    once = robot.get("arm.q")
    put(kept)
    robot.step(0.008, 0.008)
    np.testing.assert_array_equal(robot.get("arm.q"), once)
    saved = getattr(robot.fmu, f"serializeFMU{word}")(kept)
    put(getattr(robot.fmu, {"fmi2": "deSerializeFMUstate", "fmi3": "deserializeFMUState"}[kind])(saved))
    robot.step(0.008, 0.008)
    np.testing.assert_array_equal(robot.get("arm.q"), once)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "value"),
    [
        *(("step", value) for value in (0.004, 0.016, 0.0, -0.008, np.nan)),
        *(("time", value) for value in (0.003, 0.8, -0.8, 1e300, np.nan, np.inf)),
        ("input", np.nan),
        ("parameter", 1.0),
        ("output", 1.0),
    ],
)
def test_what_it_cannot_do_it_refuses(kind: Kind, change: str, value: float) -> None:
    from fmpy.fmi1 import FMICallException

    unit = Unit(exported(NAME, kind)[0], kind)
    unit.initialise()
    unit.fmu.exitInitializationMode()
    label = unit.causality.get(change, [""])[0]
    changes = {
        "step": lambda: unit.step(0.0, value),
        "time": lambda: unit.step(value, 0.008),
        **dict.fromkeys(("input", "parameter", "output"), lambda: unit.set(label, np.full(unit.sizes[label], value))),
    }
    with pytest.raises(FMICallException):
        changes[change]()


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_is_neither_taken_twice_nor_left_out(kind: Kind) -> None:
    from fmpy.fmi1 import FMICallException

    unit = Unit(exported(NAME, kind)[1], kind)
    unit.initialise()
    unit.fmu.exitInitializationMode()
    unit.step(0.0, 0.008)
    before = unit.get("arm.q")
    for t in (0.0, 0.016):
        with pytest.raises(FMICallException):
            unit.step(t, 0.008)
    np.testing.assert_array_equal(unit.get("arm.q"), before)
    unit.step(0.008, 0.008)


@pytest.mark.parametrize("kind", KINDS)
def test_the_description_of_another_is_refused(kind: Kind) -> None:
    unit = Unit(exported(NAME, kind)[0], kind)
    unit.fmu.guid = "{another}"
    if kind == "fmi3":
        unit.fmu.instantiationToken = "{another}"
    with pytest.raises(Exception, match="nstantiate"):
        unit.fmu.instantiate()


@pytest.mark.parametrize("kind", KINDS)
def test_its_sources_compile_without_a_warning_under_the_standard_s_declarations(kind: Kind, tmp_path: Path) -> None:
    declared = Path(fmpy.__file__).parent / "c-code"
    for file in declared.glob("fmi*.h"):  # an enumeration is compared as the int that it is
        text = re.sub(r"typedef enum \{[^}]*\} (\w+);", r"typedef int \1;", file.read_text(encoding="utf-8"))
        (tmp_path / file.name).write_text(text, encoding="utf-8")
    for file in exported("ur10_fast", kind):
        with zipfile.ZipFile(file) as archive:
            source = archive.read(f"sources/{file.stem}.c").decode()
        (tmp_path / "unit.c").write_text(source, encoding="utf-8")
        strict = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror", *PLAIN)
        done = subprocess.run(
            [str(GCC), *strict, "-c", "unit.c"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
        done = compiled(tmp_path, "-std=c99", f"-I{tmp_path}", "-include", f"fmi{kind[-1]}Functions.h")
        clashes = set(re.findall(r"conflicting types for .(\w+)", done.stderr))
        assert clashes <= {"fmi2Instantiate"}  # whose callbacks are a struct of its own with the same members


def compiled(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    given = [str(GCC), *words, "-c", "unit.c"]
    return subprocess.run(given, cwd=folder, capture_output=True, text=True, check=False)


def test_units_are_reported_in_those_of_si() -> None:
    with zipfile.ZipFile(exported(NAME, "fmi3")[1]) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    units = {item.get("name"): item[0].attrib for item in root.iter("Unit")}
    assert units["N m s/rad"] == {"kg": "1", "m": "2", "s": "-1", "rad": "-1"}
    assert units["V s/rad"] == {"kg": "1", "m": "2", "s": "-2", "A": "-1", "rad": "-1"}


@pytest.mark.parametrize(
    ("graph", "text"),
    [
        (
            lambda: dm.load("ur10_fast").set({"reality": {"transport_delay": {"samples": 1}}}),
            "its robot has .*, which is sampled",
        ),
        (lambda: dm.load("ur10_fast").set({"solver.method": "ros34pw2"}), "rk4 for an exported robot, found ros34pw2"),
        (lambda: dm.load("pendulum"), "expected a clock such as 8 ms, found continuous"),
    ],
)
def test_a_robot_that_cannot_be_simulated_alone_is_reported(graph: Any, text: str, tmp_path: Path) -> None:
    with pytest.raises(DmframeError, match=text):
        graph().export(tmp_path / "out", "fmi3")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_them_is_left_as_it_is(tmp_path: Path) -> None:
    graph = dm.load("ur10_fast")
    files = graph.export(tmp_path, "fmi2")
    before = [file.read_bytes() for file in files]
    with pytest.raises(DmframeError, match="exists already"):
        graph.export(tmp_path, "fmi3")
    assert [file.read_bytes() for file in files] == before
