"""A function of CasADi's as C: each instruction a line, each value named once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca

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

PIECE: Final = 3000
"""Lines of one C function: a compiler's time grows faster than the function, so that a longer one is cut."""


@final
@dataclass(frozen=True)
class Line:
    """One value, or a sine and cosine, from operands: names of other lines' targets, arguments or constants."""

    targets: tuple[str, ...]
    form: str
    operands: tuple[str, ...]

    def text(self, name: Callable[[str], str]) -> str:
        """In C, with the operands called as `name` says."""
        operands = [name(operand) for operand in self.operands]
        if len(self.targets) == 1:
            return f"  const double {self.targets[0]} = {self.form.format(*operands)};"
        sine, cosine = self.targets
        return f"  double {sine}, {cosine};\n  dm_sincos({operands[0]}, &{sine}, &{cosine});"


def written(f: Any) -> str:
    """An SX function as C: ``static void dm_name(a0, a1, ..., r0, ...)``; a long one calls its pieces in turn.

    An argument may be a result too: nothing is stored before everything is read.
    """
    lines, results = _lines(f)
    arguments = [f"const double *a{i}" for i in range(f.n_in())]
    head = f"static void dm_{f.name()}({', '.join(arguments + [f'double *r{j}' for j in range(f.n_out())])}) {{"
    if len(lines) <= PIECE:
        body = [line.text(str) for line in lines] + [f"  {place} = {value};" for place, value in results.items()]
        return "\n".join([head, *body, "}"])
    pieces = [lines[first : first + PIECE] for first in range(0, len(lines), PIECE)]
    carried = _carried(pieces, results)
    own = f"dm_{f.name()}_piece"
    given = ", ".join([*(f"a{i}" for i in range(f.n_in())), "h"])
    body = [f"  double h[{len(carried) + 1}];", *(f"  {own}{k}({given});" for k in range(len(pieces)))]
    body += [f"  {place} = {carried.get(value, value)};" for place, value in results.items()]
    cut = [
        text
        for k, piece in enumerate(pieces)
        for text in _piece(f"{own}{k}({', '.join([*arguments, 'double *h'])})", piece, carried)
    ]
    return "\n".join([*cut, head, *body, "}"])


def _lines(f: Any) -> tuple[list[Line], dict[str, str]]:
    """A function's lines, and its results: where each goes, and what it is called."""
    lines, results, register = list[Line](), dict[str, str](), dict[int, str]()
    angles = dict[str, tuple[str, str]]()
    for k in range(f.n_instructions()):
        code, inputs, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if code == ca.OP_OUTPUT:
            results[f"r{targets[0]}[{targets[1]}]"] = register[inputs[0]]
        elif code == ca.OP_INPUT:
            register[targets[0]] = f"a{inputs[0]}[{inputs[1]}]"
        elif code == ca.OP_CONST:
            register[targets[0]] = _constant(f.instruction_constant(k))
        elif code in _ANGLES:
            angle = register[inputs[0]]
            if angle not in angles:
                angles[angle] = (f"s{k}", f"c{k}")
                lines.append(Line(angles[angle], "", (angle,)))
            register[targets[0]] = angles[angle][_ANGLES[code]]
        elif code in _FORMS:
            lines.append(Line((f"v{k}",), _FORMS[code], tuple(register[i] for i in inputs)))
            register[targets[0]] = f"v{k}"
        else:
            raise EngineError(f"engine: {f.name()} holds CasADi's instruction {code}, which cannot be written as C")
    return lines, results


def _carried(pieces: Sequence[Sequence[Line]], results: Mapping[str, str]) -> dict[str, str]:
    """Values that another piece or the results read, each with its place in h."""
    home = {target: k for k, piece in enumerate(pieces) for line in piece for target in line.targets}
    read = [operand for k, piece in enumerate(pieces) for line in piece for operand in line.operands
            if home.get(operand, k) != k]  # fmt: skip
    read += [value for value in results.values() if value in home]
    return {value: f"h[{place}]" for place, value in enumerate(dict.fromkeys(read))}


def _piece(head: str, lines: Sequence[Line], carried: Mapping[str, str]) -> Iterator[str]:
    own = {target for line in lines for target in line.targets}
    yield f"static __attribute__((noinline)) void {head} {{"
    for line in lines:
        yield line.text(lambda operand: operand if operand in own else carried.get(operand, operand))
        yield from (f"  {carried[target]} = {target};" for target in line.targets if target in carried)
    yield "}"


def _constant(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text
