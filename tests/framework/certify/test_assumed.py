"""Weights that are positive by assumption: what is listed, and which lies are seen all the same."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest
from scalar_blocks import scalar_loop

from dmframe.certificate import Certificate, Square
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram

WHY = "the tank never runs dry"
START = {"toy.y": 0.5, "toy.z": 2.0}


def draining(
    weight: Any = lambda x, p: x.z, positive: str = WHY, sign: int = 1, spent: Any = lambda x: Square(x.y)
) -> Diagram:
    """An error y, weighed with a level z that moves with it: z y^2 / 2 falls by y^2."""

    def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
        return {"y": -sign * (x.y + x.y**2 / 2) / x.z, "z": x.y}

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate(storage=(Square(x.y, weight(x, p), positive=positive),), dissipation=(spent(x),))

    return scalar_loop("y z", rates, claim)


def assumed(verdict: Verdict) -> list[str]:
    return [item.text for item in verdict.assumptions if "stays above a positive constant" in item.text]


def bounded(verdict: Verdict) -> set[str]:
    return {item.signal for item in verdict.statements if item.says == "is bounded"}


def failing(verdict: Verdict) -> list[str]:
    return [item.name for item in verdict.conditions if not item.holds]


def test_a_weight_that_nobody_can_decide_is_assumed_by_its_text_and_by_what_it_is() -> None:
    verdict = verify(draining(), start=START)
    assert verdict.outcome == "proved"
    assert assumed(verdict) == [f"toy: the weight z of |y|^2 in V stays above a positive constant: {WHY}"]
    assert all(control.refuted for control in verdict.controls)
    assert "y" in bounded(verdict)
    (looked,) = (item for item in verdict.conditions if "at the start" in item.name)
    assert (looked.how, looked.value) == ("sampled", 2.0)


def test_without_the_assumption_the_same_is_not_proved() -> None:
    verdict = verify(draining(positive=""), start=START)
    assert verdict.outcome == "not_applicable"
    assert failing(verdict) == ["toy: weight of |y|^2 in V > 0"]


def test_a_wrong_sign_in_the_equations_is_refuted_whatever_is_assumed() -> None:
    assert verify(draining(sign=-1), start=START).outcome == "refuted"


def test_a_weight_that_is_assumed_but_decidable_is_decided() -> None:
    def claim(k: Any) -> Any:
        def stated(x: Any, u: Any, p: Any) -> Certificate:
            return Certificate(storage=(Square(x.y, k(p), positive=WHY),), dissipation=(Square(x.y, k(p)),))

        return stated

    def judged(k: Any) -> Verdict:
        return verify(scalar_loop("y", lambda x, u, p: {"y": -x.y}, claim(k)), start={"toy.y": 1.0})

    honest = judged(lambda p: p.k)
    assert honest.outcome == "proved"
    assert assumed(honest) == []
    for lie in (lambda p: -p.k, lambda p: p.k - 2, lambda p: p.k - p.k):
        verdict = judged(lie)
        assert verdict.outcome == "not_applicable"
        assert assumed(verdict) == []


def two(*weights: Any) -> Verdict:
    """Two errors beside a level that stands still, with these weights."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        column, error = ca.vertcat(*(weight(x, p) for weight in weights)), ca.vertcat(x.a, x.b)
        return Certificate(
            storage=(Square(error, column, positive=WHY),), dissipation=(Square(error, column, positive=WHY),)
        )

    loop = scalar_loop("a b z", lambda x, u, p: {"a": -x.a, "b": -x.b, "z": 0 * x.z}, claim)
    return verify(loop, start={"toy.a": 1.0, "toy.b": 1.0, "toy.z": 1.0})


@pytest.mark.parametrize("lie", [lambda x, p: -p.k, lambda x, p: 0 * x.z], ids=["negative", "zero"])
def test_no_element_that_parameters_decide_hides_behind_one_that_they_leave_open(lie: Any) -> None:
    honest = two(lambda x, p: p.k, lambda x, p: x.z)
    assert honest.outcome == "proved"
    verdict = two(lie, lambda x, p: x.z)
    assert verdict.outcome != "proved"
    assert "toy: weight of |(a, b)|^2 in V > 0" in failing(verdict)


def test_one_that_is_not_above_zero_at_the_start_is_refused() -> None:
    for z in (-2.0, 0.0):
        verdict = verify(draining(), start={"toy.y": 0.5, "toy.z": z})
        assert verdict.outcome == "not_applicable"
        assert "the weight z of |y|^2 in V is above zero at the start" in verdict.reason


