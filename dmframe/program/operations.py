"""Operations of CasADi SX functions, and their properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeVar, final

import casadi as ca

V = TypeVar("V")


@final
@dataclass(frozen=True)
class Operation:
    """One operation.

    Parameters
    ----------
    name
        CasADi's name in lower case.
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
    arity: int
    sign: str = ""
    comparison: bool = False
    jumps: bool = False
    kink: bool = False
    edge: bool = False
    bounded: bool = False
    turns: Literal["", "difference", "first", "last"] = ""
    domain: int | None = None

    @property
    def code(self) -> int:
        """CasADi's code."""
        return int(getattr(ca, f"OP_{self.name.upper()}"))


def _comparison(name: str, sign: str) -> Operation:
    return Operation(name, 2, sign, comparison=True, jumps=True, bounded=True, turns="difference")


_ROWS: Final = (
    Operation("add", 2),
    Operation("sub", 2),
    Operation("mul", 2),
    Operation("div", 2, domain=1),
    Operation("neg", 1),
    Operation("inv", 1, domain=0),
    Operation("sq", 1),
    Operation("twice", 1),
    Operation("pow", 2, edge=True, domain=0),
    Operation("constpow", 2, edge=True, domain=0),
    Operation("sqrt", 1, edge=True, domain=0),
    Operation("exp", 1),
    Operation("expm1", 1),
    Operation("log", 1, edge=True, domain=0),
    Operation("log1p", 1, edge=True, domain=0),
    Operation("sin", 1, bounded=True),
    Operation("cos", 1, bounded=True),
    Operation("tan", 1, edge=True, domain=0),
    Operation("asin", 1, edge=True, domain=0),
    Operation("acos", 1, edge=True, domain=0),
    Operation("atan", 1, bounded=True),
    Operation("atan2", 2, jumps=True, bounded=True),
    Operation("sinh", 1),
    Operation("cosh", 1),
    Operation("tanh", 1, bounded=True),
    Operation("asinh", 1),
    Operation("acosh", 1, edge=True, domain=0),
    Operation("atanh", 1, edge=True, domain=0),
    Operation("erf", 1, bounded=True),
    Operation("erfinv", 1, edge=True, domain=0),
    Operation("hypot", 2, edge=True),
    Operation("fabs", 1, kink=True, turns="first"),
    Operation("fmin", 2, kink=True, turns="difference"),
    Operation("fmax", 2, kink=True, turns="difference"),
    Operation("sign", 1, jumps=True, bounded=True, turns="first"),
    Operation("copysign", 2, jumps=True, turns="last"),
    Operation("floor", 1, jumps=True, turns="first"),
    Operation("ceil", 1, jumps=True, turns="first"),
    Operation("fmod", 2, jumps=True, turns="first", domain=1),
    Operation("remainder", 2, jumps=True, turns="first", domain=1),
    _comparison("lt", "<"),
    _comparison("le", "<="),
    _comparison("eq", "=="),
    _comparison("ne", "!="),
    Operation("not", 1, jumps=True, bounded=True),
    Operation("and", 2, jumps=True, bounded=True),
    Operation("or", 2, jumps=True, bounded=True),
    Operation("if_else_zero", 2, "if_else", jumps=True),
)

OPERATIONS: Final[Mapping[int, Operation]] = {row.code: row for row in _ROWS}
"""CasADi's code -> operation, without `assign` and `lift`, which copy a value."""

COMPARISONS: Final = frozenset(code for code, row in OPERATIONS.items() if row.comparison)
JUMPS: Final = frozenset(code for code, row in OPERATIONS.items() if row.jumps)
KINKS: Final = frozenset(code for code, row in OPERATIONS.items() if row.kink)
EDGES: Final = frozenset(code for code, row in OPERATIONS.items() if row.edge)
DIVISIONS: Final = frozenset((ca.OP_DIV, ca.OP_INV))
POWERS: Final = frozenset((ca.OP_POW, ca.OP_CONSTPOW))


def sign_of(code: int) -> str:
    """Notation of an operation in a block's source."""
    return OPERATIONS[code].sign or OPERATIONS[code].name


def by_code(named: Mapping[str, V]) -> dict[int, V]:
    """Table of rules by code from one by name. Raises KeyError for an unknown name."""
    codes = {row.name: code for code, row in OPERATIONS.items()}
    return {codes[name]: value for name, value in named.items()}
