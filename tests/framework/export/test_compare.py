"""A compiled exported law compared sample by sample from equal states."""

from __future__ import annotations

import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import EngineError
from dmframe.export import c, compare
from dmframe.export.replay import SAMPLES

GCC, CLANG = shutil.which("gcc"), shutil.which("clang")
needs_gcc = pytest.mark.skipif(GCC is None, reason="needs gcc")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror")
PLAIN = ("-ffp-contract=off", "-fno-tree-vectorize")
BLOCKS = '''
from typing import ClassVar

import casadi as ca

from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import Access, Input, Output, Side, State


class Law(AbstractBlock):
    """A law with a chaotic state, of which a switch reads the first digit."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("w", sampled=True),)
    w: Scalar = Real(default=0.3)
    edge: Scalar = Real(default=0.5)

    def equations(self, u, x, p):
        folded = 0.999 * ca.sin(3.14 * x.w + 0 * u.y)
        return Equations(outputs={"v": ca.if_else(SWITCH, 0.2, 0.1) - u.y}, next={"w": folded})


class Cart(AbstractBlock):
    """dy = v."""

    side: ClassVar = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)
    y: Scalar = Real(default=1.0)

    def equations(self, u, x, p):
        return Equations(outputs={"y": x.y}, rates={"y": u.v})
'''
CHAOTIC = "x.w > p.edge"
BY_ROUNDING = "ca.fmod(ca.floor(ca.sin(50 * u.y) * 2**53), 2) > 0 * p.edge"


def graph(folder: Path, switch: str = CHAOTIC) -> dm.Graph:
    (folder / "own.py").write_text(BLOCKS.replace("SWITCH", switch), encoding="utf-8")
    blocks = "{law: {type: own.py:Law}, cart: {type: own.py:Cart}}"
    (folder / "own.yaml").write_text(
        f"dmframe: 1\ntitle: own\nclock: 10 ms\nduration: 10 s\nblocks: {blocks}\n", encoding="utf-8"
    )
    return dm.load(folder / "own.yaml")


