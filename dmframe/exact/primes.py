"""Primes for exact tests: drawn at random, so that no expression can be hostile to one of them."""

from __future__ import annotations

import random
from functools import lru_cache
from typing import Final

from dmframe.errors import ValueFault

MERSENNE_127: Final = 2**127 - 1
"""A prime that people can recognise in a report."""

MINIMUM_BITS: Final = 121
_SMALL: Final = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41)
_BELOW_SMALL_BASES_DECIDE: Final = 3317044064679887385961981
_EXTRA_BASES: Final = 40


def is_prime(number: int) -> bool:
    """Miller-Rabin: certain below 3.3e24, above it wrong with probability below 4**-40 for any composite.

    Source: Sorenson and Webster, "Strong pseudoprimes to twelve prime bases", Math. Comp. 86 (2017), for the
    thirteen bases that decide all small numbers.
    """
    if number < 2:
        return False
    for prime in _SMALL:
        if number % prime == 0:
            return number == prime
    return _strong_probable_prime(number, 2) and _is_prime(number)


@lru_cache(maxsize=4096)  # a repeated proof draws the same primes; base 2 alone decides nearly all other numbers
def _is_prime(number: int) -> bool:
    """`is_prime` of a strong probable prime to base 2."""
    if not all(_strong_probable_prime(number, base) for base in _SMALL):
        return False
    if number < _BELOW_SMALL_BASES_DECIDE:
        return True
    # Bases that depend on the number alone keep the answer repeatable.
    rng = random.Random(number)
    return all(_strong_probable_prime(number, rng.randrange(2, number - 1)) for _ in range(_EXTRA_BASES))


def _strong_probable_prime(number: int, base: int) -> bool:
    from flint import fmpz  # a run that proves nothing does not load it

    odd, twos = number - 1, 0
    while odd % 2 == 0:
        odd, twos = odd // 2, twos + 1
    power = int(pow(fmpz(base), odd, fmpz(number)))  # a ninth of the time of Python's
    if power in (1, number - 1):
        return True
    for _ in range(twos - 1):
        power = power * power % number
        if power == number - 1:
            return True
    return False


def random_prime(rng: random.Random, bits: int = 127) -> int:
    """A prime of exactly `bits` bits, each equally likely: the error bound of `zero_test` counts on that.

    Raises `ValueFault` for fewer than 121 bits, where one trial would no longer say enough.
    """
    if bits < MINIMUM_BITS:
        raise ValueFault(f"random prime: expected at least {MINIMUM_BITS} bits, found {bits}; 127 is the usual choice")
    while True:
        candidate = rng.getrandbits(bits) | 1 << (bits - 1) | 1
        if is_prime(candidate):
            return candidate
