"""The cross-check at real points for claims of one line: each false claim is refuted, and no true one."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest
from scalar_blocks import scalar_loop

from dmframe.block.certificate import Certificate, Lemma, Square
from dmframe.certify import Verdict, verify

ONE, ZERO = ca.SX(1), ca.SX(0)


def decide(rate: Any, spent: Any, of_z: Any = None) -> Verdict:
    """y' = rate(y) claims the loss `spent(y)` of y^2 / 2; z' = of_z(y, t) z claims the loss z^2."""
    states = "y" if of_z is None else "y z"

    def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
        return {"y": rate(x.y)} | ({"z": of_z(x.y, u.t) * x.z} if of_z else {})

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        more = (Square(x.z, ONE),) if of_z else ()
        return Certificate(storage=(Square(x.y, ONE), *more), dissipation=(spent(x.y), *more))

    return verify(scalar_loop(states, rates, claim))


def square(weight: float) -> Any:
    return lambda y: Square(y, ca.SX(weight))


def monotone(weight: float, phi: str = "tanh") -> Any:
    return lambda y: Lemma(ca.SX(weight), y, ZERO, ONE, phi)


PROVED = {
    "decimals that floats miss": (lambda y: -0.1 * y - 0.2 * y, square(0.3)),
    "thirds": (lambda y: -y * (1 / 3) - y * (2 / 3), square(1)),
    "dry friction": (lambda y: -ca.sign(y), monotone(1, "sign")),
}
REFUTED = {
    "a weight 1e-9 too large": (lambda y: -y, square(1 + 1e-9)),
    "a lemma's weight 1e-9 too large": (lambda y: -ca.tanh(y), monotone(1 + 1e-9)),
    "a wrong power where the state is positive": (lambda y: -(y**1.5), lambda y: Square(y**1.2, ONE)),
    "an absolute value taken for the state": (lambda y: -ca.fabs(y), square(1)),
}
UNDECIDED = {
    "decimals that Python added": (lambda y: -(0.1 + 0.2) * y, square(0.3), "no more than the rounding of numbers"),
    "a power, where it is real": (lambda y: -(y**1.5), lambda y: Square(y**1.25, ONE), "property of a function"),
    "tanh, which is odd": (lambda y: ca.tanh(-y), monotone(1), "property of a function"),
    "a root of what is negative": (
        lambda y: -y * ca.sqrt(-1 - y * y) - y, lambda y: Square(y, 2 + 0 * y), "undefined at all of 100 random",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PROVED)
def test_what_is_true_but_for_the_rounding_of_literals_is_proved(name: str) -> None:
    verdict = decide(*PROVED[name])
    assert verdict.outcome == "proved", verdict.reason


@pytest.mark.parametrize("name", REFUTED)
def test_a_small_false_claim_is_refuted_and_not_taken_for_rounding(name: str) -> None:
    verdict = decide(*REFUTED[name])
    assert verdict.outcome == "refuted", verdict.reason


@pytest.mark.parametrize("name", UNDECIDED)
def test_what_no_real_point_contradicts_is_not_decided_and_gives_the_reason(name: str) -> None:
    rate, spent, why = UNDECIDED[name]
    verdict = decide(rate, spent)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("not decided: ")
    assert why in verdict.reason


# Each is -1 at all random points, and 0 on a set that the loop never leaves.
SWITCHES = {
    "sign squared": lambda y, t: -(ca.sign(y) ** 2),
    "sign of a product squared": lambda y, t: -(ca.sign(y * (1 + y * y)) ** 2),
    "sign to the fourth": lambda y, t: -(ca.sign(y) ** 4),
    "comparisons": lambda y, t: -ca.if_else(y < 0, 1, ca.if_else(y > 0, 1, 0)),
    "inequality": lambda y, t: -(y != 0),
    "fmin and fmax": lambda y, t: -(ca.fmax(y, 0) > ca.fmin(y, 0)),
    "absolute value": lambda y, t: -(ca.fabs(y) > 0),
    "on a set that moves": lambda y, t: -(ca.sign(y - t) ** 2),
    "floor": lambda y, t: ca.floor(-ca.fabs(y) / (1 + ca.fabs(y))),
}


@pytest.mark.parametrize("name", SWITCHES)
def test_a_rate_that_vanishes_on_a_switching_set_is_never_proved(name: str) -> None:
    verdict = decide(lambda y: -y, square(1), SWITCHES[name])
    assert verdict.outcome != "proved"


def test_a_sign_that_is_zero_on_an_invariant_set_is_refuted_there() -> None:
    verdict = decide(lambda y: -y, square(1), SWITCHES["sign squared"])
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.signals == ("toy.z",)
