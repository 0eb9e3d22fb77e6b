from __future__ import annotations

import random
from fractions import Fraction

import casadi as ca
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.common.errors import ValueFault
from dmframe.exact import MERSENNE_127, Tape, Trial, ZeroDivision, rational_reconstruction
from dmframe.exact.sizes import degrees
from dmframe.exact.trial import SIGN_LIMIT

P = MERSENNE_127


def trial(seed: int = 0) -> Trial:
    return Trial(P, random.Random(seed))


def random_expression(rng: random.Random, leaves: list[tuple[ca.SX, Fraction]], steps: int) -> tuple[ca.SX, Fraction]:
    """An SX and, computed independently, its exact value: the independent reference."""
    pool = list(leaves)
    for _ in range(steps):
        (a, x), (b, y) = rng.choice(pool), rng.choice(pool)
        kind = rng.choice("+-*/ips")
        if (kind in "/" and y == 0) or (kind == "i" and x == 0):
            continue
        constant = Fraction(rng.randint(-7, 7), 8)
        if kind == "+":
            new = a + b, x + y
        elif kind == "-":
            new = a - b, x - y
        elif kind == "*":
            new = a * b, x * y
        elif kind == "/":
            new = a / b, x / y
        elif kind == "i":
            new = 1 / a, 1 / x
        elif kind == "p":
            new = a**3, x**3
        else:
            new = a * float(constant) - b, x * constant - y
        if max(abs(new[1].numerator), new[1].denominator) < 2**200:
            pool.append(new)
    return pool[-1]


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_a_rational_function_has_the_residue_of_its_exact_value(seed: int) -> None:
    rng = random.Random(seed)
    x = ca.SX.sym("x", 3)
    point = [Fraction(rng.randint(-20, 20), rng.randint(1, 9)) for _ in range(3)]
    e, value = random_expression(rng, [(x[i], point[i]) for i in range(3)], 30)
    t = trial()
    [[residue]] = Tape.from_function(ca.Function("f", [x], [e])).evaluate([[t.residue(v) for v in point]], t)
    assert residue == t.residue(value)


def test_instructions_of_every_field_operation_are_read() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = ca.Function(
        "f", [x, y], [ca.vertcat(x + y, x - y, x * y, x / y, -x, x * x, 2 * x, 1 / x, x**5, x**-3, x + 0.5)]
    )
    a, b = Fraction(3, 7), Fraction(-5, 2)
    t = trial()
    [residues] = Tape.from_function(f).evaluate([[t.residue(a)], [t.residue(b)]], t)
    expected = [a + b, a - b, a * b, a / b, -a, a * a, 2 * a, 1 / a, a**5, a**-3, a + Fraction(1, 2)]
    assert [rational_reconstruction(r, P) for r in residues] == expected


def test_matrices_are_dense_and_column_major_on_both_sides() -> None:
    x = ca.SX.sym("x", ca.Sparsity.lower(2))
    f = ca.Function("f", [x], [ca.vertcat(ca.horzcat(x[0, 0], 0), ca.horzcat(0, x[1, 0] + x[1, 1])), x.T])
    tape = Tape.from_function(f)
    assert tape.evaluate([[1, 2, 0, 4]], trial()) == [[1, 0, 0, 6], [1, 0, 2, 4]]
    assert tape.inputs == (("i0", 4),)


def test_constants_are_what_was_written() -> None:
    x = ca.SX.sym("x")
    t = trial()
    [[residue]] = Tape.from_function(ca.Function("f", [x], [x * 0.1])).evaluate([[1]], t)
    assert residue == t.residue(Fraction(1, 10)) != t.residue(Fraction(0.1))
    [[residue]] = Tape.from_function(ca.Function("f", [x], [x * (0.1 + 0.2)])).evaluate([[1]], t)
    assert residue == t.residue(Fraction(0.1 + 0.2))


def test_cosine_and_sine_of_equal_arguments_share_one_point_of_the_circle() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    e = ca.vertcat(ca.cos(x + y), ca.sin(y + x), ca.cos(x), ca.sin(x))
    tape = Tape.from_function(ca.Function("f", [x, y], [e]))
    t = trial()
    [[c, s, c_x, s_x]] = tape.evaluate([[5], [11]], t)
    assert (c * c + s * s) % P == 1
    assert (c, s) != (c_x, s_x)
    assert tape.evaluate([[5], [11]], t) == [[c, s, c_x, s_x]]
    assert tape.evaluate([[16], [0]], t)[0] == [c, s, c, s]
    assert tape.evaluate([[5], [11]], trial(1)) != [[c, s, c_x, s_x]]


def test_cosine_is_even_and_sine_is_odd_and_zero_is_an_angle() -> None:
    t = trial()
    c, s = t.cos_sin(77)
    assert t.cos_sin(P - 77) == (c, P - s)
    assert t.cos_sin(0) == (1, 0)


def test_opaque_functions_take_equal_values_at_equal_arguments_only() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    e = ca.vertcat(ca.tanh(x), ca.tanh(y), ca.exp(x), ca.if_else(x > y, x, y), ca.fmax(x, y), x**0.5, x**y)
    tape = Tape.from_function(ca.Function("f", [x, y], [e]))
    [same] = tape.evaluate([[5], [5]], t := trial())
    [other] = tape.evaluate([[5], [6]], t)
    assert same[0] == same[1] == other[0] != other[1]
    assert len({same[0], *same[2:]}) == 6
    assert same[5] == other[5]
    assert same[6] != other[6]


