"""The closed loop as C: its own functions written out, and over them the loop of `loop.c`.

Every name begins with ``dm_`` and, but for the entry, is static: a function that were called ``step`` or ``sample``
could be taken for the C library's, which returns at once and says nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from importlib.resources import files
from typing import Any, Final

import casadi as ca

from dmframe.codegen.function import LANES, ONE, Dialect, written
from dmframe.diagram.parts import Parts, split
from dmframe.diagram.rosenbrock import ROS34PW2, Rosenbrock


def loop_source(parts: Parts, *, implicit: bool = False) -> str:
    """The C of a whole run; gains, true parameters and start states are its arguments.

    It integrates with rk4, or with ros34pw2 where it is `implicit`. Raises `EngineError` where an expression holds what
    C has no word for.
    """
    return _loop(parts, implicit, "loop.c", ONE)


def lanes_source(parts: Parts, *, implicit: bool = False) -> str:
    """The C of several whole runs at once, of which figures of the outputs are kept; as `loop_source` otherwise."""
    return _loop(parts, implicit, "lanes.c", LANES)


def _loop(parts: Parts, implicit: bool, frame: str, dialect: Dialect) -> str:
    hoisted, more = parts.implicit if implicit else (parts.hoisted, None)
    sizes = {**parts.sizes, "C": hoisted.constants.numel_out(0), "MOVED": int(parts.moved)}
    functions = [hoisted.constants, hoisted.trajectory, hoisted.sample, hoisted.rate, hoisted.clip]
    frames = ("integrate.c", frame)
    if more is None:
        return _assembled(sizes, functions, frames, dialect)
    sizes |= {"F": more.solve.numel_in(0), "STAGES": ROS34PW2.stages}
    return _assembled(sizes, [*functions, *more], frames, dialect, _coefficients(ROS34PW2))


def _coefficients(method: Rosenbrock) -> list[str]:
    """A method's numbers, to the last bit of a double."""

    def row(values: Sequence[Fraction]) -> str:
        return "{" + ", ".join(map(repr, map(float, values or (Fraction(0),)))) + "}"

    lines = [f"static const double dm_method_gamma = {float(method.gamma)!r};"]
    for name, column in {"nodes": method.nodes, "drifts": method.drifts, "m": method.m}.items():
        lines.append(f"static const double dm_method_{name}[DM_STAGES] = {row(column)};")
    for name, rows in {"a": method.a, "c": method.c}.items():
        listed = ", ".join(map(row, rows))
        lines.append(f"static const double dm_method_{name}[DM_STAGES][DM_STAGES] = {{{listed}}};")
    return lines


def control_source(control: Any) -> tuple[str, int]:
    """The C of one step of a controller, (z, measured, t, T, p) -> (z', u), and how many constants follow from p."""
    inputs = [ca.SX.sym(f"i{k}", control.numel_in(k)) for k in range(5)]
    (step,), constants = split({"control": (inputs[:4], control(*inputs))}, inputs[4])
    sizes = {"Z": control.numel_out(0), "M": control.numel_in(1), "U": control.numel_out(1)}
    return _assembled(sizes, [constants, step], ["control.c"]), constants.numel_out(0)


def _assembled(
    sizes: Mapping[str, int],
    functions: Sequence[Any],
    frames: Sequence[str],
    dialect: Dialect = ONE,
    numbers: Sequence[str] = (),
) -> str:
    return "\n".join(
        [
            *map(shipped, dialect.arithmetic),
            *(f"#define DM_{name} {size}" for name, size in sizes.items()),
            '#define DM_EXPORT __attribute__((visibility("default")))',
            *numbers,
            *(written(f, dialect) for f in functions),
            *map(shipped, frames),
        ]
    )


def helpers(*texts: str) -> str:
    """`arithmetic.h` with those functions alone that some texts call.

    A compiler such as clang warns of a static function that nothing calls, and a reader need not read it.
    """
    words = set(re.findall(r"\bdm_\w+", "\n".join(texts)))
    return _HELPER.sub(lambda match: match.group() if match["name"] in words else "", shipped("arithmetic.h"))


_HELPER: Final = re.compile(
    r"^static inline \w+ (?P<name>dm_\w+)\([^)]*\) \{(?:[^\n]*\}\n|\n.*?^\}\n)\n?", re.MULTILINE | re.DOTALL
)
"""A function of that file; none of them calls another."""


def shipped(name: str) -> str:
    """A file of C that comes with this package."""
    return files("dmframe.codegen").joinpath(name).read_text(encoding="utf-8")
