"""Rules for CasADi's field operations, for any number type with Python's arithmetic operators."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Final

from dmframe.program import by_code

ARITHMETIC: Final[dict[int, Callable[..., Any]]] = by_code(
    {
        "add": operator.add,
        "sub": operator.sub,
        "mul": operator.mul,
        "div": operator.truediv,
        "neg": operator.neg,
        "sq": lambda x: x * x,
        "twice": lambda x: x + x,
        "inv": lambda x: 1 / x,
    }
)
"""Rule of each operation code; a number type adds rules for further operations."""


def with_intervals(kind: Any) -> dict[int, Callable[..., Any]]:
    """Rules for numbers and intervals of the class `kind`: interval arithmetic if at least one operand is an interval.

    `kind.of` converts a number to an interval. `kind.square` is tighter than the product of an interval with itself.
    """

    def mixed(rule: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *values: rule(*map(kind.of, values)) if kind in map(type, values) else rule(*values)

    squares = by_code({"sq": lambda x: x.square() if isinstance(x, kind) else x * x})
    return {code: mixed(rule) for code, rule in (ARITHMETIC | squares).items()}
