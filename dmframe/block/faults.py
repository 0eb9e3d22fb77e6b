"""Error messages of a block: faults of its parameter values, and exceptions of its own Python code."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Literal, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from dmframe.block.names import type_name
from dmframe.block.parameter import specs
from dmframe.common.errors import BlockError, DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.common.units import shorten

if TYPE_CHECKING:
    from dmframe.block.base import AbstractBlock


def parameter_faults(block: type[AbstractBlock], error: ValidationError, where: str) -> list[DmframeError]:
    """The faults of a block's parameters from pydantic's errors; their `path` is the parameter's name."""
    details = error.errors(include_url=False)
    missing = {str(detail["loc"][0]) for detail in details if detail["type"] == "missing"}
    unknown = {str(detail["loc"][0]) for detail in details if detail["type"] == "extra_forbidden"}
    # a misspelt parameter is reported once, as unknown, and not again as missing
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
        case "greater_than_equal" | "less_than_equal":
            (sign, bound), *_ = detail.get("ctx", {}).items()
            words = {"ge": "at least", "le": "at most"}
            return ValueFault(
                f"{at}: expected a whole number, {words[sign]} {bound}, found {_found(detail)}", path=path
            )
        case "int_type" | "int_parsing" | "int_from_float" | "int_parsing_size":
            return ValueFault(f"{at}: expected a whole number, found {_found(detail)}", path=path)
        case "bool_type" | "bool_parsing":
            return ValueFault(f"{at}: expected true or false, found {_found(detail)}", path=path)
        case _:
            return ValueFault(f"{at}: {detail['msg'][0].lower()}{detail['msg'][1:]}", path=path)


def _found(detail: ErrorDetails) -> str:
    """The value that was found, as YAML writes it."""
    found = detail["input"]
    return {True: "true", False: "false"}[found] if isinstance(found, bool) else shorten(repr(found), 40)


def strictly_typed(value: Any, kind: Any) -> Any:
    """The value of a parameter without a unit, without pydantic's conversions between true, 1, "1" and "yes".

    Raises `PydanticCustomError`, like pydantic's own validation.
    """
    kinds = _kinds(kind)
    if value is None or not kinds <= {bool, int, str, type(None)}:
        return value
    if isinstance(value, bool) and bool not in kinds and kinds & {int}:
        raise PydanticCustomError("int_type", "a whole number")
    if isinstance(value, str) and str not in kinds and int in kinds:
        raise PydanticCustomError("int_parsing", "a whole number")
    if not isinstance(value, bool) and kinds <= {bool, type(None)}:
        raise PydanticCustomError("bool_type", "true or false")
    return value


def _kinds(kind: Any) -> set[Any]:
    """The types that an annotation allows; for a Literal those of its values."""
    if get_origin(kind) is Literal:
        return {type(choice) for choice in get_args(kind)}
    if get_origin(kind) in (Union, UnionType):
        return {found for part in get_args(kind) for found in _kinds(part)}
    return {kind} if isinstance(kind, type) else {object}


@contextmanager
def fault_context(name: str, what: str) -> Iterator[None]:
    """Convert an exception of a block's own Python code to a `BlockError` of one line, with file and line."""
    try:
        yield
    except (DmframeError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a user's block may raise any exception, including SystemExit
        # the text of the lines is left out, since it would require reading the files
        frames = traceback.StackSummary.extract(traceback.walk_tb(error.__traceback__), lookup_lines=False)
        frame = [frames[-1], *(frame for frame in frames if not _foreign(Path(frame.filename)))][-1]
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else "no reason given"
        if BRANCH in reason:
            reason = (
                "Python cannot branch on a symbol; write ca.if_else(condition, value, other), ca.logic_and or ca.fmax"
            )
        raise BlockError(
            f"{name}: {what}, {Path(frame.filename).name}:{frame.lineno}: {type(error).__name__}: {reason}"
        ) from error


BRANCH = "Cannot compute the truth value"
"""Part of CasADi's message about `if`, `and`, `or`, `not`, `min` and `max` of a symbol."""
FOREIGN = ("casadi", "numpy")
"""Folders of libraries: a fault in one, or in the framework, is reported at the line that called it."""


def _foreign(file: Path) -> bool:
    framework = (
        file.is_relative_to(Path(__file__).parents[1]) or file.name == "<string>"
    )  # "<string>": code of dataclasses
    return framework or bool(set(FOREIGN) & set(file.parts))
