"""Faults of a block in our words: of the values of its parameters, and of what its own Python raises."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from dmframe.block.names import type_name
from dmframe.errors import BlockError, DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.parameter import specs

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock


def parameter_faults(block: type[AbstractBlock], error: ValidationError, where: str) -> list[DmframeError]:
    """The faults of a block's parameters, in our words; their `path` is the parameter's name."""
    details = error.errors(include_url=False)
    missing = {str(detail["loc"][0]) for detail in details if detail["type"] == "missing"}
    unknown = {str(detail["loc"][0]) for detail in details if detail["type"] == "extra_forbidden"}
    # a misspelt parameter is told once, as that, and not a second time as a missing one
    misspelt = {
        near[0] for name in unknown if (near := get_close_matches(name, block.model_fields, 1)) and near[0] in missing
    }
    return [
        _fault(block, detail, where)
        for detail in details
        if not (detail["type"] == "missing" and detail["loc"][0] in misspelt)
    ]


def _fault(block: type[AbstractBlock], detail: ErrorDetails, where: str) -> DmframeError:
    name = str(detail["loc"][0]) if detail["loc"] else ""
    at = f"{where}.{name}" if name else where
    kind, path = type_name(block), detail["loc"]
    match detail["type"]:
        case "extra_forbidden":
            return UnknownNameError(at, f"parameter of {kind}", name, block.model_fields, path=path)
        case "missing":
            spec = specs(block).get(name)
            unit = f" [{spec.unit}]" if spec and spec.unit else ""
            return MissingError(f"{where}: {kind} needs the parameter {name}{unit}", path=path)
        case "value_error":
            return ValueFault(f"{at}: {str(detail['msg']).removeprefix('Value error, ')}", path=path)
        case "literal_error":
            expected = detail.get("ctx", {}).get("expected", "")
            return ValueFault(f"{at}: expected {expected}, found {detail['input']!r}", path=path)
        case "tuple_type":
            return ValueFault(f"{at}: expected a list, found {detail['input']!r}", path=path)
        case _:
            return ValueFault(f"{at}: {detail['msg'][0].lower()}{detail['msg'][1:]}", path=path)


@contextmanager
def told_by(name: str, what: str) -> Iterator[None]:
    """Tell what a block's own Python raises with its file and line, in one line, as its fault."""
    try:
        yield
    except (DmframeError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a user's block may raise anything, SystemExit too
        frames = traceback.extract_tb(error.__traceback__)
        frame = [frames[-1], *(frame for frame in frames if not _foreign(Path(frame.filename)))][-1]
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "no reason given"
        raise BlockError(
            f"{name}: {what}, {Path(frame.filename).name}:{frame.lineno}: {type(error).__name__}: {reason}"
        ) from error


FOREIGN = ("casadi", "numpy")
"""Folders of libraries: a fault in one, or in the framework, is told at the line that called it."""


def _foreign(file: Path) -> bool:
    framework = file.is_relative_to(Path(__file__).parents[1]) or file.name == "<string>"  # what dataclasses generate
    return framework or bool(set(FOREIGN) & set(file.parts))
