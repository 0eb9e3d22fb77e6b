from __future__ import annotations

from fractions import Fraction

import casadi as ca
import pytest

from dmframe.common.errors import ShapeError, UnknownNameError, ValueFault
from dmframe.exact import MERSENNE_127, Tape, ZeroTest, zero_test
from dmframe.exact.sizes import degrees

x, y, z = (ca.SX.sym(name) for name in "xyz")
# Arguments are sums of angles, since CasADi itself simplifies sin(x)^2 + cos(x)^2 and similar expressions.
c_x, s_x, c_y, s_y = ca.cos(x), ca.sin(x), ca.cos(y), ca.sin(y)

IDENTITIES = {
    "the circle, hidden": (c_x * y) ** 2 + s_x * y * y * s_x - y * y,
    "the circle times a circle": (c_x * c_y - s_x * s_y) ** 2 + (s_x * c_y + c_x * s_y) ** 2 - 1,
    "a binomial": (x + y) ** 3 - x**3 - 3 * x * x * y - 3 * x * y * y - y**3,
    "partial fractions": 1 / (x - y) - 1 / (x + y) - 2 * y / (x * x - y * y),
    "equal arguments": ca.tanh(2 * x + y) - ca.tanh(y + x + x),
    "a sign cubed": ca.sign(x * y + z) ** 3 - ca.sign(x * y + z),
    "an absolute value squared": ca.fabs(x - y) ** 2 - (x - y) ** 2,
    "a product of signs": (ca.sign(x) + 1) * (ca.sign(x) - 1) * ca.sign(x) * ca.sign(y),
    "an absolute value times its sign": ca.fabs(x + y) * ca.sign(x + y) ** 2 - ca.fabs(x + y),
    "an absolute value squared and its sign": (ca.fabs(x) ** 2 - x * x) * ca.sign(x),
    "decimals": -0.1 * x - 0.2 * x + 0.3 * x,
    "thirds": x * (1 / 3) + x * (2 / 3) - x,
    "an odd function": ca.sin(x - y) + ca.sin(y - x),
}

NEAR_IDENTITIES = {
    "a sign flipped": (c_x * c_y + s_x * s_y) ** 2 + (s_x * c_y + c_x * s_y) ** 2 - 1,
    "a coefficient off by 1e-15": (x + y) ** 2 - x * x - (2 + 1e-15) * x * y - y * y,
    "a term missing": (x + y) ** 3 - x**3 - 3 * x * x * y - y**3,
    "another argument": ca.tanh(2 * x + y) - ca.tanh(y + x),
    "a sign squared, false where it is 0": ca.sign(x * y + z) ** 2 - 1,
    "signs that are seldom both 0": (ca.sign(x) ** 2 - 1) * (ca.sign(y) ** 2 - 1),
    "a switch written as fractions of signs": (ca.sign(x) ** 2 + ca.sign(x)) / 2 - (ca.sign(x) + 1) / 2,
    "fmin at the tie": ca.fmin(x, y) - ca.if_else(x < y, x, y),
    "signs that are seldom all +1": (ca.sign(x) + 1) * (ca.sign(y) + 1) * (ca.sign(z) + 1),
    "signs that are seldom all -1": (ca.sign(x) - 1) * (ca.sign(y) - 1) * (ca.sign(z) - 1),
    "true, but beyond free symbols": ca.tanh(x) + ca.tanh(-x),
    "true, but beyond the circle": ca.sin(x + y) - (s_x * c_y + c_x * s_y),
    "Fermat's little theorem": x ** MERSENNE_127.bit_length() - x,
}


