"""C source of the closed loop: its functions, and the loop of `loop.c` or `batch.c`.

Every name begins with ``dm_`` and, except for the entry points, is static: a function ``step`` or ``sample`` could
silently be replaced by one of the C library.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from importlib.resources import files
from typing import Any, Final

import casadi as ca

from dmframe.codegen.function import ONE, SIMD, UNITS, Dialect, written
from dmframe.diagram.parts import Parts, split
from dmframe.diagram.rosenbrock import ROS34PW2, Rosenbrock


def loop_source(parts: Parts, *, implicit: bool = False) -> str:
    """C of a whole run, with gains, true parameters and initial states as arguments.

    It integrates with rk4, or with ros34pw2 if `implicit`. Raises `EngineError` for an operation without a C form.
    """
    return _loop(parts, implicit, "loop.c", ONE)


def simd_source(parts: Parts, *, implicit: bool = False) -> str:
    """C of several whole runs at once (SIMD), which stores figures of the outputs; otherwise as `loop_source`."""
    return _loop(parts, implicit, "simd.c", SIMD)


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
    """Coefficients of a method, exact doubles."""

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
    """C of one step of a controller, (z, measured, t, T, p) -> (z', u), and the number of constants, functions of p."""
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
            UNITS,
            *numbers,
            *(written(f, dialect, units=True) for f in functions),
            "#if DM_UNIT == 0",
            *map(shipped, frames),
            "#endif",
            "",
        ]
    )


def helpers(*texts: str) -> str:
    """Functions of `arithmetic.h` that some texts call; compilers warn of unused static functions."""
    words = set(re.findall(r"\bdm_\w+", "\n".join(texts)))
    return _HELPER.sub(lambda match: match.group() if match["name"] in words else "", shipped("arithmetic.h"))


_HELPER: Final = re.compile(
    r"^static inline \w+ (?P<name>dm_\w+)\([^)]*\) \{(?:[^\n]*\}\n|\n.*?^\}\n)\n?", re.MULTILINE | re.DOTALL
)
"""Pattern of a function of that file; none of them calls another."""


def shipped(name: str) -> str:
    """A C file of this package."""
    return files("dmframe.codegen").joinpath(name).read_text(encoding="utf-8")
