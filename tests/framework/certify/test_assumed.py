"""Weights that are positive by assumption: the listed assumptions, and false claims that are refuted anyway."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scalar_blocks import scalar_loop

from dmframe.block.certificate import Certificate, Square
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.checked import Numbers
from dmframe.certify.contradicted import kept_above
from dmframe.diagram import Diagram
from dmframe.results.along import along
from dmframe.simulate import simulate

WHY = "the tank never runs dry"
START = {"toy.y": 0.5, "toy.z": 2.0}


def draining(
    weight: Any = lambda x, p: x.z, positive: str = WHY, sign: int = 1, spent: Any = lambda x: Square(x.y)
) -> Diagram:
    """An error y, weighted with a level z that moves with it: z y^2 / 2 decreases by y^2."""

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


def test_an_undecidable_weight_is_assumed_by_its_text_and_by_what_it_is() -> None:
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
    """Two errors and a constant level, with these weights."""

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


def test_one_whose_start_is_not_stated_has_to_be_above_zero_at_zero() -> None:
    """V = -(1 + z^2) y^2 / 2, with its correct rate, declared positive."""

    def loop(weight: Any) -> Diagram:
        def claim(x: Any, u: Any, p: Any) -> Certificate:
            return Certificate(
                storage=(Square(x.y, weight(x), positive=WHY),), dissipation=(Square(x.y, weight(x), positive=WHY),)
            )

        return scalar_loop("y z", lambda x, u, p: {"y": -x.y, "z": 0 * x.z}, claim)

    assert verify(loop(lambda x: 1 + x.z**2)).outcome == "proved"
    verdict = verify(loop(lambda x: -(1 + x.z**2)))
    assert verdict.outcome == "not_applicable"
    assert "is above zero at the start" in verdict.reason


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
        return Certificate(storage=(Square(x.y),), residual=(Square(x.y, x.z, positive=WHY),))

    verdict = verify(scalar_loop("y z", lambda x, u, p: {"y": x.y, "z": -x.z}, claim))
    assert verdict.outcome == "not_applicable"
    assert "expected no weight of the residual to be positive by assumption" in verdict.reason


def test_a_weight_that_is_only_assumed_dominates_no_cross_term() -> None:
    def claim(x: Any, u: Any, p: Any) -> Certificate:
        spent = Square(x.y, x.z, positive=WHY)
        return Certificate(storage=(Square(x.y, x.z, positive=WHY),), dissipation=(spent,), dominates=(1,))

    verdict = verify(scalar_loop("y z", lambda x, u, p: {"y": -x.y, "z": 0 * x.z}, claim))
    assert verdict.outcome == "not_applicable"
    assert "no weight that is positive by assumption can dominate a cascade's cross term" in verdict.reason


def test_with_a_residual_a_weight_that_may_grow_gives_no_ultimate_bound() -> None:
    """V = z y^2 / 2 decreases by y^2 and gains a constant: as z is unbounded, y^2 is no fixed fraction of V."""

    def loop(weight: Any, moves: int) -> Diagram:
        def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
            gained = p.k / 2 - x.y**2 - moves * x.y**3 / 2
            return {"y": gained / (weight(x, p) * x.y), "z": moves * x.y}

        def claim(x: Any, u: Any, p: Any) -> Certificate:
            held = Square(x.y, weight(x, p), positive=WHY)
            return Certificate(storage=(held,), dissipation=(Square(x.y),), residual=(Square(ca.SX(1), p.k / 2),))

        return scalar_loop("y z", rates, claim)

    def ultimately(diagram: Diagram) -> set[str]:
        verdict = verify(diagram, start=START)
        assert verdict.outcome == "proved"
        return {item.signal for item in verdict.statements if item.says == "is ultimately bounded"}

    assert ultimately(loop(lambda x, p: p.k, 0)) == {"y"}
    assert ultimately(loop(lambda x, p: x.z, 1)) == set()


# An assumption is useless if the conclusions, or the equations themselves, send its object to zero.


def weighted(states: str, rates: Any, weight: Any, spent: Any, also: Any = None, **sources: Any) -> Diagram:
    """X with an assumed weight in V and another in dV/dt; `also` is another square of V and of the dissipation."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        storage, dissipation = [Square(x.x, weight(x, u), positive=WHY)], [Square(x.x, spent(x, u), positive=WHY)]
        if also is not None:
            storage, dissipation = [*storage, also(x)[0]], [*dissipation, also(x)[1]]
        return Certificate(storage=tuple(storage), dissipation=tuple(dissipation))

    return scalar_loop(states, lambda x, u, p: rates(x), claim, **sources)


def weighed(*given: Any, start: Any = None, **options: Any) -> Verdict:
    return verify(weighted(*given, **options), start=start or {})


def dip(t: Any) -> Any:
    return ca.exp(-((t - 7.777) ** 2) * 1e5)


