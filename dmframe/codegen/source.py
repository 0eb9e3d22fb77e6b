"""The closed loop as C: its own functions written out, and over them the loop of `loop.c`.

Every name begins with ``dm_`` and, but for the entry, is static: a function that were called ``step`` or ``sample``
could be taken for the C library's, which returns at once and says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import casadi as ca

from dmframe.codegen.function import LANES, ONE, Dialect, written
from dmframe.diagram.parts import Parts, split


def loop_source(parts: Parts) -> str:
    """The C of a whole run; gains, true parameters and start states are its arguments.

    Raises `EngineError` where an expression holds what C has no word for.
    """
    return _assembled(*_of(parts), "loop.c")


def lanes_source(parts: Parts) -> str:
    """The C of several whole runs at once, of which figures of the outputs are kept. Raises as `loop_source` does."""
    return _assembled(*_of(parts), "lanes.c", LANES)


def _of(parts: Parts) -> tuple[dict[str, int], list[Any]]:
    """Sizes and functions."""
    hoisted = parts.hoisted
    sizes = {**parts.sizes, "C": hoisted.constants.numel_out(0), "MOVED": int(parts.moved)}
    return sizes, [hoisted.constants, hoisted.trajectory, hoisted.sample, hoisted.rate, hoisted.clip]


def control_source(control: Any) -> tuple[str, int]:
    """The C of one step of a controller, (z, measured, t, T, p) -> (z', u), and how many constants follow from p."""
    inputs = [ca.SX.sym(f"i{k}", control.numel_in(k)) for k in range(5)]
    (step,), constants = split({"control": (inputs[:4], control(*inputs))}, inputs[4])
    sizes = {"Z": control.numel_out(0), "M": control.numel_in(1), "U": control.numel_out(1)}
    return _assembled(sizes, [constants, step], "control.c"), constants.numel_out(0)


def _assembled(sizes: Mapping[str, int], functions: Sequence[Any], frame: str, dialect: Dialect = ONE) -> str:
    return "\n".join(
        [
            *map(shipped, dialect.arithmetic),
            *(f"#define DM_{name} {size}" for name, size in sizes.items()),
            '#define DM_EXPORT __attribute__((visibility("default")))',
            *(written(f, dialect) for f in functions),
            shipped(frame),
        ]
    )


def shipped(name: str) -> str:
    """A file of C that comes with this package."""
    return files("dmframe.codegen").joinpath(name).read_text(encoding="utf-8")
