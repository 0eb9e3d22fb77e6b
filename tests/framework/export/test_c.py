"""The exported C compared with the simulation, with strict compiler warnings."""

from __future__ import annotations

import ast
import errno
import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.block.port import Side
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, OutputError, ValueFault
from dmframe.export import c
from dmframe.export.program import identifier
from tests.exported_controller import ExportedController

GCC = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(GCC is None, reason="needs gcc")
PLAIN = ("-ffp-contract=off", "-fno-tree-vectorize")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror")
GRAPHS = ("ur10_fast", "ur10_full", "joint_tracking_pi", "ur10_fast_kinematic")
LOADED = "ur10_payload"


@cache
def exported(name: str) -> Path:
    folder = Path(mkdtemp(prefix="exported-")) / name
    dm.load(name).export(folder)
    return folder


def compiled(folder: Path, *words: str, main: str = "replay.c") -> Path:
    """A program of the exported files."""
    name = next(file.stem for file in folder.glob("*.c") if file.stem not in ("replay", "example"))
    out = Path(mkdtemp(prefix="compiled-")) / "program"
    done = subprocess.run(
        [str(GCC), *words, f"{name}.c", main, "-lm", "-o", str(out)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:2000]
    assert not done.stderr
    return out


def reported(program: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(program)], capture_output=True, text=True, check=False)


@needs_gcc
@pytest.mark.parametrize(
    ("name", "optimised"),
    [("ur10_fast", "-O0"), ("ur10_fast", "-Os"), *((name, "-O2") for name in (*GRAPHS, "ur10_slow_probe"))],
)
def test_it_compiles_without_a_warning_to_the_same_bits(name: str, optimised: str) -> None:
    done = reported(compiled(exported(name), *STRICT, *PLAIN, optimised))
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{33 if name == 'ur10_slow_probe' else 250} samples, the same bits" in done.stdout


@needs_gcc
def test_a_source_that_the_plant_alone_reads_is_no_part_of_the_path() -> None:
    folder = exported(LOADED)
    assert "250 samples, the same bits" in reported(compiled(folder, *STRICT, *PLAIN, "-O1")).stdout
    header = (folder / f"{LOADED}.h").read_text(encoding="utf-8")
    code = re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    assert "path_q_d[6]" in code
    assert "load" not in code.replace("payload", "")


@needs_gcc
@pytest.mark.parametrize("main", ["replay.c", "example.c"])
@pytest.mark.parametrize("name", ["ur10_fast", "ur10_fast_kinematic"])
def test_sanitizers_find_nothing(name: str, main: str) -> None:
    words = ("-std=c99", "-g", *PLAIN, "-fsanitize=address,undefined", "-fno-sanitize-recover")
    done = reported(compiled(exported(name), *words, main=main))
    assert (done.returncode, done.stderr) == (0, "")


@cache
def controller_object() -> str:
    """Path of the compiled controller, without the replay program."""
    out = Path(mkdtemp(prefix="compiled-")) / "arm2_joint.o"
    words = [str(GCC), *STRICT, *PLAIN, "-c", "arm2_joint.c", "-o", str(out)]
    subprocess.run(words, cwd=exported("arm2_joint"), check=True)
    return str(out)


@needs_gcc
@pytest.mark.parametrize("array", ["dm_commands", "dm_state", "dm_measured"])
def test_one_wrong_bit_is_found(array: str, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(exported("arm2_joint"), tmp_path / "arm2_joint"))
    text = (folder / "samples.h").read_text(encoding="utf-8")
    number = re.compile(r"0x1\.(\w{4})").search(text, text.index(f"double {array}["))
    assert number is not None
    turned = f"{int(number.group(1), 16) ^ 1:04x}"
    (folder / "samples.h").write_text(text[: number.start(1)] + turned + text[number.end(1) :], encoding="utf-8")
    (folder / "arm2_joint.c").write_text('#include "arm2_joint.h"\n', encoding="utf-8")
    done = reported(compiled(folder, *STRICT, *PLAIN, controller_object()))
    assert done.returncode == 1
    assert "different bits" in done.stdout


