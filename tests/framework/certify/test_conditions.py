"""Conditions at their margins, compared with brute force, and over intervals."""

from __future__ import annotations

import dataclasses
import random
from fractions import Fraction
from itertools import product
from typing import Any, ClassVar, final

import casadi as ca
import numpy as np
import pytest
from closed_loops import known_blocks, loop_of
from jsonschema import Draft202012Validator

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Inequality, Square
from dmframe.block.naming import named
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import State
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.conditions import conditions_of
from dmframe.certify.schema import verdict_schema
from dmframe.certify.small_gain import small_gain
from dmframe.certify.summary import summary
from dmframe.certify.uncertain import intervals
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval
from dmframe.prove.definite import pivots
from dmframe.prove.stability import common_margin
from dmframe.robot.library import load
from dmframe.robot.pseudo_inertia import pseudo_inertia


def built(kind: str = "PID", reference: str = "joint", friction: str = "none", **blocks: dict[str, Any]) -> Diagram:
    """The planar arm with changed parameters of some blocks, and K = 1."""
    loop = loop_of(load("arm2"), reference, kind, friction=friction)
    made = dict(loop.diagram.blocks)
    for name, values in {"arm": {"K": 1}, **blocks}.items():
        block, own = loop.specs[name]
        made[name] = known_blocks()[block](**{**own, **values})
    return Diagram.build(made, {}, loop.robot)


def checked(diagram: Diagram, uncertain: dict[str, Any] | None = None) -> dict[str, Checked]:
    claim = claim_of(diagram)
    found, _ = conditions_of(claim, Numbers(claim, intervals(diagram, uncertain or {})))
    return {condition.name: condition for condition in found}


M_BAR = "inverse: M_bar >= 0"


@pytest.mark.parametrize(
    ("K_I", "value"), [(2, 0.0), (2.0000001, -1e-7), (1.9999999, 1e-7), (2.000000000000001, -1e-15)]
)
def test_m_bar_must_not_be_negative_and_is_decided_to_the_last_digit(K_I: float, value: float) -> None:
    # M_bar = K_D K_c + K_P - K_I / K_c = 1 + 1 - K_I
    found = checked(built(inverse={"K_c": 1}, servo={"K_D": 1, "K_P": 1, "K_I": K_I}))[M_BAR]
    assert found.value == pytest.approx(value, rel=1e-6, abs=1e-30)
    assert found.holds == (value >= 0)


@pytest.mark.parametrize(("k_P", "k_I", "k_D"), [(1, 6, 1), (2, 3, 1), (5, 6, 4), (1, 1, 2)])
def test_the_bound_of_remark_5_is_where_m_bar_vanishes(k_P: float, k_I: float, k_D: float) -> None:
    # the square root is rational in each case
    bound = 2 * k_I / (k_P + (k_P**2 + 4 * k_I * k_D) ** 0.5)
    gains = {"K_D": k_D, "K_P": k_P, "K_I": k_I}
    outcomes = [
        checked(built(inverse={"K_c": bound * factor}, servo=gains))[M_BAR].holds for factor in (1 - 1e-12, 1 + 1e-12)
    ]
    assert outcomes == [False, True]
    if bound == round(bound, 3):
        at = checked(built(inverse={"K_c": bound}, servo=gains))[M_BAR]
        assert (at.value, at.holds) == (0, True)


def test_m_bar_that_fails_takes_the_proof_but_not_the_identity() -> None:
    verdict = verify(built(inverse={"K_c": 1}, servo={"K_D": 1, "K_P": 1, "K_I": 2.5}), trials=1)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("the identity holds, but a condition fails: inverse: M_bar >= 0")
    assert verdict.test is not None
    assert verdict.test.zero


@pytest.mark.parametrize(("upper", "holds"), [(0.0125, True), (0.012499999999, False), (0.012500000001, True)])
def test_a_box_may_end_at_the_truth_but_not_before_it(upper: float, holds: bool) -> None:
    found = checked(built(inverse={"w_box": [0, upper]}))["inverse.w: true value inside the box"]  # 1/K_star = 1/80
    assert found.holds == holds
    assert found.value == pytest.approx(min(upper - 0.0125, 0.0125), abs=1e-16)


def margin(a: tuple[float, float], b: tuple[float, float]) -> float:
    return float(common_margin(*(tuple(Fraction(str(x)) for x in ends) for ends in (a, b))))


