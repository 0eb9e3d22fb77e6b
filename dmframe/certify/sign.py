"""Signs of values, derived from their operations."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import final

import casadi as ca


@final
class Sign(Enum):
    """Known sign of a value."""

    ANY = 0
    NOT_BELOW = 1
    ABOVE = 2


SIGNED = frozenset(
    {
        ca.OP_CONST, ca.OP_EXP, ca.OP_COSH, ca.OP_FMAX, ca.OP_ADD, ca.OP_MUL, ca.OP_DIV, ca.OP_INV, ca.OP_SQRT,
        ca.OP_TWICE, ca.OP_FMIN, ca.OP_SQ, ca.OP_FABS,
    }
)  # fmt: skip
"""Instructions for which a sign may be derived; the sign of all others is unknown."""


def sign_after(code: int, operands: Sequence[Sign], *, positive: bool = False) -> Sign:
    """Sign of an instruction's value, from those of its operands; `positive` is that of a constant."""
    above = [sign is Sign.ABOVE for sign in operands]
    least = min((sign.value for sign in operands), default=0)
    match code:
        case ca.OP_CONST:
            return Sign.ABOVE if positive else Sign.ANY
        case ca.OP_EXP | ca.OP_COSH:
            return Sign.ABOVE
        case ca.OP_FMAX:
            return Sign.ABOVE if any(above) else Sign.ANY
        case ca.OP_ADD:
            return Sign.ABOVE if any(above) and least else Sign(min(least, 1))
        case ca.OP_MUL | ca.OP_DIV | ca.OP_INV | ca.OP_SQRT | ca.OP_TWICE | ca.OP_FMIN:
            return Sign(least)
        case ca.OP_SQ | ca.OP_FABS:
            return Sign.ABOVE if all(above) else Sign.NOT_BELOW
    return Sign.ANY
