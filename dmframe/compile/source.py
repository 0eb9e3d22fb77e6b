"""The closed loop as C: its own functions written out, and over them the loop of `loop.c`.

Every name begins with ``dm_`` and, but for the entry, is static: a function that were called ``step`` or ``sample``
could be taken for the C library's, which returns at once and says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, Final

import casadi as ca

from dmframe.compile.parts import Parts, split
from dmframe.errors import EngineError

_BINARY: Final = {
    "ADD": "{} + {}",
    "SUB": "{} - {}",
    "MUL": "{} * {}",
    "DIV": "{} / {}",
    "LT": "{} < {}",
    "LE": "{} <= {}",
    "EQ": "{} == {}",
    "NE": "{} != {}",
    "AND": "{} && {}",
    "OR": "{} || {}",
    "IF_ELSE_ZERO": "{} ? {} : 0",
    "FMIN": "dm_fmin({}, {})",
    "FMAX": "dm_fmax({}, {})",
    "CONSTPOW": "pow({}, {})",
}
_UNARY: Final = {
    "ASSIGN": "{}",
    "LIFT": "{}",
    "NEG": "-{}",
    "NOT": "!{}",
    "SQ": "{0} * {0}",
    "TWICE": "{0} + {0}",
    "INV": "1 / {}",
    "SIGN": "dm_sign({})",
    "TANH": "dm_tanh({})",
}
_LIBRARY_ONE: Final = "EXP LOG SQRT TAN ASIN ACOS ATAN FLOOR CEIL FABS ERF SINH COSH ASINH ACOSH ATANH LOG1P EXPM1"
_LIBRARY_TWO: Final = "POW FMOD COPYSIGN ATAN2 HYPOT REMAINDER"
_FORMS: Final = {
    getattr(ca, f"OP_{name}"): form
    for name, form in (
        *_BINARY.items(),
        *_UNARY.items(),
        *((name, name.lower() + "({})") for name in _LIBRARY_ONE.split()),
        *((name, name.lower() + "({}, {})") for name in _LIBRARY_TWO.split()),
    )
}
_ANGLES: Final = {ca.OP_SIN: 0, ca.OP_COS: 1}


def loop_source(parts: Parts) -> str:
    """The C of a whole run; gains, true parameters and start states are its arguments.

    Raises `EngineError` where an expression holds what C has no word for.
    """
    hoisted = parts.hoisted
    sizes = {**parts.sizes, "C": hoisted.constants.numel_out(0), "MOVED": int(parts.moved)}
    functions = [hoisted.constants, hoisted.trajectory, hoisted.sample, hoisted.rate, hoisted.clip]
    return _assembled(sizes, functions, "loop.c")


def control_source(control: Any) -> tuple[str, int]:
    """The C of one step of a controller, (z, measured, t, T, p) -> (z', u), and how many constants follow from p."""
    inputs = [ca.SX.sym(f"i{k}", control.numel_in(k)) for k in range(5)]
    (step,), constants = split({"control": (inputs[:4], control(*inputs))}, inputs[4])
    sizes = {"Z": control.numel_out(0)}
    return _assembled(sizes, [constants, step], "control.c"), constants.numel_out(0)


def _assembled(sizes: Mapping[str, int], functions: Sequence[Any], frame: str) -> str:
    return "\n".join(
        [
            shipped("arithmetic.h"),
            *(f"#define DM_{name} {size}" for name, size in sizes.items()),
            '#define DM_EXPORT __attribute__((visibility("default")))',
            *(written(f) for f in functions),
            shipped(frame),
        ]
    )


def shipped(name: str) -> str:
    """A file of C that comes with this package."""
    return files("dmframe.compile").joinpath(name).read_text(encoding="utf-8")


def written(f: Any) -> str:
    """An SX function as C: ``static void dm_name(a0, a1, ..., r0, ...)``, each value named once."""
    arguments = [f"const double *a{i}" for i in range(f.n_in())] + [f"double *r{j}" for j in range(f.n_out())]
    lines, results, register = list[str](), list[str](), dict[int, str]()
    angles = dict[str, tuple[str, str]]()
    for k in range(f.n_instructions()):
        code, inputs, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if code == ca.OP_OUTPUT:
            results.append(f"  r{targets[0]}[{targets[1]}] = {register[inputs[0]]};")
        elif code == ca.OP_INPUT:
            register[targets[0]] = f"a{inputs[0]}[{inputs[1]}]"
        elif code == ca.OP_CONST:
            register[targets[0]] = _constant(f.instruction_constant(k))
        elif code in _ANGLES:
            angle = register[inputs[0]]
            if angle not in angles:
                angles[angle] = (f"s{k}", f"c{k}")
                lines.append(f"  double s{k}, c{k};\n  dm_sincos({angle}, &s{k}, &c{k});")
            register[targets[0]] = angles[angle][_ANGLES[code]]
        elif code in _FORMS:
            form = _FORMS[code].format(*(register[i] for i in inputs))
            lines.append(f"  const double v{k} = {form};")
            register[targets[0]] = f"v{k}"
        else:
            raise EngineError(f"engine: {f.name()} holds CasADi's instruction {code}, which cannot be written as C")
    head = f"static void dm_{f.name()}({', '.join(arguments)}) {{"
    return "\n".join([head, *lines, *results, "}"])


def _constant(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text
