"""Units of equations in a user's blocks: correct ones pass, and each wrong one is located.

The correct units are known from mechanics: each term of K q + D dq + I ddq = tau is a torque.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import pytest
from user_units import UNITS, faults, joint

from dmframe.block.certificate import Certificate, Inequality, Square
from dmframe.certify import verify

BASES = ("kg", "m", "s", "rad")


def spring_energy(u: Any, x: Any, p: Any) -> Certificate:
    """(I dq^2 + K q^2)/2, dissipated by the damper."""
    return Certificate(storage=(Square(x.dq, p.I), Square(x.q, p.K)), dissipation=(Square(x.dq, p.D),))


def test_joints_on_springs_have_units_that_agree_and_are_proved() -> None:
    diagram = joint(certificate=spring_energy)
    assert faults(diagram) == []
    assert verify(diagram).outcome == "proved"


@pytest.mark.parametrize(
    ("name", "unit", "known"),
    [("K", "N m", "K in N m/rad"), ("K", "N/rad", "K in N m/rad"), ("D", "N m s", "D in N m s/rad")],
)
def test_a_gain_in_a_wrong_unit_is_named_with_the_right_one_and_nothing_is_proved(
    name: str, unit: str, known: str
) -> None:
    diagram = joint(certificate=spring_energy, **{name: unit})
    (text,) = faults(diagram)
    assert text.startswith("joint: the output tau: expected one unit in K[0]*q[0] + D[0]*dq[0], found ")
    assert text.endswith(f"; {known} would agree")
    verdict = verify(diagram)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason == f"the units do not agree: {text}"


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("name", ["K", "D", "I"])
def test_each_wrong_exponent_of_a_gain_is_found(name: str, base: str) -> None:
    found = faults(joint(**{name: f"{UNITS[name]} {base}" if "/" not in UNITS[name] else f"{base} {UNITS[name]}"}))
    # of an inertia, whose unit contains kg, the power of rad is undetermined
    assert bool(found) is ((name, base) != ("I", "rad"))


WRONG: dict[str, Callable[[Any, Any], Any]] = {
    "a product too many": lambda x, p: p.K * x.q * x.q + p.D * x.dq,
    "a factor left out": lambda x, p: p.K * x.q + x.dq,
    "a number with a unit": lambda x, p: p.K * (x.q - x.dq * 0.1),
    "a root": lambda x, p: ca.sqrt(p.K * x.q),
    "a power": lambda x, p: p.K * x.q**3,
    "a minimum of two units": lambda x, p: p.K * ca.fmin(x.q, x.dq),
    "a comparison of two units": lambda x, p: ca.if_else(x.q > x.dq, 1, 0) * p.K * x.q,
    "a sine of a velocity": lambda x, p: p.K * ca.sin(x.dq),
    "an exponential of a torque": lambda x, p: p.K * x.q * ca.exp(p.K * x.q),
    "a branch in another unit": lambda x, p: ca.if_else(x.q > 0, p.K * x.q, p.D * x.q),
}


@pytest.mark.parametrize("kind", WRONG)
def test_equations_of_other_units_are_refused_by_the_operation_that_is_wrong(kind: str) -> None:
    (text,) = faults(joint(output=WRONG[kind]))
    assert text.startswith("joint: ")
    assert "the output tau" in text


RIGHT: dict[str, Callable[[Any, Any], Any]] = {
    "a sum of torques": lambda x, p: p.K * x.q + p.D * x.dq,
    "zero": lambda x, p: 0 * x.q,
    "numbers": lambda x, p: 2 * p.K * x.q / 3 - p.K * x.q / 7,
    "a sine": lambda x, p: p.K * ca.sin(x.q),
    "a smooth sign": lambda x, p: p.K * x.q * ca.tanh(x.dq / (p.w * x.q)),
    "a root of a square": lambda x, p: p.K * ca.sqrt(x.q**2 + (x.dq / p.w) ** 2),
    "an angle made one of a turn": lambda x, p: p.K * (x.q - 2 * ca.pi * ca.floor(x.q / (2 * ca.pi) + 0.5)),
    "an angle in numbers": lambda x, p: p.K * ca.fmax(x.q, 0.1),
    "a branch": lambda x, p: ca.if_else(x.q > 0, p.K * x.q, p.D * x.dq),
    "signs": lambda x, p: p.K * ca.fabs(x.q) * ca.sign(x.dq),
    "inertia times acceleration": lambda x, p: p.I * p.w * x.dq,
}


@pytest.mark.parametrize("kind", RIGHT)
def test_equations_whose_units_agree_pass(kind: str) -> None:
    assert faults(joint(output=RIGHT[kind])) == []


def test_a_number_that_has_a_unit_has_to_be_a_parameter() -> None:
    (text,) = faults(joint(output=lambda x, p: p.K * x.q + 0.5))
    assert text == (
        "joint: the output tau: expected one unit in K[0]*q[0] + 0.5, found N m in K[0]*q[0] and a plain number in "
        "0.5; declare a number with a unit as a parameter"
    )


def test_a_rate_is_that_of_its_state() -> None:
    (text,) = faults(joint(rates=lambda u, x, p: {"q": x.q, "dq": -p.K * x.q / p.I}))
    assert text == "joint: expected the rate of q in rad/s, found rad: q[0]"


def test_a_start_has_the_unit_of_its_state() -> None:
    (text,) = faults(joint(start=lambda p: {"q": p.K / p.K, "dq": p.K / p.D / p.D}))
    assert text.startswith("joint: expected the start of dq in rad/s, found ")


@pytest.mark.parametrize(
    ("what", "wrong"),
    [
        ("the storage S", Certificate(storage=())),
        ("the dissipation", Certificate()),
    ],
)
def test_terms_of_a_certificate_have_one_unit(what: str, wrong: Certificate) -> None:
    def certificate(u: Any, x: Any, p: Any) -> Certificate:
        kinetic, potential = Square(x.dq, p.I), Square(x.q, p.D if what == "the storage S" else p.K)
        spent = Square(x.dq, p.I if what == "the dissipation" else p.D)
        return Certificate(storage=(kinetic, potential), dissipation=(spent,))

    (text,) = faults(joint(certificate=certificate))
    assert text.startswith(f"joint: expected {what} in ")


def test_both_sides_of_a_condition_have_one_unit() -> None:
    def condition(right: bool) -> list[str]:
        def stated(p: Any) -> Any:
            return (Inequality("damped", p.D - (p.K / p.w if right else p.K), "a book"),)

        return faults(joint(conditions=stated))

    assert condition(right=True) == []
    (text,) = condition(right=False)
    assert "the condition damped: expected one unit in D[0] - K[0], found N m s/rad in D[0] and N m/rad in K[0]" in text
