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
