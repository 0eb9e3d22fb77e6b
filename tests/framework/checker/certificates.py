"""Certificates of packaged graphs for tests, and the checker loaded as the separate file that it is."""

from __future__ import annotations

import base64
import importlib.util
import json
import shutil
import subprocess
from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import pytest

import dmframe as dm
from dmframe.certify.published import certificate_text

CHECKER = Path(dm.__file__).parent / "checker" / "check.py"


MISSING: Final = {
    "observed_tracking_forgetting_pi": "unknown rule 'gathered'",
    "torque_consistent_pi": "unknown rule 'log_det'",
    "ur10_consistent": "unknown rule 'log_det'",
    "ur10_fast_best": "unknown rule 'least_squares'",
    "ur10_slow_best": "unknown rule 'least_squares'",
}
"""Packaged graphs that the checkers refuse, and the rule that they do not know."""


@cache
def checker() -> ModuleType:
    """`check.py`, without the package around it."""
    spec = importlib.util.spec_from_file_location("certificate_checker", CHECKER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def text_of(name: str) -> str:
    graph = dm.load(name)
    return certificate_text(graph.verify().verdict, {"graph": name}, graph.intervals())


def certificate(name: str) -> dict[str, Any]:
    """A fresh copy of a graph's certificate."""
    found: dict[str, Any] = json.loads(text_of(name))
    return deepcopy(found)


def result(data: Any) -> dict[str, Any]:
    """Result of `check.py`."""
    found: dict[str, Any] = checker().check(deepcopy(data))
    return found


def outcome(data: Any) -> tuple[str, str]:
    """Outcome of the check, and the reason."""
    found = result(data)
    return found["status"], found.get("reason", "")


def negate(data: dict[str, Any], vector: int) -> None:
    """Change the sign of a vector by new instructions; other vectors keep theirs."""
    program, elements = data["program"], data["vectors"][vector]
    for name in {"const", "mul"} - {*program["operations"]}:
        program["operations"].append(name)
    program["constants"].append("-1")

    def instruction(name: str, a: int, b: int) -> int:
        for key, value in (("code", program["operations"].index(name)), ("a", a), ("b", b)):
            program[key].append(value)
        return len(program["code"]) - 1

    minus, moved = instruction("const", len(program["constants"]) - 1, 0), []
    for element in elements:
        if element >= 0:
            element = instruction("mul", minus, element)
        moved.append(element)
    data["vectors"].append(moved)


def replaced(data: dict[str, Any], vector: int) -> int:
    """Position of the negated copy of a vector."""
    negate(data, vector)
    return len(data["vectors"]) - 1


SCRIPT: Final = CHECKER.with_suffix(".js")
DRIVER: Final = (
    "const { check, read } = require(process.argv[1]);"
    "const files = JSON.parse(require('fs').readFileSync(0, 'utf8'));"
    "const result = (file) => {"
    "  try { return check(read(Buffer.from(file, 'base64'))); }"
    "  catch (fault) { return { status: 'refused', reason: fault.message }; }"
    "};"
    "console.log(JSON.stringify(files.map(result)));"
)
SAME: Final = (
    "statement",
    "robot",
    "only_at_exact_values_of",
    "conclusions",
    "not_checked",
    "assumed",
)
"""Parts of a result that both checkers have in common."""


def common(found: dict[str, Any]) -> dict[str, Any]:
    """These parts."""
    return {key: found.get(key) for key in SAME}


def node_path() -> str:
    """Path of Node; the test is skipped without it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    return node


def in_node(files: Sequence[dict[str, Any] | bytes]) -> list[dict[str, Any]]:
    """Result of `check.js` for each file, or content of a file."""
    contents = [file if isinstance(file, bytes) else json.dumps(file).encode() for file in files]
    done = subprocess.run(
        [node_path(), "-e", DRIVER, str(SCRIPT)],
        input=json.dumps([base64.b64encode(content).decode() for content in contents]),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found
