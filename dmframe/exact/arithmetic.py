"""CasADi's operations of a field, for any kind of number that has Python's operators."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, Final

import casadi as ca

ARITHMETIC: Final[Mapping[int, Callable[..., Any]]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_LIFT: lambda x, y: x,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda x: x * x,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_INV: lambda x: 1 / x,
}
"""By CasADi's code; each takes as many numbers as the instruction has arguments."""
