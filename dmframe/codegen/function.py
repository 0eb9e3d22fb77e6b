"""Translation of a CasADi function to C: one line for each instruction."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, final

from dmframe.common.errors import EngineError
from dmframe.program import Node, by_code, read, run

_LIBRARY_ONE: Final = "exp log sqrt tan asin acos atan floor ceil fabs erf sinh cosh asinh acosh atanh log1p expm1"
_LIBRARY_TWO: Final = "pow fmod copysign atan2 hypot remainder"
_FORMS: Final[dict[str, str | int]] = {
    **{name: f"{name}({{}})" for name in _LIBRARY_ONE.split()},
    **{name: f"{name}({{}}, {{}})" for name in _LIBRARY_TWO.split()},
    "add": "{} + {}",
    "sub": "{} - {}",
    "mul": "{} * {}",
    "div": "{} / {}",
    "neg": "-{}",
    "sq": "{0} * {0}",
    "twice": "{0} + {0}",
    "inv": "1 / {}",
    "lt": "{} < {}",
    "le": "{} <= {}",
    "eq": "{} == {}",
    "ne": "{} != {}",
    # compared with 0: clang warns of a double as a truth value
    "and": "{} != 0 && {} != 0",
    "or": "{} != 0 || {} != 0",
    "not": "{} == 0",
    "if_else_zero": "{} != 0 ? {} : 0",
    "fmin": "dm_fmin({}, {})",
    "fmax": "dm_fmax({}, {})",
    "sign": "dm_sign({})",
    "tanh": "dm_tanh({})",
    "constpow": "pow({}, {})",
    "sin": 0,
    "cos": 1,
}
"""Operation -> C; for sine and cosine, the index of the result of one call."""


_IN_SIMD: Final[dict[str, str | int]] = {
    **{name: f"dm_{name}_simd({{}})" for name in _LIBRARY_ONE.split()},
    **{name: f"dm_{name}_simd({{}}, {{}})" for name in _LIBRARY_TWO.split()},
    "fabs": "dm_abs({})",
    "lt": "dm_truth({} < {})",
    "le": "dm_truth({} <= {})",
    "eq": "dm_truth({} == {})",
    "ne": "dm_truth({} != {})",
    "and": "dm_truth(({} != 0) & ({} != 0))",
    "or": "dm_truth(({} != 0) | ({} != 0))",
    "not": "dm_truth({} == 0)",
    "if_else_zero": "dm_where({} != 0, {})",
    "fmin": "dm_fmin_simd({}, {})",
    "fmax": "dm_fmax_simd({}, {})",
    "sign": "dm_sign_simd({})",
    "tanh": "dm_tanh_simd({})",
    "constpow": "dm_pow_simd({}, {})",
}


def _noted(form: str | int, *operands: str) -> tuple[str | int, tuple[str, ...]]:
    return form, operands


@final
@dataclass(frozen=True)
class Dialect:
    """C for scalars, or for SIMD vectors of several runs.

    Parameters
    ----------
    number
        Type of a value.
    constant
        Conversion of a constant to that type.
    forms
        C form of each operation, by name.
    sincos
        Function that computes sine and cosine.
    arithmetic
        Files that define the functions of the forms.
    """

    number: str
    constant: str
    forms: Mapping[str, str | int]
    sincos: str
    arithmetic: tuple[str, ...]

    @cached_property
    def rules(self) -> Mapping[int, Any]:
        """Rules for `dmframe.program.run`."""
        return by_code({name: partial(_noted, form) for name, form in self.forms.items()})


ONE: Final = Dialect("double", "{}", _FORMS, "dm_sincos", ("arithmetic.h", "one.h"))
SIMD: Final = Dialect("dm_real", "dm_all({})", {**_FORMS, **_IN_SIMD}, "dm_sincos_simd", ("arithmetic.h", "simd.h"))

PIECE: Final = 3000
SHORT: Final = 1000
LONG: Final = 20_000
"""Lines of one C function: longer ones are split into pieces of `PIECE` lines, those above `LONG` lines into pieces
of `SHORT` lines, since compile time grows faster than linearly."""


@final
@dataclass(frozen=True)
class Line:
    """Line of C that computes a value, or sine and cosine, from other lines' targets, arguments or constants."""

    targets: tuple[str, ...]
    form: str
    operands: tuple[str, ...]

    def text(self, dialect: Dialect, name: Callable[[str], str]) -> str:
        """C of the line; `name` maps the operands to C."""
        operands, number = [name(operand) for operand in self.operands], dialect.number
        if len(self.targets) == 1:
            return f"  const {number} {self.targets[0]} = {self.form.format(*operands)};"
        sine, cosine = self.targets
        return f"  {number} {sine}, {cosine};\n  {dialect.sincos}({operands[0]}, &{sine}, &{cosine});"