def replayed(folder: Path, *words: str, compiler: str | None = GCC) -> subprocess.CompletedProcess[str]:
    command = [str(compiler), *STRICT, *words, "own.c", "replay.c", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    return subprocess.run(["./replay"], cwd=folder, capture_output=True, text=True, check=False)


@needs_gcc
def test_a_law_that_amplifies_rounding_is_exported(tmp_path: Path) -> None:
    loaded = graph(tmp_path)
    loaded.export(tmp_path / "out")
    states = np.array([float.fromhex(word) for word in _array(tmp_path / "out", "state")])
    assert states.size == SAMPLES + 1
    # the results of C and interpreter have no common digit in the end, so no replay could agree
    controller = loaded.controller(engine="interpreted")
    run = loaded.run(SAMPLES * 0.01, progress=False).recording
    apart = []
    for k in range(SAMPLES):
        controller.measured["cart.y"][:] = run["cart.y"][k]
        apart.append(abs(controller.states["law.w"][0] - states[k]))
        controller.step(float(run.time[k]))
    assert apart[1] < 1e-15
    assert max(apart) > 0.1
    done = replayed(tmp_path / "out", *PLAIN)
    assert (done.returncode, done.stdout.count(f"{SAMPLES} samples, the same bits")) == (0, 1)


@needs_gcc
@pytest.mark.parametrize(
    ("fault", "words"),
    [(("0.999", "0.99900001"), "law.w is"), (("3.14", "-3.14"), "law.w is"), (("0.2", "0.2000001"), "law.v is")],
)
def test_a_compiler_that_computes_another_number_is_found_at_that_sample(
    fault: tuple[str, str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = c.source

    def wrong(program: object) -> str:
        head, body = source(program).split("static void dm_follow", 1)  # type: ignore[arg-type]
        first, rest = body.split("\n}\n", 1)
        assert fault[0] in first
        return f"{head}static void dm_follow{first.replace(*fault)}\n}}\n{rest}"

    monkeypatch.setattr(c, "source", wrong)
    with pytest.raises(EngineError) as raised:
        graph(tmp_path).export(tmp_path / "out")
    assert "from the same state" in str(raised.value)
    assert words in str(raised.value)
    assert not (tmp_path / "out").exists()


@needs_gcc
def test_where_rounding_decides_a_switch_both_sides_are_right_and_the_readme_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = graph(tmp_path, BY_ROUNDING)
    loaded.export(tmp_path / "out")
    read_me = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    assert "Rounding decides a switch at sample" in read_me
    assert "from the same state: law.v" in read_me
    assert replayed(tmp_path / "out", *PLAIN).returncode == 0
    # without a compiler the reference is the interpreter, whose sines come from another library
    monkeypatch.setattr("dmframe.export.replay.find_compiler", lambda: None)
    loaded.export(tmp_path / "interpreted")
    done = replayed(tmp_path / "interpreted", *PLAIN)
    assert done.returncode == 0, done.stdout
    assert "of them rounding decides a switch" in done.stdout


@needs_gcc
def test_the_shipped_test_finds_another_law_without_its_own_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.export.replay.find_compiler", lambda: None)
    folder = tmp_path / "out"
    graph(tmp_path).export(folder)
    assert replayed(folder, *PLAIN).returncode == 0
    text = (folder / "own.c").read_text(encoding="utf-8")
    (folder / "own.c").write_text(text.replace("0.999", "0.99900001"), encoding="utf-8")
    done = replayed(folder, *PLAIN)
    assert done.returncode == 1
    assert "sample 0, from the state of the reference: different numbers" in done.stdout


@pytest.mark.skipif(CLANG is None, reason="needs clang")
@pytest.mark.parametrize("name", ["pendulum", "arm2_joint"])
def test_clang_compiles_it_without_a_warning_to_the_same_bits(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    dm.load(name).set({"clock": "4 ms"}).export(folder)
    for path in (folder / f"{name}.c", folder / f"{name}.h"):
        path.write_text(path.read_text(encoding="utf-8").replace(f"{name}.h", "own.h"), encoding="utf-8")
        path.rename(folder / f"own{path.suffix}")
    replay = folder / "replay.c"
    replay.write_text(replay.read_text(encoding="utf-8").replace(f'"{name}.h"', '"own.h"'), encoding="utf-8")
    done = replayed(folder, "-O2", *PLAIN, compiler=CLANG)
    assert done.returncode == 0, done.stdout


@needs_gcc
def test_a_sampled_law_whose_guard_switches_by_rounding_is_exported(tmp_path: Path) -> None:
    folder, name = tmp_path / "out", "ur10_slow_supervised_delay"
    dm.load(name).export(folder)
    command = [str(GCC), *STRICT, *PLAIN, "-O1", f"{name}.c", "replay.c", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run(["./replay"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, "the same bits" in done.stdout) == (0, True)


def test_each_helper_of_the_source_is_called(tmp_path: Path) -> None:
    graph(tmp_path).export(tmp_path / "out")
    text = (tmp_path / "out" / "own.c").read_text(encoding="utf-8")
    assert text.count("dm_sincos(") > 1
    for word in ("dm_tanh", "dm_sign", "dm_fmin", "dm_fmax", "dm_all", "dm_before"):
        assert word not in text


def test_a_number_between_the_sides_of_a_switch_is_wrong() -> None:
    def step(inputs: compare.Numbers) -> np.ndarray:
        return np.where(inputs[0] >= 1.0, 5.0, 3.0)

    at_edge, near = [np.array([1.0])], [np.array([1.0 + 1e-9])]
    assert compare.judged(step, at_edge, np.array([5.0]))[2]
    assert compare.judged(step, at_edge, np.array([3.0]))[2]
    assert not compare.judged(step, at_edge, np.array([4.0]))[2]
    assert not compare.judged(step, near, np.array([3.0]))[2]


def test_digits_that_a_step_loses_without_a_switch_are_rounding() -> None:
    def step(inputs: compare.Numbers) -> np.ndarray:
        return 1e9 * (inputs[0] - 1)

    given = [np.array([1 + 1e-9])]
    assert compare.judged(step, given, step(given) + 1e-6)[2]
    assert not compare.judged(step, given, step(given) + 1e-2)[2]


def _array(folder: Path, name: str) -> list[str]:
    text = (folder / "samples.h").read_text(encoding="utf-8")
    body = text[text.index(f"double dm_{name}[") :].partition("{")[2].partition("};")[0]
    return [word.strip() for word in body.split(",") if word.strip()]


def test_an_export_names_the_model_that_runs_and_is_proved(tmp_path: Path) -> None:
    loaded = dm.load("arm2_joint")
    model = loaded.diagram.fingerprint
    loaded.export(tmp_path / "c")
    for name in ("arm2_joint.c", "arm2_joint.h", "provenance.json"):
        assert model in (tmp_path / "c" / name).read_text(encoding="utf-8")
    units = loaded.export(tmp_path / "fmi", "fmi3")
    for unit in units:
        with zipfile.ZipFile(unit) as archive:
            described = ElementTree.fromstring(archive.read("modelDescription.xml"))
            assert model in described.attrib["description"]
            assert json.loads(archive.read("resources/provenance.json"))["field_hash"] == model
    loaded.set({"servo.K_P": [61, 30]}).export(tmp_path / "other")
    assert model not in (tmp_path / "other" / "arm2_joint.c").read_text(encoding="utf-8")