def test_the_four_corners_of_the_paper_are_distinguished() -> None:
    assert 0.27 <= margin((1, 3), (0.5, 2)) < 0.29  # 0.27 with the matrix of the paper's reading, 0.285 with the best
    assert margin((1, 3), (0.5, 2)) == pytest.approx(brute_force((1, 3), (0.5, 2)), rel=0.05)  # the grid is coarse
    assert margin((0.2, 3), (0.05, 5)) == 0


def test_a_point_has_a_common_lyapunov_matrix_exactly_if_it_is_stable() -> None:
    for a, b in product((0.01, 1, 50), (0.01, 1, 50)):
        assert margin((a, a), (b, b)) > 0
    for a, b in ((0, 1), (1, 0), (-1, 1), (1, -1)):
        assert margin((a, a), (b, b)) == 0


def brute_force(a: tuple[float, float], b: tuple[float, float]) -> float:
    """The best margin on a fine grid of P = [[x, y], [y, 1]]."""
    corners = [np.array([[0, 1], [-w_I, -w_P]]) for w_P, w_I in product(a, b)]
    best = 0.0
    for y in np.linspace(0, a[0], 60)[1:]:
        middle = np.linspace(min(y * u + v for u, v in product(a, b)), max(y * u + v for u, v in product(a, b)), 60)
        for x in middle[middle > y * y]:
            P = np.array([[x, y], [y, 1]])
            worst = max(np.linalg.eigvalsh(A.T @ P + P @ A)[-1] for A in corners)
            best = max(best, -worst)
    return best


@pytest.mark.parametrize("seed", range(6))
def test_the_margin_is_that_of_a_brute_force_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = tuple(np.round(np.cumsum(rng.uniform(0.2, 2, 2)), 3))
    b = tuple(np.round(np.cumsum(rng.uniform(0.2, 2, 2)), 3))
    found, expected = margin(a, b), brute_force(a, b)
    assert found >= expected - 1e-9
    assert found <= expected * 1.1 + 0.02


def test_a_box_near_the_edge_of_what_is_possible_is_still_found() -> None:
    low, high = 2.0, 100.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if margin((1, 1), (1, round(middle, 12))) > 0 else (low, middle)
    # for a = 1 and b in [1, B] the best y is 1/2, where x <= 5/2 and x >= 1/2 + B - sqrt(B) just meet: at B = 4
    assert low == pytest.approx(4, abs=1e-6)