@needs_gcc
@pytest.mark.parametrize("name", ["arm2_joint", "ur10_fast", "joint_tracking_pi"])
def test_it_commands_to_the_bit_what_a_simulation_without_fused_operations_does(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", f"{GCC} {' '.join(PLAIN)}")
    graph = dm.load(name)
    assert graph.clock is not None
    run = graph.run(200 * graph.clock, engine="compiled", progress=False).recording
    controller = ExportedController(exported(name) / f"{name}.c", tmp_path, words=("-O2", *PLAIN))
    for k, t in enumerate(run.time[:200]):
        given = np.concatenate([run[leaf.name][k] for leaf in graph.diagram.loop.measured])
        if k == 0:
            assert controller.reset(given, t)
        commanded = controller.step(given, t)
        expected = np.concatenate([run[leaf.name][k] for leaf in graph.diagram.loop.commanded])
        assert commanded is not None
        assert commanded.tobytes() == expected.tobytes(), f"sample {k}"


@pytest.fixture(scope="module")
def ur10(tmp_path_factory: pytest.TempPathFactory) -> ExportedController:
    return ExportedController(exported("ur10_fast") / "ur10_fast.c", tmp_path_factory.mktemp("ur10"))


@needs_gcc
def test_a_sample_that_is_not_finite_changes_nothing(ur10: ExportedController) -> None:
    sound = np.array([0.0, 0.0, 0.0, 1.0, -1.0, 1.0, 0.5, 0.5, 0.5, 1.0, -1.0, 1.0])
    assert ur10.reset(sound, 0.0)
    assert ur10.step(sound, 0.0) is not None
    before, commanded = ur10.controller.raw, ur10.commanded.copy()
    for bad in (np.nan, np.inf, -np.inf):
        for place in range(sound.size):
            sample = sound.copy()
            sample[place] = bad
            assert ur10.step(sample, 0.008) is None
            assert not ur10.reset(sample, 0.008)
    assert ur10.step(sound, np.nan) is None
    after = ur10.controller.raw
    message = (exported("ur10_fast") / "ur10_fast.h").read_text(encoding="utf-8")
    size = 8 * sum(int(count) for count in re.findall(r"double (?:parameters|constants|state)\[(\d+)\]", message))
    assert after[:size] == before[:size]
    assert int.from_bytes(after[size : size + 8], "little") == 3 * sound.size + 1
    np.testing.assert_array_equal(ur10.commanded, commanded)


@needs_gcc
def test_the_tool_is_where_pinocchio_has_it(ur10: ExportedController) -> None:
    graph = dm.load("ur10_fast")
    run = graph.run("0.1 s", progress=False).recording
    for q, x in zip(run["arm.q"], run["arm.x"], strict=True):
        np.testing.assert_allclose(ur10.tool(q), x, atol=1e-12)


def test_no_number_of_the_servo_or_the_arm_is_in_it() -> None:
    for name in GRAPHS:
        graph = dm.load(name)
        plant = {label for label, block in graph.blocks.items() if block.side is Side.PLANT}
        text = (exported(name) / f"{name}.h").read_text(encoding="utf-8")
        message = re.search(rf"typedef struct {{([^}}]*)}} {name}_parameters;", text)
        assert message is not None
        words = re.findall(r"double (\w+)\[", message.group(1))
        assert words
        assert not [word for word in words if any(word.startswith(f"{label}_") for label in plant)]
        assert not [word for word in words if "inertia" in word]


@pytest.mark.parametrize("name", GRAPHS)
def test_a_controller_that_starts_from_what_is_measured_starts_as_the_simulation(name: str) -> None:
    graph = dm.load(name)
    assert graph.clock is not None
    run = graph.run(2 * graph.clock, progress=False).recording
    controller = graph.controller(engine="interpreted")
    for label, values in controller.measured.items():
        values[:] = run[label][0]
    begun = {label: values.copy() for label, values in controller.states.items()}
    controller.reset(measured=True)
    for label, values in controller.states.items():
        np.testing.assert_array_equal(values, begun[label])


def test_what_follows_the_pose_starts_at_the_pose_that_is_measured() -> None:
    controller = dm.load("ur10_fast").controller(engine="interpreted")
    with pytest.raises(ValueFault, match=r"finite measurements to start from, not arm\.dq"):
        controller.reset(measured=True)
    q = np.array([0.3, -1.2, 0.9])
    for label, values in controller.measured.items():
        values[:] = q if label.endswith((".q", ".q_c")) else 0.1
    estimate = controller.states["dynamics.a_d_hat"].copy()
    controller.reset(measured=True)
    np.testing.assert_array_equal(controller.states["inverse.q_r"], q)
    np.testing.assert_array_equal(controller.states["dynamics.a_d_hat"], estimate)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["pendulum_kinematic", "new", "--c"], "expected a clock such as 8 ms, found continuous"),
        (["ur10_payload", "new", "--fmi2"], "found one that reads load.a_load; export only the controller, with --c"),
        (["ur10_fast", "new"], "expected one of --c, --fmi2, --fmi3"),
        (["ur10_fast", ".", "--c"], "exists already; choose a new folder"),
    ],
)
def test_what_cannot_be_exported_is_reported(
    words: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["export", *words])
    assert isinstance(done.exception, DmframeError)
    assert text in str(done.exception)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "word"),
    [("arm.q", "arm_q"), ("2 arms", "_2_arms"), ("int", "int_"), ("class", "class_"), ("new", "new_")],
)
def test_names_are_words_of_c(name: str, word: str) -> None:
    assert identifier(name) == word


