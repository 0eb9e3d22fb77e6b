"""CasADi's operations of a field, for any kind of number that has Python's operators."""

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
"""A table of rules, to which a kind of number adds what else it knows."""


def with_intervals(kind: Any) -> dict[int, Callable[..., Any]]:
    """The same table; of intervals of the class `kind`, as soon as there is one among the operands.

    `kind.of` makes one of a number, and its `square` is narrower than the product with itself.
    """

    def mixed(rule: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *values: rule(*map(kind.of, values)) if kind in map(type, values) else rule(*values)

    squares = by_code({"sq": lambda x: x.square() if isinstance(x, kind) else x * x})
    return {code: mixed(rule) for code, rule in (ARITHMETIC | squares).items()}
