"""`check.js` decides the same as `check.py`, an implementation that shares nothing with it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest

import dmframe as dm
from dmframe.catalogue import graphs
from tests.framework.checker.attacks import holes, more
from tests.framework.checker.certificates import (
    MISSING,
    SCRIPT,
    certificate,
    checker,
    common,
    in_node,
    node_path,
    replaced,
)
from tests.framework.checker.corruptions import corrupted
from tests.framework.checker.false_theorems import false_theorems
from tests.framework.checker.hidden import hidden
from tests.framework.checker.readings import equals, readings, texts
from tests.framework.checker.test_check import allows, faults
from tests.framework.checker.written import stable

CHANGES: Final = 24
"""Corrupted files of one certificate."""


def _agrees(data: dict[str, Any], found: dict[str, Any], what: str = "") -> str:
    """The outcome on which both agree; a file that is re-proved has the same result in both."""
    expected = checker().check(data)
    assert found["status"] == expected["status"], (what, expected, found)
    if found["status"] == "re-proved":
        assert found["log2_error"] <= -300
        assert common(found) == common(expected), what
    return str(found["status"])


@pytest.mark.parametrize("name", sorted(graphs()))
def test_both_prove_the_same_of_every_graph(name: str) -> None:
    node_path()
    if not dm.load(name).verify().proved:
        pytest.skip("it has no proof")
    data = certificate(name)
    (found,) = in_node([data])
    assert _agrees(data, found) == ("refused" if name in MISSING else "re-proved")


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast"])
def test_a_seeded_fault_is_refuted(name: str) -> None:
    node_path()
    files, names = [], []
    for fault, apply in faults(certificate(name)):
        data = certificate(name)
        apply(data)
        files.append(data)
        names.append(fault)
    found = {fault: result["status"] for fault, result in zip(names, in_node(files), strict=True)}
    assert len(found) > 20
    assert set(found.values()) == {"refuted"}, found


def test_a_file_that_states_more_than_is_true_is_not_accepted() -> None:
    node_path()
    files = [*holes(), *more(), *false_theorems(), *readings(), *hidden()]
    for (what, data, allowed), found in zip(files, in_node([data for _, data, _ in files]), strict=True):
        assert allows(found, allowed), (what, found)
        _agrees(data, found, what)


def test_a_true_file_with_an_expression_that_is_written_twice_is_accepted() -> None:
    node_path()
    files = list(equals())
    for (what, data, concluded), found in zip(files, in_node([data for _, data, _ in files]), strict=True):
        assert found["conclusions"] == concluded, what
        _agrees(data, found, what)


def test_texts_that_are_no_certificate_are_refused() -> None:
    node_path()
    assert [found["status"] for found in in_node([json.dumps(stable().data).encode()])] == ["re-proved"]
    files = dict(texts())
    found = dict(zip(files, in_node(list(files.values())), strict=True))
    assert [what for what in files if found[what]["status"] != "refused"] == []


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast", "ur10_saturated", "ur10_slow_repetitive"])
def test_both_decide_the_same_of_a_corrupted_file(name: str) -> None:
    node_path()
    files = [corrupted(name, seed) for seed in range(CHANGES)]
    found = [
        _agrees(file[0], result, f"{name}, seed {seed}: {file[1:]}")
        for seed, (file, result) in enumerate(zip(files, in_node([file[0] for file in files]), strict=True))
    ]
    assert len(found) - found.count("re-proved") > CHANGES / 4


def test_it_runs_alone_and_its_exit_status_is_the_outcome(tmp_path: Path) -> None:
    path, data = tmp_path / "file.json", certificate("pendulum")

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [node_path(), str(SCRIPT), str(path), *words]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    path.write_text(json.dumps(data))
    done = run("--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout).keys() == checker().check(data).keys()
    path.write_text(json.dumps({**data, "rates": {**data["rates"], "arm.dq": replaced(data, data["rates"]["arm.dq"])}}))
    done = run()
    assert (done.returncode, done.stderr) == (1, "")
    assert "does not hold" in done.stdout
    text = json.dumps({**data, "about": {"a": '"b": \\"c": {}'}})
    path.write_text(text)
    assert run().returncode == 0
    for wrong in (text.replace('"about"', '"about": {}, "about"'), text.replace('"over"', '"\\u006fver": 1, "over"')):
        path.write_text(wrong)
        done = run()
        assert (done.returncode, done.stderr) == (2, "")
        assert "a key occurs twice" in done.stdout
