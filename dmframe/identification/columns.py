"""Columns of a log by signal: names of ur_rtde recordings, plain names, and names given by the user."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from dmframe.common.errors import MissingError, UnknownNameError, ValueFault
from dmframe.identification.table import LogTable

_TIME: Final = ("t", "time", "timestamp")
_STEMS: Final[Mapping[str, tuple[str, ...]]] = {
    "q": ("q", "actual_q"),
    "dq_c": ("dq_c", "target_qd"),
    "q_c": ("q_c", "target_q"),
    "tau": ("tau",),
    "current": ("current", "actual_current"),
}
"""Signals of the joints, with the beginnings of their columns' names; a number follows, from 0 or from 1."""
OPTIONAL: Final = ("tau", "current")
"""Signals that are not read unless there is a column for each joint."""


def signals_of(table: LogTable, n: int, given: Sequence[str] = ()) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Signals t (N,), q, and dq_c or q_c or both (N, n); tau and current if there are any; and the column of each.

    The columns are ``{"q_1": "actual_q_0"}``.

    Parameters
    ----------
    n
        Number of joints.
    given
        ``name=column``, for example ``q_1=shoulder_position``.

    Raises
    ------
    UnknownNameError, MissingError, ValueFault
        A given name or column does not exist, a signal is missing, or there are columns of more joints.
    """
    names = ["t", *(f"{stem}_{j}" for stem in _STEMS for j in range(1, n + 1))]
    used = _given(table, names, given)
    time = next((column for column in table.columns if column.lower() in _TIME), None)
    if time is not None:
        used.setdefault("t", time)
    for stem, stems in _STEMS.items():
        if f"{stem}_1" in used:
            continue
        for other in stems:
            places = sorted(int(m[1]) for name in table.columns if (m := re.fullmatch(rf"{other}_?(\d+)", name)))
            if not places or (stem in OPTIONAL and len(places) != n):
                continue
            if len(places) != n:
                text = (
                    f"columns {other}_: expected those of {n} joints, found {len(places)}; give a robot with "
                    f"these joints, a graph with robot.free, or --columns {stem}_1=..."
                )
                raise ValueFault(text, location=table.name)
            label = next(name for name in table.columns if re.fullmatch(rf"{other}_?{places[0]}", name))
            form = label[: -len(str(places[0]))]
            used |= {f"{stem}_{j}": f"{form}{place}" for j, place in enumerate(places, 1)}
            break
    found = dict[str, np.ndarray]()
    if "t" not in used:
        raise MissingError(f"expected a column of time: {', '.join(_TIME)}, or --columns t=NAME", location=table.name)
    found["t"] = table.columns[used["t"]]
    for stem in _STEMS:
        own = [used.get(f"{stem}_{j}") for j in range(1, n + 1)]
        if all(column is not None for column in own):
            found[stem] = np.column_stack([table.columns[str(column)] for column in own])
        elif any(own):
            lacking = next(j for j, column in enumerate(own, 1) if column is None)
            raise MissingError(
                f"--columns: expected {stem}_{lacking} too; the robot has {n} joints", location=table.name
            )
    if "q" not in found:
        raise MissingError(
            "expected positions q_1, ... or actual_q_0, ...; name them by --columns q_1=NAME", location=table.name
        )
    if "dq_c" not in found and "q_c" not in found:
        text = (
            "expected commands: velocities dq_c_1, ... or target_qd_0, ..., or positions q_c_1, ... "
            "or target_q_0, ...; name them by --columns dq_c_1=NAME"
        )
        raise MissingError(text, location=table.name)
    return found, used


def _given(table: LogTable, names: Sequence[str], given: Sequence[str]) -> dict[str, str]:
    used = dict[str, str]()
    for text in given:
        name, equals, column = (part.strip() for part in text.partition("="))
        if not equals:
            raise ValueFault(f"--columns {text}: expected name=column")
        if name not in names:
            raise UnknownNameError(f"--columns {text}", "signal", name, names)
        if column not in table.columns:
            raise UnknownNameError(f"--columns {text}", "column", column, table.columns)
        used[name] = column
    return used
