"""Operations of CasADi SX functions, and their properties. CasADi itself is not imported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeVar, final

V = TypeVar("V")


@final
@dataclass(frozen=True)
class Operation:
    """One operation.

    Parameters
    ----------
    name
        CasADi's name in lower case.
    code
        CasADi's code.
    arity
        Number of operands.
    sign
        Notation in a block's source; the name by default.
    comparison, jumps, kink, edge
        It compares two numbers; its value can jump; its slope can jump; its domain ends, or its slope diverges.
    bounded
        Its value is bounded for all operands.
    turns
        The quantity whose sign changes at a switch: the difference of the operands, the first, or the last one.
    domain
        The operand that must stay in the domain; None if the operation is finite everywhere.
    """

    name: str
    code: int
    arity: int
    sign: str = ""
    comparison: bool = False
    jumps: bool = False
    kink: bool = False
    edge: bool = False
    bounded: bool = False
    turns: Literal["", "difference", "first", "last"] = ""
    domain: int | None = None


def _comparison(name: str, code: int, sign: str) -> Operation:
    return Operation(name, code, 2, sign, comparison=True, jumps=True, bounded=True, turns="difference")


_ROWS: Final = (
    Operation("add", 1, 2),
    Operation("sub", 2, 2),
    Operation("mul", 3, 2),
    Operation("div", 4, 2, domain=1),
    Operation("neg", 5, 1),
    Operation("inv", 36, 1, domain=0),
    Operation("sq", 11, 1),
    Operation("twice", 12, 1),
    Operation("pow", 8, 2, edge=True, domain=0),
    Operation("constpow", 9, 2, edge=True, domain=0),
    Operation("sqrt", 10, 1, edge=True, domain=0),
    Operation("exp", 6, 1),
    Operation("expm1", 94, 1),
    Operation("log", 7, 1, edge=True, domain=0),
    Operation("log1p", 93, 1, edge=True, domain=0),
    Operation("sin", 13, 1, bounded=True),
    Operation("cos", 14, 1, bounded=True),
    Operation("tan", 15, 1, edge=True, domain=0),
    Operation("asin", 16, 1, edge=True, domain=0),
    Operation("acos", 17, 1, edge=True, domain=0),
    Operation("atan", 18, 1, bounded=True),
    Operation("atan2", 43, 2, jumps=True, bounded=True),
    Operation("sinh", 37, 1),
    Operation("cosh", 38, 1),
    Operation("tanh", 39, 1, bounded=True),
    Operation("asinh", 40, 1),
    Operation("acosh", 41, 1, edge=True, domain=0),
    Operation("atanh", 42, 1, edge=True, domain=0),
    Operation("erf", 33, 1, bounded=True),
    Operation("erfinv", 86, 1, edge=True, domain=0),
    Operation("hypot", 95, 2, edge=True),
    Operation("fabs", 29, 1, kink=True, turns="first"),
    Operation("fmin", 34, 2, kink=True, turns="difference"),
    Operation("fmax", 35, 2, kink=True, turns="difference"),
    Operation("sign", 30, 1, jumps=True, bounded=True, turns="first"),
    Operation("copysign", 31, 2, jumps=True, turns="last"),
    Operation("floor", 26, 1, jumps=True, turns="first"),
    Operation("ceil", 27, 1, jumps=True, turns="first"),
    Operation("fmod", 28, 2, jumps=True, turns="first", domain=1),
    Operation("remainder", 97, 2, jumps=True, turns="first", domain=1),
    _comparison("lt", 19, "<"),
    _comparison("le", 20, "<="),
    _comparison("eq", 21, "=="),
    _comparison("ne", 22, "!="),
    Operation("not", 23, 1, jumps=True, bounded=True),
    Operation("and", 24, 2, jumps=True, bounded=True),
    Operation("or", 25, 2, jumps=True, bounded=True),
    Operation("if_else_zero", 32, 2, "if_else", jumps=True),
)

OPERATIONS: Final[Mapping[int, Operation]] = {row.code: row for row in _ROWS}
"""CasADi's code -> operation, without `assign` and `lift`, which copy a value."""

COMPARISONS: Final = frozenset(code for code, row in OPERATIONS.items() if row.comparison)
JUMPS: Final = frozenset(code for code, row in OPERATIONS.items() if row.jumps)
KINKS: Final = frozenset(code for code, row in OPERATIONS.items() if row.kink)
EDGES: Final = frozenset(code for code, row in OPERATIONS.items() if row.edge)
BY_NAME: Final[Mapping[str, Operation]] = {row.name: row for row in _ROWS}
DIVISIONS: Final = frozenset(BY_NAME[name].code for name in ("div", "inv"))
POWERS: Final = frozenset(BY_NAME[name].code for name in ("pow", "constpow"))


def sign_of(code: int) -> str:
    """Notation of an operation in a block's source."""
    return OPERATIONS[code].sign or OPERATIONS[code].name


def by_code(named: Mapping[str, V]) -> dict[int, V]:
    """Table of rules by code from one by name. Raises KeyError for an unknown name."""
    return {BY_NAME[name].code: value for name, value in named.items()}
