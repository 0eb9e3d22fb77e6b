"""A target is a function of the graph and a row of one table, as docs/how_to/extend.md shows."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import dmframe as dm
from dmframe.cli.app import app
from dmframe.common.errors import DmframeError, EngineError, OutputError, ValueFault
from dmframe.export import TARGETS
from dmframe.export.program import program_of
from dmframe.export.replay import samples_of
from dmframe.program import by_code
from tests.page_code import page_module

PAGE = "docs/how_to/extend.md"
SAMPLES = 20


@pytest.fixture
def target(tmp_path: Path) -> ModuleType:
    return page_module(PAGE, "plain_python.py", tmp_path)


@pytest.fixture(scope="module")
def graph() -> Any:
    return dm.load("arm2_joint").set({"duration": f"{SAMPLES * 2} ms"})


def differences(graph: Any, target: ModuleType, folder: Path) -> list[float]:
    """Largest difference of each sample from the simulation, from equal states."""
    (file,) = graph.export(folder / "exported", target.files)
    spec = importlib.util.spec_from_file_location("law", file)
    assert spec is not None
    assert spec.loader is not None
    law = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(law)
    samples, found = samples_of(graph, program_of(graph)), list[float]()
    assert len(samples.times) == SAMPLES
    assert law.start(samples.measured[0], [samples.times[0]], [law.PERIOD], law.P) == pytest.approx(samples.states[0])
    for k, t in enumerate(samples.times):
        after, commands = law.control(samples.states[k], samples.measured[k], [t], [law.PERIOD], law.P)
        expected = np.concatenate([samples.states[k + 1], samples.commanded[k]])
        found.append(float(np.max(np.abs(np.concatenate([after, commands]) - expected) / (1 + np.abs(expected)))))
    return found


def test_the_target_of_the_page_computes_the_samples_of_a_simulation(
    graph: Any, target: ModuleType, tmp_path: Path
) -> None:
    assert max(differences(graph, target, tmp_path)) < 1e-12


@pytest.mark.parametrize(("name", "wrong"), [("sub", "({} + {})"), ("sin", "math.cos({})"), ("neg", "{}")])
def test_a_wrong_rule_of_the_target_is_found(
    graph: Any, target: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, wrong: str
) -> None:
    ((code, rule),) = by_code({name: wrong.format}).items()
    assert code in target.RULES
    monkeypatch.setitem(target.RULES, code, rule)
    assert max(differences(graph, target, tmp_path)) > 1e-6


def test_an_operation_without_a_rule_is_refused_and_nothing_is_written(
    graph: Any, target: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ((code, _),) = by_code({"cos": ""}).items()
    monkeypatch.delitem(target.RULES, code)
    with pytest.raises(EngineError, match=f"no rule for CasADi's instruction {code}"):
        graph.export(tmp_path / "exported", target.files)
    assert not (tmp_path / "exported").exists()


def test_a_row_of_the_table_is_enough_for_the_command_line(target: ModuleType, tmp_path: Path) -> None:
    assert target.files
    script = (
        "from dmframe.export import TARGETS, Target\n"
        'TARGETS["plain"] = Target("The controller as a module of plain Python.", "plain_python:files")\n'
        "from dmframe.cli import main\n"
        "main()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "COLUMNS": "120"}

    def ran(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", script, "export", *words],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env=environment,
        )

    help_text = " ".join(ran("-h").stdout.split())
    for name, about in [*((name, target.about) for name, target in TARGETS.items()), ("plain", "of plain Python.")]:
        assert f"--{name} " in help_text
        assert about in help_text
    done = ran("arm2_joint", "out", "--plain")
    assert (done.returncode, done.stdout) == (0, "wrote out: arm2_joint.py\n"), done.stderr
    assert (tmp_path / "out" / "arm2_joint.py").is_file()
    assert (
        f"expected one of {', '.join(f'--{name}' for name in TARGETS)} and --plain, found none"
        in ran("arm2_joint", "new").stderr
    )


def test_each_packaged_target_has_its_option_and_its_function() -> None:
    printed = CliRunner().invoke(app, ["export", "-h"]).output
    for name, target in TARGETS.items():
        assert f"--{name} " in printed
        assert callable(target.function)


@pytest.mark.parametrize(
    ("returned", "text"),
    [
        (None, "expected the target to return files by name, found None"),
        ({}, "expected the target to return files by name, found {}"),
        ({"/tmp/x": ""}, "expected the target to name files below the folder, found '/tmp/x'"),
        ({"a/../../x": ""}, "expected the target to name files below the folder"),
        ({3: ""}, "expected the target to name files below the folder, found 3"),
        ({"a": 3}, "expected a as str or bytes, found int"),
    ],
)
def test_what_is_not_a_set_of_files_is_refused_and_nothing_is_written(
    graph: Any, returned: Any, text: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueFault, match=text):
        graph.export(tmp_path / "new", lambda _: returned)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["rust", 3, [], None])
def test_an_unknown_target_is_refused_with_the_known_ones(graph: Any, kind: Any, tmp_path: Path) -> None:
    with pytest.raises(DmframeError, match=f"kind: expected {', '.join(TARGETS)}, or a function of the graph; found"):
        graph.export(tmp_path / "new", kind)


def test_a_target_of_ones_own_writes_to_a_new_folder_only(graph: Any, tmp_path: Path) -> None:
    files = graph.export(tmp_path / "new", lambda found: {"b/a.txt": found.name, "c.bin": b"\x00"})
    assert [file.read_bytes() for file in files] == [b"arm2_joint", b"\x00"]
    with pytest.raises(OutputError, match="exists already; choose a new folder"):
        graph.export(tmp_path / "new", lambda _: {"d": ""})
