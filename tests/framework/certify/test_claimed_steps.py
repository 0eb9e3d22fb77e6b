"""Certificates over samples that differ from their block: other delay lines, identities and gains of equal number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from test_samples import Carts, Learner

from dmframe.block import Signals
from dmframe.block.certificate import Certificate, DelayLine, PlantIdentity
from dmframe.block.parameter import Positive, Scalar
from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram

Change = Callable[[Certificate, Any, Any, Any], Certificate]


def claiming(change: Change) -> Verdict:
    """The verdict on the learner with a changed certificate: of the certificate, inputs, parameters and true values."""

    class Claiming(Learner):
        other: Scalar = Positive(default=2.0)  # the value of `gain`

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            return change(super().certificate(u, x, p, truth), u, p, truth)

    return verify(Diagram.build({"learner": Claiming(), "carts": Carts()}))


def line(entry: Callable[[Any], Any]) -> Change:
    return lambda c, u, p, true: replace(c, delay_lines=(DelayLine("rows", entry(c.delay_lines[0].newest)),))


def obeys(identity: Callable[[Any, Any], PlantIdentity]) -> Change:
    return lambda c, u, p, true: replace(c, plant=(identity(u, true),))


def steps(**changed: Callable[[Any], Any]) -> Change:
    return lambda c, u, p, true: replace(
        c, steps=(replace(c.steps[0], **{name: value(p) for name, value in changed.items()}),)
    )


@pytest.mark.parametrize("length", [lambda new: new[:5], lambda new: ca.vertcat(new, 1), lambda new: new.T])
def test_a_delay_line_of_another_length_is_refused(length: Callable[[Any], Any]) -> None:
    verdict = claiming(line(length))
    assert verdict.outcome == "not_applicable"
    assert "learner: rows is 6 x 3, which is not an integer multiple of" in verdict.reason


@pytest.mark.parametrize(
    ("change", "reports"),
    [
        (line(lambda new: ca.vertcat(new[4:], new[:4])), "next value of rows"),
        (line(lambda new: new / 2), "next value of rows"),
        (
            obeys(lambda u, true: PlantIdentity(-true.m * u.v, true.b * u.v - true.force)),
            "plant identity",
        ),
        (
            obeys(lambda u, true: PlantIdentity(true.m * u.v, true.b * u.v + true.force)),
            "plant identity",
        ),
        (
            obeys(lambda u, true: PlantIdentity(true.b * u.v, true.m * u.v - true.force)),
            "plant identity",
        ),
        (steps(gain=lambda p: p.other * ca.DM.ones(4)), "next value of theta"),
        (steps(gain=lambda p: ca.vertcat(p.gain, p.gain, p.gain, p.other)), "next value of theta"),
        (steps(floor=lambda p: p.gain), "next value of theta"),
    ],
)
def test_a_claim_of_another_order_sign_or_parameter_is_refuted(change: Change, reports: str) -> None:
    verdict = claiming(change)
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.statement == f"learner: {reports}"


def test_the_claim_as_it_is_is_proved() -> None:
    assert claiming(lambda c, u, p, true: c).outcome == "proved"


def test_an_identity_with_both_signs_turned_is_the_same_identity() -> None:
    change = obeys(lambda u, true: PlantIdentity(-true.m * u.v, true.force - true.b * u.v))
    assert claiming(change).outcome == "proved"
