"""Exact identity testing: expressions evaluated in a prime field, with no rounding and no tolerance."""

from __future__ import annotations

from dmframe.exact.evaluation import Evaluation
from dmframe.exact.identity import Witness, ZeroTest, sign_choices, zero_test
from dmframe.exact.linear import Echelon, NoRationalError, null_space, rank, rational_reconstruction, reduced_echelon
from dmframe.exact.primes import MERSENNE_127, is_prime, random_prime
from dmframe.exact.sizes import Bound
from dmframe.exact.tape import Tape
from dmframe.exact.trial import Trial, ZeroDivision

__all__ = [
    "MERSENNE_127",
    "Bound",
    "Echelon",
    "Evaluation",
    "NoRationalError",
    "Tape",
    "Trial",
    "Witness",
    "ZeroDivision",
    "ZeroTest",
    "is_prime",
    "null_space",
    "random_prime",
    "rank",
    "rational_reconstruction",
    "reduced_echelon",
    "sign_choices",
    "zero_test",
]