def test_names_of_other_letters_are_words_of_c_and_no_two_are_one() -> None:
    names = ["ünï", "uni", "ünì", "n", "α.q", "q", "β.q", "機械", "straße", "ñ"]
    words = [identifier(name) for name in names]
    assert len(set(words)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z_]\w*", word, re.ASCII) for word in words)
    assert words[0].startswith("uni_")


@pytest.mark.parametrize("text", ['a"b', "a\\", "???/", "ü\n", "%s", "plain_joint"])
def test_a_string_of_c_reads_back(text: str) -> None:
    assert ast.literal_eval(f"b{c.c_text(text)}").decode() == text


def test_a_title_ends_no_comment_and_begins_none() -> None:
    found = c.commented("a */ b /* c\n#error d --> e\\")
    assert not any(mark in found for mark in ("*/", "/*", "\n", "--", "\\"))


def test_a_name_without_a_letter_is_refused() -> None:
    with pytest.raises(DmframeError, match="expected a name with a letter or digit"):
        identifier("...")


def test_without_a_compiler_it_is_written_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.export.replay.find_compiler", lambda: None)
    dm.load("ur10_fast_kinematic").export(tmp_path / "out")
    assert "#define DM_EXACT 0" in (tmp_path / "out" / "samples.h").read_text(encoding="utf-8")
    assert "to rounding, since no compiler worked" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    if GCC is not None:
        assert reported(compiled(tmp_path / "out", *STRICT, *PLAIN)).returncode == 0


@needs_gcc
@pytest.mark.parametrize("name", ["replay", "Example", "samples", "string", "dm", "test"])
def test_a_name_that_is_another_files_is_changed(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.yaml"
    file.write_text(dm.load("ur10_fast_kinematic").text, encoding="utf-8")
    dm.load(file).set({"duration": 0.05}).export(tmp_path / "out")
    assert (tmp_path / "out" / f"{name}_controller.c").is_file()
    done = reported(compiled(tmp_path / "out", *STRICT, *PLAIN, "-I."))
    assert done.returncode == 0
    assert done.stdout.startswith(f"{name}_controller: ")


@needs_gcc
@pytest.mark.parametrize("word", ["-Ofast", "-ffast-math", "-ffinite-math-only"])
def test_it_is_not_compiled_where_what_is_not_finite_would_not_be_seen(word: str) -> None:
    folder = exported("ur10_fast")
    words = [str(GCC), "-std=c99", word, "-fsyntax-only", "ur10_fast.c"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "compile without -ffast-math" in done.stderr


@pytest.mark.parametrize("kind", ["c", "fmi3"])
def test_where_one_file_cannot_be_written_none_is_left(
    kind: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, count = Path.write_bytes, list[Path]()

    def full(file: Path, content: bytes) -> int:
        if file.is_relative_to(tmp_path):
            count.append(file)
        if len(count) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    graph = dm.load("ur10_fast_kinematic").set({"duration": 0.05})
    with pytest.raises(OutputError, match="no space left"):
        graph.export(tmp_path / "new" / "out", kind)
    assert list(tmp_path.iterdir()) == []
    graph.export(tmp_path / "new" / "out", kind)
