"""Arguments common to several calls: times, and lists of values by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from dmframe.errors import DmframeError, ValueFault
from dmframe.units import shorten, to_unit


def listed(values: Mapping[str, Iterable[Any]]) -> dict[str, list[Any]]:
    """Lists of values by name. Raises `ValueFault` for anything else."""
    example = '{"dynamics.Gamma": [1, 10]}'
    if not isinstance(values, Mapping):
        raise ValueFault(f"values: expected values by name, {example}, found {shorten(repr(values), 30)}")
    tried = dict[str, list[Any]]()
    for label, several in values.items():
        if not isinstance(label, str):
            raise ValueFault(f"values: expected values by name, {example}, found {shorten(repr(label), 30)}")
        some = isinstance(several, Iterable) and getattr(several, "ndim", 1) > 0  # an array may hold one number
        if isinstance(several, str | bytes | Mapping) or not some:
            raise ValueFault(
                f"values {label}: expected a list of values, {example}, found {shorten(repr(several), 30)}"
            )
        tried[label] = list(several)
    for label, several in tried.items():
        if not several:
            raise ValueFault(f"values {label}: expected at least one value, found none")
    return tried


def seconds(what: str, value: float | str) -> float:
    """A positive time [s]. Raises `ValueFault`."""
    try:
        found = to_unit(value, "s")
    except DmframeError as error:
        raise ValueFault(f"{what} {shorten(str(value))}: {error.text}") from None
    if not found > 0:
        raise ValueFault(f"{what} {shorten(str(value))}: expected a time above zero")
    return found