def test_signs_walk_through_all_their_choices() -> None:
    x = ca.SX.sym("x", 2)
    tape = Tape.from_function(ca.Function("f", [x], [ca.vertcat(ca.sign(x), ca.sign(-x[0]), ca.fabs(x[0]))]))
    t = trial()
    seen = []
    while True:
        [values] = tape.evaluate([[3, 4]], t)
        signed = [value - P if value > P // 2 else value for value in values]
        assert signed[2] == -signed[0]
        assert signed[3] == 3 * signed[0]
        seen.append(tuple(signed[:2]))
        if not t.next_signs():
            break
    assert sorted(seen) == [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    assert t.sign(0) == 0


def test_an_absolute_value_without_a_sign_is_not_read_on_its_switch() -> None:
    x = ca.SX.sym("x")
    tape = Tape.from_function(ca.Function("f", [x], [ca.fabs(x)]))
    t = trial()
    seen = [tape.evaluate([[3]], t)[0][0]]
    while t.next_signs():
        seen.append(tape.evaluate([[3]], t)[0][0])
    assert seen == [3, P - 3]


def test_beyond_the_limit_a_sign_is_a_free_value() -> None:
    t = trial()
    assert all(t.sign(k) in (-1, 1) for k in range(1, SIGN_LIMIT + 1))
    assert t.sign(SIGN_LIMIT + 1) not in (-1, 0, 1)


def test_a_vanishing_denominator_requires_another_point() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    for e in (1 / (x - y), y / (x - y), (x - y) ** -2):
        with pytest.raises(ZeroDivision, match="a denominator vanishes modulo"):
            Tape.from_function(ca.Function("f", [x, y], [e])).evaluate([[4], [4]], trial())
    with pytest.raises(ZeroDivision):
        trial().residue(Fraction(1, P))


@settings(derandomize=True, max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_degree_and_height_bound_random_polynomials(seed: int) -> None:
    import sympy

    rng = random.Random(seed)
    x = ca.SX.sym("x", 2)
    names = sympy.symbols("a b")
    pool = [(x[0], sympy.Poly(names[0], *names)), (x[1], sympy.Poly(names[1], *names))]
    for _ in range(7):
        (a, s), (b, t) = rng.choice(pool), rng.choice(pool)
        number = rng.randint(1, 5)
        new = rng.choice(
            [(a * b, s * t), (a + b, s + t), (a - number * b, s - number * t), (a**2, s**2), (2 * a, 2 * s)]
        )
        if new[1].total_degree() < 12:
            pool.append(new)
    e, polynomial = pool[-1]
    bound = degrees(Tape.from_function(ca.Function("f", [x], [e])))
    size = sum(abs(int(c)) for c in polynomial.coeffs())
    assert bound.degree >= (0 if polynomial.is_zero else polynomial.total_degree())
    assert 2**bound.height >= size
    assert bound.degree_total == bound.degree


def test_degree_bounds_of_hand_made_functions() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")

    def bound(e: ca.SX, **fixed: Fraction) -> tuple[int, int]:
        known = {"xy".index(name): [value] for name, value in fixed.items()}
        found = degrees(Tape.from_function(ca.Function("f", [x, y], [e])), known)
        return found.degree, found.degree_total

    assert bound(x**2 * y + y) == (3, 3)
    assert bound(x**2 * y + y, x=Fraction(1, 3)) == (1, 1)
    assert bound(x / y + y / x) == (2, 4)
    assert bound(1 / (x * y)) == (0, 2)
    assert bound((x * x * y) ** -2) == (0, 6)
    assert bound(ca.cos(x)) == (2, 2 + 1 + 2)
    assert bound(ca.tanh(x * y)) == (1, 1 + 2)
    assert bound(ca.tanh(x) * ca.tanh(y)) == (2, 2 + 4)
    assert bound(ca.fabs(x * y)) == (3, 3 + 2)


def test_a_function_that_cannot_be_read_is_refused_with_the_remedy() -> None:
    x, y = ca.MX.sym("x"), ca.SX.sym("y")
    with pytest.raises(ValueFault, match=r"exact test of f: expected an SX function, found MXFunction; expand\(\) it"):
        Tape.from_function(ca.Function("f", [x], [x]))
    with pytest.raises(ValueFault, match="expected every symbol among the inputs, found the free y; add an input"):
        Tape.from_function(ca.Function("f", [ca.SX.sym("x")], [y], {"allow_free": True}))
    with pytest.raises(ValueFault, match="expected finite constants, found nan"):
        Tape.from_function(ca.Function("f", [y], [y + ca.SX(float("nan"))]))
    with pytest.raises(ValueFault, match=r"expected inputs of \[1\] numbers, found \[2\]"):
        Tape.from_function(ca.Function("f", [y], [y])).evaluate([[1, 2]], trial())
    called = ca.Function("g", [y], [y * y], {"never_inline": True})
    with pytest.raises(ValueFault, match=r"expected scalar operations, found CasADi's instruction 48; expand\(\)"):
        Tape.from_function(ca.Function("f", [y], [called(y)]))
