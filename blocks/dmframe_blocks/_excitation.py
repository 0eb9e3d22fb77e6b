"""Signs of an excitation that a controller computes itself, by a linear congruential generator for each joint."""

from __future__ import annotations

from typing import Final

import casadi as ca

from dmframe.block import SX, named

MODULUS: Final = 2**31 - 1
FACTOR: Final = 48271
"""x(next) = FACTOR x mod MODULUS runs through all of 1 to MODULUS - 1; all products are below 2^53, so exact."""
MOST_SEED: Final = 1_000_000
_DISCARDED: Final = 8
"""Values before the first one that is used: neighbouring seeds have neighbouring first values."""
_APART: Final = 7919
"""Between the first values of two joints."""


def check_seed(seed: float) -> None:
    """Raise ValueError unless the seed is a whole number from 1 to `MOST_SEED`."""
    if not 1 <= seed <= MOST_SEED or seed != int(seed):
        raise ValueError(f"expected a seed that is a whole number from 1 to {MOST_SEED}, found {seed:g}")


def seeded(seed: SX, n: int) -> SX:
    """The first value of each joint, (n,)."""
    value = seed * (1 + _APART * ca.DM(range(n)))
    value = value - MODULUS * ca.floor(value / MODULUS)
    for _ in range(_DISCARDED):
        value = following(value)
    return value


def following(value: SX) -> SX:
    """The next value of each joint."""
    product = named("product", FACTOR * value)
    return product - MODULUS * ca.floor(product / MODULUS)


def sign(value: SX) -> SX:
    """-1 or 1, each with probability 1/2."""
    return 2 * (value > MODULUS / 2) - 1
