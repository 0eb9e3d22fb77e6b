"""Certificates of packaged graphs for tests, and the checker loaded as the separate file that it is."""

from __future__ import annotations

import importlib.util
import json
from copy import deepcopy
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import dmframe as dm
from dmframe.certify.published import certificate_text

CHECKER = Path(dm.__file__).parent / "checker" / "check.py"


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


def outcome(data: Any) -> tuple[str, str]:
    """Outcome of the check, and the reason."""
    check = checker()
    try:
        check.check(data)
    except check.Refuted as error:
        return "refuted", str(error)
    except (check.Refused, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        return "refused", str(error)
    return "re-proved", ""


def negate(data: dict[str, Any], vector: int) -> None:
    """Change the sign of a vector by new instructions; other vectors keep theirs."""
    program, (rows, elements) = data["program"], data["vectors"][vector]
    if "neg" not in program["operations"]:
        program["operations"].append("neg")
    moved = []
    for element in elements:
        if element >= 0:
            program["code"].append(program["operations"].index("neg"))
            program["a"].append(element)
            program["b"].append(element)
            element = len(program["code"]) - 1
        moved.append(element)
    data["vectors"].append([rows, moved])


def replaced(data: dict[str, Any], vector: int) -> int:
    """Position of the negated copy of a vector."""
    negate(data, vector)
    return len(data["vectors"]) - 1
