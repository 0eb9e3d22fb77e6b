"""Docstrings: what the section Parameters lists exists in the signature, or among the fields of the class."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
SOURCES: Final = ("dmframe", "blocks", "plants", "tests", "docs")
HEADING: Final = re.compile(r"^(\w[\w ]*)\n-+$", re.MULTILINE)
NAME: Final = re.compile(r"[A-Za-z_]\w*")
Named = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def listed(docstring: str) -> Iterator[str]:
    """Each unindented line of the section Parameters, up to the type."""
    parts = HEADING.split(docstring)
    for heading, body in zip(parts[1::2], parts[2::2], strict=True):
        if heading == "Parameters":
            yield from (line.split(" : ")[0] for line in body.split("\n") if line and line == line.lstrip())


def arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """Names of a function's arguments."""
    given = node.args
    stars = [argument for argument in (given.vararg, given.kwarg) if argument]
    return {argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, *stars)}


def fields(node: ast.ClassDef) -> set[str]:
    """Fields, properties and constructor arguments of a class; none for a class that inherits more."""
    if any(ast.unparse(base) not in ("NamedTuple", "Protocol") for base in node.bases):
        return set()
    made = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name in ("__init__", "__new__")]
    own = {ast.unparse(item.target) for item in node.body if isinstance(item, ast.AnnAssign)}
    derived = {item.name for item in node.body if isinstance(item, ast.FunctionDef) and item.decorator_list}
    return own.union(derived, *map(arguments, made))


def faults(source: str) -> Iterator[str]:
    """Lines that are no names, and unknown names; "None" states that a block has no parameters."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Named):
            for line in listed(ast.get_docstring(node) or ""):
                names = [name.strip().lstrip("*") for name in line.split(",")]
                known = fields(node) if isinstance(node, ast.ClassDef) else arguments(node)
                wrong = [name for name in names if not NAME.fullmatch(name) or (known and name not in known)]
                if wrong and not line.startswith("None"):
                    yield f"{node.name}, line {node.lineno}: {line}"


def test_parameters_in_docstrings_are_names_of_the_signature() -> None:
    files = [file for folder in SOURCES for file in sorted((ROOT / folder).rglob("*.py"))]
    assert len(files) > 1000
    assert [f"{file.relative_to(ROOT)}: {fault}" for file in files for fault in faults(file.read_text("utf-8"))] == []


@pytest.mark.parametrize("line", ["Stored elements of each argument.", "b"])
def test_a_description_in_the_place_of_a_name_and_an_unknown_name_are_found(line: str) -> None:
    text = f'def f(a):\n    """Text.\n\n    Parameters\n    ---\n    a\n        One.\n    {line}\n        Two.\n    """'
    assert list(faults(text)) == [f"f, line 1: {line}"]
    assert not list(faults(text.replace(line, "a, a : float")))