def test_bodies_of_point_masses_are_physical_and_others_are_not() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        masses, points = rng.uniform(0.1, 2, 6), rng.normal(size=(6, 3))
        inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, points, strict=True))
        h = masses @ points
        row = [masses.sum(), *h, *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
        found = pivots(pseudo_inertia([Fraction(float(x)) for x in row]))
        assert len(found) == 4
        assert min(found) > 0
        L = np.array([[float(x) for x in line] for line in pseudo_inertia([Fraction(float(x)) for x in row])])
        assert float(np.prod([float(x) for x in found])) == pytest.approx(np.linalg.det(L), rel=1e-6)
    # a violated triangle inequality: I_xx > I_yy + I_zz
    assert min(pivots(pseudo_inertia([Fraction(x) for x in (1, 0, 0, 0, 3, 0, 1, 0, 0, 1)]))) <= 0


@pytest.mark.parametrize("tie", ["velocity", "position"])
def test_kappa_is_what_a_brute_force_maximisation_finds(tie: str) -> None:
    diagram = built(reference="task", friction="viscous", inverse={"tie": tie})
    claim = claim_of(diagram)
    found = small_gain(claim, Numbers(claim, {}))
    assert found is not None
    K_c, gamma, B, K_D, K_P, K_I = 0.8, 0.8, 2.0, 80.0, 176.0, 56.0
    M_bar = (K_D + B) * K_c + K_P - K_I / K_c
    angle = np.linspace(0, np.pi, 200001)
    s, e = np.cos(angle), np.sin(angle)
    consumed = s if tie == "velocity" else s + K_c * e
    ratio = consumed**2 / gamma / ((K_D + B) * s**2 + M_bar * K_c * e**2)
    assert float(found.least) == pytest.approx(ratio.max(), rel=1e-8)
    assert found.chosen == 2 * found.least


def test_kappa_of_the_pi_servo_is_the_consumption_over_the_least_damping() -> None:
    claim = claim_of(built("PI", servo={"K_P": [60, 30], "K_I": 240}))
    found = small_gain(claim, Numbers(claim, {}))
    assert found is not None
    assert found.least == Fraction(1, 2) / 30  # alpha = 2, K_star = 30 at the weaker joint


def test_an_interval_bounds_what_samples_of_it_give() -> None:
    rng = np.random.default_rng(1)
    ranges = {"servo.K_D": [60, 100], "servo.K_P": [150, 200], "servo.K_I": [40, 70]}
    bounds = checked(built(), ranges)
    least = {name: np.inf for name, item in bounds.items() if item.value is not None}
    for _ in range(4):
        servo = {name.split(".")[1]: list(rng.uniform(*ends, 2)) for name, ends in ranges.items()}
        for name, item in checked(built(servo=servo)).items():
            if name in least and item.value is not None:
                least[name] = min(least[name], item.value)
    kappa = "the servo level dominates the cascade's cross term for kappa above"
    for name, sampled in least.items():
        bound = bounds[name].value
        assert bound is not None
        if name != kappa:
            assert bound <= sampled + 1e-12, name
    # M_bar is monotone in each gain: its bound is sharp
    assert bounds[M_BAR].value == pytest.approx(60 * 0.8 + 150 - 70 / 0.8)


def test_an_interval_on_which_a_condition_may_fail_takes_the_proof() -> None:
    diagram = built()
    verdict = verify(diagram, trials=1, uncertain=intervals(diagram, {"servo.K_I": [1, 300]}))
    assert verdict.outcome == "not_applicable"
    assert "M_bar" in verdict.reason


def test_friction_that_may_be_there_is_not_taken_for_absent() -> None:
    diagram = built(friction="none")
    assert verify(diagram, trials=1).outcome == "proved"
    verdict = verify(diagram, trials=1, uncertain=intervals(diagram, {"arm.viscous": [0, 5]}))
    assert verdict.outcome == "refuted"


def with_condition(expression: Any) -> Diagram:
    """The planar arm with one block with a user's condition."""
    block = known_blocks()["pid_inverse"]

    def conditions(self: Any, p: Signals, truth: Signals) -> tuple[Inequality, ...]:
        return (Inequality("mine", expression(p, truth), "me"),)

    space = {"__module__": block.__module__, "conditions": conditions}
    changed = type(block)(block.__name__, (block,), space)
    return loop_of(load("arm2"), "joint", "PID", friction="none").build({"pid_inverse": changed}, lambda _, made: made)


def mine(expression: Any) -> Checked:
    """The user's condition, decided."""
    (found,) = (item for name, item in checked(with_condition(expression)).items() if name.startswith("inverse: mine"))
    return found


def test_a_divisor_whose_interval_holds_zero_leaves_a_condition_undecided_and_reports_it() -> None:
    diagram = with_condition(lambda p, truth: 1 / (truth.K_D - 79))
    assert checked(diagram)["inverse: mine [1/(servo.K_D - 79) > 0]"].value == 1
    verdict = verify(diagram, trials=1, uncertain=intervals(diagram, {"servo.K_D": [70, 90]}))
    assert verdict.outcome == "not_applicable"
    (failing,) = (condition for condition in verdict.conditions if not condition.holds)
    assert (failing.value, failing.how) == (None, "undecided")
    assert failing.expression == "1/(servo.K_D - 79) > 0; undecided: a divisor is zero, or its interval contains zero"
    Draft202012Validator(verdict_schema()).validate(summary("undecided", verdict))


def test_a_divisor_that_is_zero_leaves_a_condition_undecided() -> None:
    assert mine(lambda p, truth: 1 / (truth.K_D - 80)).how == "undecided"
    assert not mine(lambda p, truth: 1 / (truth.K_D - truth.K_D)).holds


def test_a_condition_that_depends_on_a_signal_or_on_a_function_is_undecided() -> None:
    moving = mine(lambda p, truth: truth.i + 10)
    assert moving.name == "inverse: mine [servo.i + 10 > 0]"
    assert "; undecided: expected an expression in parameters alone, found servo.i" in moving.expression
    rooted = mine(lambda p, truth: ca.sqrt(truth.K_D))
    assert "; undecided: value: expected + - * / only" in rooted.expression
    assert not moving.holds
    assert not rooted.holds


def test_a_condition_on_nothing_is_not_taken_for_one_that_holds() -> None:
    empty = mine(lambda p, truth: truth.K_D[2:])
    assert (empty.name, empty.holds, empty.how) == ("inverse: mine [nothing > 0]", False, "undecided")
    assert "expected an expression with elements, found an empty one" in empty.expression


@pytest.mark.parametrize(
    ("words", "expression", "strict", "printed"),
    [
        ("k > 0", lambda k: k, True, ""),
        ("k > 0.5", lambda k: k - 0.5, True, ""),
        ("k < 9", lambda k: 9 - k, True, ""),
        ("9 > k", lambda k: 9 - k, True, ""),
        ("2 k < k + 9", lambda k: 9 - k, True, " [9 - k > 0]"),
        ("kc >= 0", lambda k: named("kc", k * k), False, " [k^2 >= 0]"),
        ("part >= 0", lambda k: named("part", k * k + 1), False, ""),
        ("part >= 0", lambda k: k * k + 1, False, " [k^2 + 1 >= 0]"),
        ("k >= 0", lambda k: k, True, " [k > 0]"),
        ("k > 0", lambda k: k + 10, True, " [k + 10 > 0]"),
        ("0 > k", lambda k: k, True, " [k > 0]"),
        ("k / 2 k > 0", lambda k: k, True, " [k > 0]"),
        ("k > 0 and the sun rises", lambda k: k, True, " [k > 0]"),
        ("abs(k) > 0", lambda k: k, True, " [k > 0]"),
        ("k > (", lambda k: k, True, " [k > 0]"),
        ("many > 0", lambda k: ca.vertcat(*range(1, 30)), True, " [a matrix of numbers > 0]"),
        ("k is large", lambda k: ca.vertcat(*(k + i for i in range(30))), True, " [an expression of k > 0]"),
    ],
)
def test_after_the_words_of_a_condition_its_inequality_is_printed_unless_they_state_it(
    words, expression, strict, printed
):
    @final
    class Toy(AbstractBlock):
        """One state."""

        states: ClassVar[tuple[State, ...]] = (State("x"),)
        k: Scalar = Positive("", "", default=2.0)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(rates={"x": -p.k * x.x})

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            part = named("part", p.k * p.k + 1)
            return Certificate((Square(x.x, part),), (Square(x.x, part * p.k),))

        def conditions(self, p: Signals, truth: Signals) -> tuple[Inequality, ...]:
            return (Inequality(words, expression(p.k), "me", strict),)

    (found,) = (item.name for item in verify(Diagram.build({"a": Toy()}), trials=1).conditions if item.source == "me")
    assert found == f"a: {words}{printed}"


def weighing(make: Any, role: str = "storage") -> Verdict:
    """The joint reference with another weight of its square."""
    block = known_blocks()["joint_tracking"]

    def certificate(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        c = block.certificate(self, u, x, p, truth)
        assert c is not None
        # the square is split into two that add up to it, so that the identity remains true
        W = make(u) if role == "storage" else make(u) * p.alpha_bar / 10  # in the unit of the square

        def split(term: Square) -> tuple[Square, Square]:
            return Square(term.vector, W), Square(term.vector, ca.diag(term.weight * ca.SX.ones(2)) - W)

        storage = (*split(c.storage[0]), *c.storage[1:]) if role == "storage" else c.storage
        spent = (*split(c.dissipation[0]), *c.dissipation[1:]) if role == "dissipation" else c.dissipation
        return Certificate(storage, spent, c.supply, c.consumes)

    changed = type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": certificate})
    loop = loop_of(load("arm2"), "joint", "PI", friction="none")
    return verify(loop.build({"joint_tracking": changed}, lambda _, made: made), trials=1)


@pytest.mark.parametrize("role", ["storage", "dissipation"])
def test_a_matrix_of_weights_is_decided_by_its_own_factors(role: str) -> None:
    good = weighing(lambda u: ca.SX([[0.5, 0.3], [0.3, 0.5]]), role)
    assert good.outcome == "proved"
    bad = weighing(lambda u: ca.SX([[0.5, 0.6], [0.6, 0.5]]), role)
    assert bad.outcome == "not_applicable"
    where = "V" if role == "storage" else "the dissipation"
    assert f"task: weight of |q - q_d|^2 in {where} > 0" in bad.reason


def test_a_matrix_of_weights_that_moves_and_is_no_mass_matrix_is_not_taken_for_one() -> None:
    verdict = weighing(lambda u: ca.diag(u.q * u.q + 0.1) / 100, "dissipation")
    assert verdict.outcome == "not_applicable"
    failing = [condition for condition in verdict.conditions if not condition.holds]
    assert {condition.how for condition in failing} == {"undecided"}


def test_the_mass_matrix_of_links_that_are_no_bodies_is_only_sampled_and_that_is_assumed() -> None:
    loop = loop_of(load("arm2"), "joint", "PI", friction="none")
    row = list(loop.robot.inertia[1])
    row[4] = row[9] = row[6] / 2 - Fraction(1, 10**9)  # the triangle inequality violated about this axis only
    robot = dataclasses.replace(loop.robot, inertia=(loop.robot.inertia[0], tuple(row)))
    verdict = verify(Diagram.build(dict(loop.diagram.blocks), {}, robot), trials=1)
    (found,) = (condition for condition in verdict.conditions if condition.name == "M(q) > 0")
    assert found.how == "sampled"
    named = "between the sampled poses, since what joint joint2 moves is no physical body"
    assert any(named in item.text for item in verdict.assumptions)
    heavy = dataclasses.replace(loop.robot, inertia=(loop.robot.inertia[0], tuple(-x for x in loop.robot.inertia[1])))
    assert verify(Diagram.build(dict(loop.diagram.blocks), {}, heavy), trials=1).outcome == "not_applicable"


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"servo.K_X": [1, 2]}, "uncertain.servo.K_X: unknown parameter of the plant"),
        ({"inverse.K_c": [1, 2]}, "uncertain.inverse.K_c: unknown parameter of the plant"),
        ({"servo.K_D": [90, 100]}, "uncertain.servo.K_D: expected an interval that holds the graph's own"),
        ({"servo.K_D": 80}, "uncertain.servo.K_D: expected an interval [lower, upper]"),
        ({"servo.K_D": [-1, 100]}, "uncertain.servo.K_D: expected a number > 0, found -1"),
    ],
)
def test_a_bad_interval_states_what_was_expected(given: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        intervals(built(), given)
    assert text in str(caught.value)


def eliminated(matrix: list[list[Fraction]]) -> list[Fraction]:
    """The textbook's pivots, in Fractions."""
    rows, found = [list(row) for row in matrix], list[Fraction]()
    for j in range(len(rows)):
        found.append(rows[j][j])
        if found[-1] <= 0:
            break
        for i in range(j + 1, len(rows)):
            factor = rows[i][j] / rows[j][j]
            rows[i] = [above - factor * below for above, below in zip(rows[i], rows[j], strict=True)]
    return found


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 13])
@pytest.mark.parametrize("dense", [0.3, 1.0])
def test_pivots_in_whole_numbers_are_those_in_fractions(n: int, dense: float) -> None:
    rng, signs = random.Random(n), set[bool]()
    for shift in (-1, 0, 1, 2, 3) * 4:
        half = [[Fraction(rng.randrange(-9, 10), rng.randrange(1, 50)) for _ in range(n)] for _ in range(n)]
        half = [[value if rng.random() < dense else Fraction(0) for value in row] for row in half]
        matrix = [[sum((a * b for a, b in zip(x, y, strict=True)), Fraction(0)) for y in half] for x in half]
        matrix = [
            [value + Fraction(shift, 7) * (i == j) for j, value in enumerate(row)] for i, row in enumerate(matrix)
        ]
        found = pivots(matrix)
        assert found == eliminated(matrix)
        signs.add(found[-1] > 0)
    assert signs == {True, False}


def test_intervals_enclose_the_pivots_of_all_their_matrices() -> None:
    rng = np.random.default_rng(2)
    one = Fraction(1)
    box = [[Interval(2 * one, 3 * one), Interval(-one, one)], [Interval(-one, one), Interval(2 * one, 3 * one)]]
    found = pivots(box)
    assert found == [2, Fraction(3, 2)]
    for _ in range(50):
        a, d, b = rng.uniform(2, 3), rng.uniform(2, 3), rng.uniform(-1, 1)
        assert d - b * b / a >= float(found[1])
    assert common_margin((one, 3 * one), (one / 2, 2 * one)) > 0