UNITS: Final = """\
#ifdef DM_UNITS
#define DM_PIECE __attribute__((noinline, visibility("hidden")))
#define DM_HERE(k) ((k) % DM_UNITS == DM_UNIT)
#else
#define DM_UNIT 0
#define DM_PIECE static __attribute__((noinline))
#define DM_HERE(k) 1
#endif
"""
"""Macros of a source whose pieces are compiled in parallel: its unit DM_UNIT of DM_UNITS, or all of it."""


def written(f: Any, dialect: Dialect = ONE, *, units: bool = False) -> str:
    """An SX function as C: ``static void dm_name(a0, a1, ..., r0, ...)``; a long one calls its pieces in turn.

    A result may alias an argument: all arguments are read before results are stored. With `units` each piece belongs to
    a unit of the source, see `UNITS`.
    """
    lines, results = _lines(f, dialect)
    number = dialect.number
    arguments = [f"const {number} *a{i}" for i in range(f.n_in())]
    head = f"static void dm_{f.name()}({', '.join(arguments + [f'{number} *r{j}' for j in range(f.n_out())])}) {{"
    if len(lines) <= PIECE:
        body = [line.text(dialect, str) for line in lines] + [
            f"  {place} = {value};" for place, value in results.items()
        ]
        return "\n".join([head, *body, "}"])
    size = min(PIECE, SHORT) if len(lines) > LONG else PIECE
    pieces = [lines[first : first + size] for first in range(0, len(lines), size)]
    carried = _carried(pieces, results)
    own, specifier = f"dm_{f.name()}_piece", "DM_PIECE" if units else "static __attribute__((noinline))"
    given = ", ".join([*(f"a{i}" for i in range(f.n_in())), "h"])
    body = [f"  {number} h[{len(carried) + 1}];", *(f"  {own}{k}({given});" for k in range(len(pieces)))]
    body += [f"  {place} = {carried.get(value, value)};" for place, value in results.items()]
    cut = list[str]()
    for k, piece in enumerate(pieces):
        title = f"{specifier} void {own}{k}({', '.join([*arguments, f'{number} *h'])})"
        text = [f"{title} {{", *_piece(piece, carried, dialect), "}"]
        cut += [f"#if DM_HERE({k})", *text, "#else", f"{title};", "#endif"] if units else text
    return "\n".join([*cut, head, *body, "}"])


def _lines(f: Any, dialect: Dialect = ONE) -> tuple[list[Line], dict[str, str]]:
    """Lines of a function, and its results: place -> name."""
    program, lines, angles = read(f), list[Line](), dict[str, tuple[str, str]]()

    def keep(node: Node, value: Any) -> str:
        if isinstance(value, str):  # an argument or a constant
            return value
        form, operands = value
        if isinstance(form, str):
            name = f"v{node.line}"
            lines.append(Line((name,), form, operands))
            return name
        (angle,) = operands
        if angle not in angles:
            angles[angle] = (f"s{node.line}", f"c{node.line}")
            lines.append(Line(angles[angle], "", (angle,)))
        return angles[angle][form]

    names = run(
        program,
        dialect.rules,
        given="a{}[{}]".format,
        constant=lambda value: dialect.constant.format(_constant(value)),
        refuse=lambda code: EngineError(
            f"engine: {program.name} has CasADi's instruction {code}, which cannot be translated to C"
        ),
        keep=keep,
    )
    results = {f"r{j}[{k}]": name for j, output in enumerate(program.stored(names)) for k, name in enumerate(output)}
    return lines, results


def _carried(pieces: Sequence[Sequence[Line]], results: Mapping[str, str]) -> dict[str, str]:
    """Values that another piece or the results read, with their places in h."""
    home = {target: k for k, piece in enumerate(pieces) for line in piece for target in line.targets}
    read = [operand for k, piece in enumerate(pieces) for line in piece for operand in line.operands
            if home.get(operand, k) != k]  # fmt: skip
    read += [value for value in results.values() if value in home]
    return {value: f"h[{place}]" for place, value in enumerate(dict.fromkeys(read))}


def _piece(lines: Sequence[Line], carried: Mapping[str, str], dialect: Dialect) -> Iterator[str]:
    own = {target for line in lines for target in line.targets}
    for line in lines:
        yield line.text(dialect, lambda operand: operand if operand in own else carried.get(operand, operand))
        yield from (f"  {carried[target]} = {target};" for target in line.targets if target in carried)


def _constant(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text