VAIN = {
    "what V concludes": (
        ("x w", lambda x: {"x": x.x, "w": -4 * x.w}, lambda x, u: x.w, lambda x, u: x.w),
        {"also": lambda x: (Square(x.w), Square(x.w, 4))},
        "it is not above zero where w is zero, which V concludes",
    ),
    "a product with what V concludes": (
        (
            "x w z",
            lambda x: {"x": x.x, "w": -4 * x.w, "z": 0},
            lambda x, u: x.w * (2 + x.z**2),
            lambda x, u: x.w * (2 + x.z**2),
        ),
        {"also": lambda x: (Square(x.w), Square(x.w, 4))},
        "it is not above zero where w is zero, which V concludes",
    ),
    "its own decay": (
        ("x w", lambda x: {"x": x.x, "w": -4 * x.w}, lambda x, u: x.w, lambda x, u: x.w),
        {},
        "its rate is -4 times itself a second",
    ),
    "a straight line through zero": (
        ("x w", lambda x: {"x": -x.x, "w": -1}, lambda x, u: x.w, lambda x, u: x.w + 0.5),
        {"start": {"toy.w": 1e6}},
        "its rate is -1 a second",
    ),
    "a function of time": (
        ("x", lambda x: {"x": -x.x}, lambda x, u: 1 / (1 + u.t), lambda x, u: 1 / (1 + u.t) + 0.5 / (1 + u.t) ** 2),
        {},
        "and falls",
    ),
    "a power of a state": (
        ("x w", lambda x: {"x": -x.x, "w": -(x.w**5)}, lambda x, u: x.w, lambda x, u: x.w + x.w**5 / 2),
        {"start": {"toy.w": 1.0}},
        "and falls",
    ),
    "what is above zero until late": (
        (
            "x",
            lambda x: {"x": -x.x},
            lambda x, u: 2 - (u.t / 500) ** 2,
            lambda x, u: 2 - (u.t / 500) ** 2 + u.t / 250000,
        ),
        {},
        "it is -",
    ),
    "a dip of some milliseconds": (
        (
            "x",
            lambda x: {"x": -x.x},
            lambda x, u: 1 - 2 * dip(u.t),
            lambda x, u: 1 - 2 * dip(u.t) * (1 + (u.t - 7.777) * 1e5),
        ),
        {},
        "at t = 7.77",
    ),
    "a state that starts at zero without a word": (
        ("x w", lambda x: {"x": -x.x, "w": 0}, lambda x, u: x.w**2, lambda x, u: x.w**2),
        {},
        "it is 0 at t = 0 s",
    ),
    "an oscillation": (
        ("x a b", lambda x: {"x": -x.x, "a": x.b, "b": -x.a}, lambda x, u: x.a + 0.5, lambda x, u: x.a + 0.5 - x.b / 2),
        {"start": {"toy.x": 1.0, "toy.a": 1.0, "toy.b": 0.0}},
        "at t = 2.1 s",
    ),
}


@pytest.mark.parametrize("name", VAIN)
def test_a_weight_that_does_not_stay_above_zero_is_not_assumed_to(name: str) -> None:
    given, options, why = VAIN[name]
    verdict = weighed(*given, **options)
    assert verdict.outcome == "not_applicable"
    reported = [item.name for item in verdict.conditions if not item.holds and "is assumed to stay above" in item.name]
    assert reported
    assert why in reported[0]


STAYS = {
    "one that settles above zero": (
        ("x w", lambda x: {"x": -x.x, "w": 1 - x.w}, lambda x, u: x.w, lambda x, u: 1.5 * x.w - 0.5),
        {"start": {"toy.w": 5.0}},
    ),
    "one that swings above zero": (
        ("x a b", lambda x: {"x": -x.x, "a": x.b, "b": -x.a}, lambda x, u: x.a + 3, lambda x, u: x.a + 3 - x.b / 2),
        {"start": {"toy.x": 1.0, "toy.a": 1.0, "toy.b": 0.0}},
    ),
    "one that is not zero where V ends": (
        ("x w", lambda x: {"x": -x.x, "w": -x.w}, lambda x, u: 2 + x.w, lambda x, u: 2 + 1.5 * x.w),
        {"also": lambda x: (Square(x.w), Square(x.w)), "start": {"toy.w": 1.0}},
    ),
}


@pytest.mark.parametrize("name", STAYS)
def test_a_weight_that_stays_above_zero_may_be_assumed_to(name: str) -> None:
    given, options = STAYS[name]
    verdict = weighed(*given, **options)
    assert verdict.outcome == "proved", verdict.reason


def test_a_weight_that_is_assumed_names_what_decides_that_it_stays_above_zero() -> None:
    given, _ = STAYS["one that settles above zero"]
    claim = claim_of(weighted(*given))
    found = dict(kept_above(claim, Numbers(claim, {})))
    assert [name.partition(" stays")[2] for name in found] == [" above a positive constant"] * len(found)
    starts = {str(symbol) for reads in found.values() for symbol in ca.symvar(reads)}
    assert str(ca.symvar(claim.starts["toy.w"])[0]) in starts


def test_a_run_warns_when_an_assumed_weight_is_not_above_zero() -> None:
    diagram = draining(sign=1)
    run = simulate(diagram, 4.0, clock=0.01, start={"y": [-1.9], "z": [1.0]})
    found = along(claim_of(diagram), run)
    z = run.states["toy.z"][:, 0]
    first = int(np.flatnonzero(z <= 0)[0]) if np.any(z <= 0) else None
    assert first is not None
    (reported, *_) = found.notes
    assert reported.startswith(f"toy: the weight z of |y|^2 in V is {z[first]:.3g} at t = {run.time[first]:.6g} s")
    calm = simulate(diagram, 1.0, clock=0.01, start={"y": [0.5], "z": [2.0]})
    assert along(claim_of(diagram), calm).notes == ()
