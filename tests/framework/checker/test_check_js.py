"""`check.js` decides the same as `check.py`, an implementation that shares nothing with it."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import dmframe as dm
from dmframe.catalogue import graphs
from tests.framework.checker.certificates import CHECKER, certificate, checker, outcome, replaced
from tests.framework.checker.test_check import attacks, false_files, faults

SCRIPT: Final = CHECKER.with_suffix(".js")
DRIVER: Final = (
    "const { check } = require(process.argv[1]);"
    "const files = JSON.parse(require('fs').readFileSync(0, 'utf8'));"
    "console.log(JSON.stringify(files.map((file) => check(file))));"
)
SAME: Final = ("statement", "robot", "kappa_above", "only_at_exact_values_of", "conclusions", "believed", "assumed")
CHANGES: Final = 24
"""Corrupted files of one certificate."""


def node_path() -> str:
    """Path of Node; the test is skipped without it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    return node


def _in_node(files: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Result of `check.js` for each file."""
    done = subprocess.run(
        [node_path(), "-e", DRIVER, str(SCRIPT)], input=json.dumps(files), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found


def _agrees(data: dict[str, Any], found: dict[str, Any], what: str = "") -> str:
    """The outcome on which both agree: a file that is re-proved has the same result in both."""
    status, reason = outcome(data)
    assert (found["status"] == "re-proved") == (status == "re-proved"), (what, status, reason, found)
    if status == "re-proved":
        assert found["log2_error"] <= -300
        expected = checker().check(data)
        for key in SAME:
            assert found[key] == expected[key], (what, key)
    return str(found["status"])


@pytest.mark.parametrize("name", sorted(graphs()))
def test_both_prove_the_same_of_every_graph(name: str) -> None:
    node_path()
    if not dm.load(name).verify().proved:
        pytest.skip("it has no proof")
    data = certificate(name)
    (found,) = _in_node([data])
    assert _agrees(data, found) == "re-proved"


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast"])
def test_a_seeded_fault_is_refuted(name: str) -> None:
    node_path()
    files, names = [], []
    for fault, apply in faults(certificate(name)):
        data = certificate(name)
        apply(data)
        files.append(data)
        names.append(fault)
    found = {fault: result["status"] for fault, result in zip(names, _in_node(files), strict=True)}
    assert len(found) > 20
    assert set(found.values()) == {"refuted"}, found


def test_a_file_that_states_more_than_is_true_is_not_accepted() -> None:
    node_path()
    files = [*false_files(), *attacks()]
    for (what, data, _), found in zip(files, _in_node([data for _, data, _ in files]), strict=True):
        _agrees(data, found, what)


def _corrupted(name: str, seed: int) -> dict[str, Any]:
    """A certificate with one entry changed at random."""
    data, rng = certificate(name), np.random.default_rng(seed)

    def one(items: Any) -> Any:
        return items[int(rng.integers(len(items)))]

    def negated(text: str) -> str:
        return str(-checker().rational(text))

    def constant() -> None:
        place = int(rng.integers(len(data["program"]["constants"])))
        data["program"]["constants"][place] = one(["7", negated(data["program"]["constants"][place])])

    def operand() -> None:
        program = data["program"]
        computed = [k for k, code in enumerate(program["code"]) if program["operations"][code] in ("add", "sub", "mul")]
        place = one(computed)
        program[one("ab")][place] = int(rng.integers(place))

    def operation() -> None:
        program = data["program"]
        program["code"][one(range(len(program["code"])))] = int(rng.integers(2, len(program["operations"])))

    def element() -> None:
        _, elements = one([item for item in data["vectors"] if item[1]])
        elements[int(rng.integers(len(elements)))] = int(rng.integers(-1, len(data["program"]["code"])))

    def rate() -> None:
        label = one(sorted(data["rates"]))
        data["rates"][label] = replaced(data, data["rates"][label])

    def step() -> None:
        if data.get("steps"):
            parts = data["steps"][0]["parts"]
            key, other = one(sorted(parts)), one(sorted(parts))
            parts[key] = parts[other]

    def part() -> None:
        if data["terms"]:
            term, other = one(data["terms"]), one(data["terms"])
            term["parts"][one(sorted(term["parts"]))] = one(sorted(other["parts"].values()))

    def role() -> None:
        if data["terms"]:
            one(data["terms"])["role"] = one(["stored", "dissipated", "residual", "cross"])

    def number() -> None:
        values = data["numbers"][one(sorted(data["numbers"]))]
        place = int(rng.integers(len(values)))
        values[place] = one(
            ["0", "1/3", ["-1", "1"], negated(values[place]) if isinstance(values[place], str) else "2"]
        )

    def conclusion() -> None:
        one(data["conclusions"])["vector"] = int(rng.integers(len(data["vectors"])))

    def kind() -> None:
        one(data["symbols"])["kind"] = one(["parameter", "constant", "trajectory", "command", "state"])

    def projection() -> None:
        if data.get("projections"):
            item, (key, other) = one(data["projections"]), rng.permutation(["lower", "true", "upper"])[:2]
            item[key], item[other] = item[other], item[key]

    def joint() -> None:
        if data.get("masses"):
            item = one(one(data["masses"])["joints"])
            values = item[one(["axis", "rotation"])]
            values[int(rng.integers(len(values)))] = one(["0", "1", "-1", "3/5"])

    def body() -> None:
        if data.get("masses"):
            data["masses"][0][one(["position", "translations", "inertia"])] = int(rng.integers(len(data["vectors"])))

    changes = [
        constant,
        operand,
        operation,
        element,
        rate,
        part,
        role,
        number,
        conclusion,
        kind,
        projection,
        joint,
        body,
    ]
    one([*changes, step])()
    return data


@pytest.mark.parametrize(
    "name", ["pendulum", "arm2_joint", "ur10_fast", "torque_consistent_pi", "ur10_slow_repetitive"]
)
def test_both_decide_the_same_of_a_corrupted_file(name: str) -> None:
    node_path()
    files = list(map(partial(_corrupted, name), range(CHANGES)))
    found = [
        _agrees(data, result, f"{name}, seed {seed}")
        for seed, (data, result) in enumerate(zip(files, _in_node(files), strict=True))
    ]
    assert found.count("refuted") > 2


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
    for text in ("{}", "[]", "null", "not json", '{"format": "dmframe-certificate"}', "[" * 100_000):
        path.write_text(text)
        done = run()
        assert (done.returncode, done.stderr) == (2, ""), text[:30]
