from __future__ import annotations

import math
import random
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.common.errors import ShapeError, ValueFault
from dmframe.exact import (
    MERSENNE_127,
    Echelon,
    NoRationalError,
    is_prime,
    null_space,
    random_prime,
    rank,
    rational_reconstruction,
    reduced_echelon,
)

if TYPE_CHECKING:
    import sympy

P = MERSENNE_127


def residue(value: Fraction) -> int:
    return value.numerator * pow(value.denominator, -1, P) % P


def random_matrix(rng: random.Random) -> sympy.Matrix:
    import sympy

    rows, columns, inner = rng.randint(1, 6), rng.randint(1, 7), rng.randint(1, 4)
    left = sympy.Matrix(rows, inner, lambda *_: rng.randint(-3, 3))
    right = sympy.Matrix(inner, columns, lambda *_: sympy.Rational(rng.randint(-4, 4), rng.randint(1, 5)))
    return left * right


def residues(matrix: sympy.Matrix) -> list[list[int]]:
    return [[residue(Fraction(int(x.p), int(x.q))) for x in matrix.row(i)] for i in range(matrix.rows)]


def test_reduced_echelon_form_rank_and_null_space_are_those_of_sympy() -> None:
    rng = random.Random(5)
    for _ in range(30):
        matrix = random_matrix(rng)
        form, pivots = matrix.rref()
        rows, found = reduced_echelon(residues(matrix), P)
        assert found == tuple(pivots)
        assert rank(residues(matrix), P) == matrix.rank()
        assert rows == residues(form[: len(pivots), :])
        vectors = null_space(residues(matrix), matrix.cols, P)
        expected = [residues(vector.T)[0] for vector in matrix.nullspace()]
        assert vectors == expected


def test_the_undetermined_columns_are_those_of_the_null_space() -> None:
    rng = random.Random(6)
    for _ in range(30):
        matrix = random_matrix(rng)
        echelon = Echelon(P, matrix.cols)
        for row in residues(matrix):
            echelon.add(row)
        assert echelon.undetermined == {k for v in matrix.nullspace() for k, value in enumerate(v) if value}


def test_an_echelon_states_whether_a_row_increases_the_rank() -> None:
    echelon = Echelon(P, 3)
    assert echelon.add([0, 2, 4])
    assert not echelon.add([0, 1, 2])
    assert echelon.add([1, 1, 1])
    assert echelon.pivots == (0, 1)
    assert echelon.rows == [[1, 0, P - 1], [0, 1, 2]]
    assert reduced_echelon([], P) == ([], ())


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ShapeError, match="row of an echelon form: expected 3 elements, found 2"):
        Echelon(P, 3).add([1, 2])


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.fractions(max_denominator=2**62).filter(lambda x: abs(x.numerator) < 2**62))
def test_a_fraction_comes_back_from_its_residue(value: Fraction) -> None:
    assert rational_reconstruction(residue(value), P) == value


def test_a_residue_without_a_small_fraction_is_refused() -> None:
    value = Fraction(10**9 + 7, 998244353)
    with pytest.raises(NoRationalError, match="no fraction with parts up to 1000 has the residue"):
        rational_reconstruction(residue(value), P, bound=1000)
    assert rational_reconstruction(residue(value), P, bound=10**10) == value


def test_an_accepted_fraction_always_has_the_residue() -> None:
    rng = random.Random(2)
    for _ in range(200):
        number = rng.randrange(P)
        try:
            found = rational_reconstruction(number, P)
        except NoRationalError:
            continue
        assert residue(found) == number
        assert max(abs(found.numerator), found.denominator) <= math.isqrt(P // 2)


def test_primality_is_that_of_sympy() -> None:
    import sympy

    assert [n for n in range(3000) if is_prime(n)] == list(sympy.primerange(3000))
    rng = random.Random(3)
    large = [rng.getrandbits(100) | 1 for _ in range(300)]
    assert [is_prime(n) for n in large] == [sympy.isprime(n) for n in large]
    carmichael = [561, 41041, 825265, 321197185, 3215031751, 3825123056546413051, 318665857834031151167461]
    assert not any(is_prime(n) for n in carmichael)
    assert is_prime(2**127 - 1)
    assert not is_prime((2**61 - 1) * (2**89 - 1))


def test_random_primes_are_prime_of_the_requested_size_and_repeat_with_the_seed() -> None:
    import sympy

    found = [random_prime(random.Random(seed), bits) for seed, bits in ((1, 121), (1, 127), (2, 160))]
    assert [p.bit_length() for p in found] == [121, 127, 160]
    assert all(sympy.isprime(p) for p in found)
    assert random_prime(random.Random(1), 121) == found[0]


def test_primes_too_small_to_prove_anything_are_refused() -> None:
    with pytest.raises(ValueFault, match="random prime: expected at least 121 bits, found 31; 127 is the usual choice"):
        random_prime(random.Random(0), 31)