def decide(e: ca.SX, **options: object) -> ZeroTest:
    return zero_test(ca.Function("f", [x, y, z], [e], ["x", "y", "z"], ["e"]), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", IDENTITIES)
def test_identities_are_accepted_with_a_bound_on_the_error(name: str) -> None:
    outcome = decide(IDENTITIES[name])
    assert outcome.zero
    assert outcome.witness is None
    assert outcome.trials == len(set(outcome.primes)) == 3
    assert outcome.log2_error_bound < -300


@pytest.mark.parametrize("name", NEAR_IDENTITIES)
def test_near_identities_are_refuted_with_a_point(name: str) -> None:
    outcome = decide(NEAR_IDENTITIES[name])
    assert not outcome.zero
    assert outcome.witness is not None
    assert 0 < outcome.witness.residue < outcome.witness.prime


def test_a_constant_that_casadi_folded_shows_up() -> None:
    tenth = ca.SX(0.1)
    assert not decide((tenth + 0.2) * x - (tenth * x + 0.2 * x)).zero
    assert decide((tenth + 0.2) * x - (tenth + 0.2) * x).zero


def test_the_witness_is_a_point_where_the_expression_does_not_vanish() -> None:
    f = ca.Function("f", [x, y], [x - x * 1.0, ca.horzcat(0, x * y - 1)], ["x", "y"], ["same", "e"])
    witness = zero_test(f).witness
    assert witness is not None
    assert (witness.output, witness.row, witness.column) == ("e", 0, 1)
    (_, (a,)), (_, (b,)) = witness.point
    assert witness.residue == (a * b - 1) % witness.prime


def test_known_values_decide_what_free_symbols_cannot() -> None:
    e = x * y - 1
    assert not decide(e).zero
    assert decide(e, values={"x": [Fraction(1, 3)], 1: [3]}).zero
    assert not decide(e, values={"x": [1 / 3], "y": [3]}).zero
    assert decide(e * z, values={0: [0.25], 1: [4], "z": [None]}).zero


def test_the_error_bound_is_made_of_degree_height_and_bits() -> None:
    e = IDENTITIES["a binomial"]
    f = ca.Function("f", [x, y, z], [e])
    assert decide(e, trials=1).log2_error_bound / 2 == decide(e, trials=2).log2_error_bound / 4
    assert decide(e, trials=1, bits=200).log2_error_bound == decide(e, trials=1).log2_error_bound - 73
    assert decide(e, trials=1).degree_bound == degrees(Tape.from_function(f)).degree_total
    given = decide(e, primes=[MERSENNE_127])
    assert (given.primes, given.trials) == ((MERSENNE_127,), 1)
    assert given.log2_error_bound == pytest.approx(2 + 1.585 - 127, abs=0.01)


def test_the_outcome_repeats_with_the_seed() -> None:
    e = NEAR_IDENTITIES["a term missing"]
    assert decide(e, seed=4) == decide(e, seed=4)
    assert decide(e, seed=4).primes != decide(e, seed=5).primes


def test_a_rare_zero_denominator_is_met_by_another_point() -> None:
    # With 5 given as the prime, x - y vanishes at every fifth point.
    assert all(decide(1 / (x - y) + 1 / (y - x), primes=[5], seed=seed).zero for seed in range(20))


def test_a_denominator_that_vanishes_everywhere_is_reported() -> None:
    with pytest.raises(ValueFault, match="zero test of f: a denominator vanishes at all of 20 random points"):
        decide(x / (c_x * c_x + s_x * s_x * y * y / (y * y) - 1))


def test_wrong_calls_are_refused() -> None:
    with pytest.raises(ValueFault, match="zero test of f: expected at least 1 trial, found 0"):
        decide(x, trials=0)
    with pytest.raises(ValueFault, match="zero test of f: expected primes, found 91; random_prime draws one"):
        decide(x, primes=[91])
    with pytest.raises(UnknownNameError, match="zero test of f: values of u: unknown input; choose from x, y, z"):
        decide(x, values={"u": [1]})
    with pytest.raises(UnknownNameError, match="values of 7"):
        decide(x, values={7: [1]})
    with pytest.raises(ShapeError, match="zero test of f: expected 1 values of y, found 2"):
        decide(x, values={"y": [1, 2]})