def test_one_whose_start_is_not_known_has_to_be_above_zero_somewhere() -> None:
    """V = -(1 + z^2) y^2 / 2, with its rate as it is, calls itself positive."""

    def loop(weight: Any) -> Diagram:
        def claim(x: Any, u: Any, p: Any) -> Certificate:
            return Certificate(
                storage=(Square(x.y, weight(x), positive=WHY),), dissipation=(Square(x.y, weight(x), positive=WHY),)
            )

        return scalar_loop("y z", lambda x, u, p: {"y": -x.y, "z": 0 * x.z}, claim)

    assert verify(loop(lambda x: 1 + x.z**2)).outcome == "proved"
    verdict = verify(loop(lambda x: -(1 + x.z**2)))
    assert verdict.outcome == "not_applicable"
    assert "is above zero at one of 200 sampled states" in verdict.reason


def test_a_matrix_may_be_assumed_too_and_shows_what_it_is_at_the_start() -> None:
    def loop(matrix: Any) -> Diagram:
        def claim(x: Any, u: Any, p: Any) -> Certificate:
            error = ca.vertcat(x.a, x.b)
            return Certificate(
                storage=(Square(error, matrix(x, p), positive=WHY),),
                dissipation=(Square(error, matrix(x, p), positive=WHY),),
            )

        return scalar_loop("a b z", lambda x, u, p: {"a": -x.a, "b": -x.b, "z": 0 * x.z}, claim)

    def coupled(x: Any, p: Any) -> Any:
        return ca.blockcat([[p.k, x.z], [x.z, p.k]])

    assert verify(loop(coupled), start={"toy.a": 1.0, "toy.z": 1.0}).outcome == "proved"
    assert verify(loop(coupled), start={"toy.a": 1.0, "toy.z": 3.0}).outcome == "not_applicable"
    lying = verify(loop(lambda x, p: ca.blockcat([[-p.k, x.z], [x.z, x.z]])), start={"toy.a": 1.0, "toy.z": 3.0})
    assert "toy: weight of |(a, b)|^2 in V > 0" in failing(lying)


@pytest.mark.parametrize("text", [" ", "two\nlines"])
def test_an_assumption_is_a_text_of_one_line(text: str) -> None:
    verdict = verify(draining(positive=text), start=START)
    assert verdict.outcome == "not_applicable"
    assert "expected positive to be a text of one line" in verdict.reason


def test_a_bound_is_not_to_be_had_by_assumption() -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate(storage=(Square(x.y),), excess=(Square(x.y, x.z, positive=WHY),))

    verdict = verify(scalar_loop("y z", lambda x, u, p: {"y": x.y, "z": -x.z}, claim))
    assert verdict.outcome == "not_applicable"
    assert "expected no weight of the excess to be positive by assumption" in verdict.reason


def test_nobody_pays_with_a_weight_that_is_only_assumed() -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        spent = Square(x.y, x.z, positive=WHY)
        return Certificate(storage=(Square(x.y, x.z, positive=WHY),), dissipation=(spent,), pays=(1,))

    verdict = verify(scalar_loop("y z", lambda x, u, p: {"y": -x.y, "z": 0 * x.z}, claim))
    assert verdict.outcome == "not_applicable"
    assert "nobody pays for a cascade with a weight that is positive by assumption" in verdict.reason


def test_beside_a_residual_nothing_is_ultimately_bounded_by_a_weight_that_may_grow() -> None:
    """V = z y^2 / 2 falls by y^2 and gains a constant: as z grows without end, y^2 is no share of V."""

    def loop(weight: Any, moves: int) -> Diagram:
        def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
            gained = p.k / 2 - x.y**2 - moves * x.y**3 / 2
            return {"y": gained / (weight(x, p) * x.y), "z": moves * x.y}

        def claim(x: Any, u: Any, p: Any) -> Certificate:
            held = Square(x.y, weight(x, p), positive=WHY)
            return Certificate(storage=(held,), dissipation=(Square(x.y),), excess=(Square(ca.SX(1), p.k / 2),))

        return scalar_loop("y z", rates, claim)

    def ultimately(diagram: Diagram) -> set[str]:
        verdict = verify(diagram, start=START)
        assert verdict.outcome == "proved"
        return {item.signal for item in verdict.statements if item.says == "is ultimately bounded"}

    assert ultimately(loop(lambda x, p: p.k, 0)) == {"y"}
    assert ultimately(loop(lambda x, p: x.z, 1)) == set()
