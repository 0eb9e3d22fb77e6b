"""Primes for exact tests, drawn at random so that no expression can be constructed against them."""

from __future__ import annotations

import random
from functools import lru_cache
from math import gcd, prod
from typing import Final

from dmframe.common.errors import ValueFault

MERSENNE_127: Final = 2**127 - 1
"""A well-known prime, easy to recognise in a report."""

MINIMUM_BITS: Final = 121

SMALL: Final = prod(n for n in range(3, 400, 2) if all(n % k for k in range(3, 20, 2) if k < n))
"""Product of the odd primes below 400, which divide four of five odd numbers: a quick test before FLINT's."""


@lru_cache(maxsize=4096)  # a repeated proof draws the same primes
def is_prime(number: int) -> bool:
    """True for a proved prime: FLINT proves the primality of probable primes."""
    from flint import fmpz  # not loaded by a run without a proof

    return bool(fmpz(number).is_prime())


def random_prime(rng: random.Random, bits: int = 127) -> int:
    """A uniformly random prime of exactly `bits` bits, as the error bound of `zero_test` requires.

    Raises `ValueFault` for fewer than 121 bits, with which the error bound of one trial is too large.
    """
    if bits < MINIMUM_BITS:
        raise ValueFault(f"random prime: expected at least {MINIMUM_BITS} bits, found {bits}; 127 is the usual choice")
    while True:
        candidate = rng.getrandbits(bits) | 1 << (bits - 1) | 1
        if gcd(candidate, SMALL) == 1 and is_prime(candidate):
            return candidate
