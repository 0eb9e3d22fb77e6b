"""Lemmas for functions that a prime field does not have, projections, ill-formed certificates, users' blocks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from closed_loops import known_blocks, loop_of, true_in_numbers
from user_blocks import FilteredDamping, OddDamping, SaturatedDamping

from dmframe.block import AbstractBlock, Signals
from dmframe.block.certificate import MONOTONE, Certificate, Consumed, InformationSquare, Lemma, Square, TrueValue
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.checked import Numbers
from dmframe.certify.conditions import conditions_of
from dmframe.diagram import Diagram
from dmframe.robot.library import load


def diagram(
    *, extra: dict[str, AbstractBlock] | None = None, swapped: dict[str, Any] | None = None, **options: Any
) -> Diagram:
    loop = loop_of(load("arm2"), "joint", "PI", **options)
    blocks = dict(loop.build(swapped or {}, lambda _, mutant: mutant).blocks)
    return Diagram.build({**blocks, **(extra or {})}, {}, loop.robot)


def claiming(kind: str, certificate: Any) -> dict[str, type[AbstractBlock]]:
    """A block of the catalogue with another certificate, made of its own."""
    block = known_blocks()[kind]

    def stated(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        honest = block.certificate(self, u, x, p, truth)
        made = certificate(honest, u, x, p, truth)
        return replace(made, estimates=made.estimates or honest.estimates) if isinstance(made, Certificate) else made

    space = {"__module__": block.__module__, "certificate": stated}
    return {kind: type(block)(block.__name__, (block,), space)}


def verdict_of(diagram: Diagram) -> Verdict:
    return verify(diagram, trials=1)


@pytest.mark.parametrize("missing", ["viscous", "coulomb"])
def test_friction_in_the_plant_that_is_not_in_the_regressor_is_refuted(missing: str) -> None:
    honest = diagram(friction="both")
    kept = tuple(kind for kind in ("viscous", "coulomb") if kind != missing)
    other = {**honest.blocks, "model": known_blocks()["regressor"](friction=kept)}
    verdict = verdict_of(Diagram.build(other, {}, honest.robot))
    assert verdict.outcome == "refuted"


def test_friction_in_the_regressor_that_is_not_in_the_plant_is_proved() -> None:
    honest = diagram(friction="none")
    other = {**honest.blocks, "model": known_blocks()["regressor"](friction=("viscous", "coulomb"))}
    assert verdict_of(Diagram.build(other, {}, honest.robot)).outcome == "proved"


@pytest.mark.parametrize("phi", MONOTONE)
def test_a_lemma_is_never_negative(phi: str) -> None:
    rng = np.random.default_rng(0)
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    lemma = Lemma(ca.SX([2, 0, 1]), a, b, ca.SX(0.1), phi)
    value = ca.Function("value", [a, b], [lemma.value])
    assert min(float(value(*rng.normal(size=(2, 3)))) for _ in range(200)) >= 0


def test_a_lemma_with_a_negative_weight_fails_its_condition() -> None:
    def negative(honest: Certificate, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        lemma = Lemma(-p.Gamma[:2] / p.Gamma[:2] * 3, u.sigma, -u.sigma, ca.SX(1))
        return Certificate(honest.storage, (lemma,), honest.supply + lemma.value)

    # the block's own claim is true; that of the diagram is not
    verdict = verdict_of(diagram(swapped=claiming("dynamic_compensator", negative)))
    assert verdict.outcome == "refuted"
    claim = claim_of(diagram(swapped=claiming("dynamic_compensator", negative)))
    checked, _ = conditions_of(claim, Numbers(claim, {}))
    (failing,) = (item for item in checked if not item.holds)
    assert failing.name.startswith("dynamics: weight of ")
    assert failing.name.endswith(" in the dissipation >= 0")
    assert failing.value == -3


def test_a_lemma_about_a_function_that_is_not_known_to_be_monotone_is_not_applicable() -> None:
    def wrong(honest: Certificate, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        lemma = Lemma(ca.SX(1), u.sigma, u.sigma, ca.SX(1), "sin")
        return Certificate(honest.storage, (lemma,), honest.supply)

    verdict = verdict_of(diagram(swapped=claiming("dynamic_compensator", wrong)))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason == "dynamics: a Lemma: sin is not known to be monotone; did you mean sign?"


@pytest.mark.parametrize(
    "stored",
    [
        lambda err, weight: (Square(2 * err, weight / 8),),
        lambda err, weight: (Square(err, weight / 2),),
    ],
    ids=["twice the error", "two squares"],
)
def test_a_projected_state_that_v_does_not_store_as_one_square_is_not_applicable(stored: Any) -> None:
    def stated(honest: Certificate, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        half = {"a_d_hat": TrueValue(truth.a_d, 0.5)}
        return Certificate(stored(x.a_d_hat - truth.a_d, 1 / p.Gamma), (), honest.supply, estimates=half)

    swapped = claiming("dynamic_compensator", stated)
    verdict = verdict_of(diagram(swapped=swapped, boxes=True))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason == (
        "dynamics: dynamics.a_d_hat is projected, but is not stored as one square of its error, which the "
        "projection lemma needs"
    )
    assert verdict_of(diagram(swapped=swapped, boxes=False)).outcome == "proved"


@pytest.mark.parametrize(
    "block", [FilteredDamping(beta=3, k=2), SaturatedDamping(beta=3, v=0.1)], ids=lambda block: type(block).__name__
)
def test_a_block_of_a_user_is_proved(block: AbstractBlock) -> None:
    found = diagram(extra={"damping": block})
    verdict = verify(found)
    assert verdict.outcome == "proved"
    assert verdict.claim is not None
    assert "damping" in {part.block for part in verdict.claim.parts if part.certificate.dissipation}
    assert true_in_numbers(found, verdict.claim)


def test_a_block_of_a_user_with_a_wrong_sign_is_refuted_with_its_name() -> None:
    class Wrong(FilteredDamping):  # type: ignore[misc]
        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            honest = super().certificate(u, x, p, truth)
            return Certificate(honest.storage, honest.dissipation, -honest.supply)

    verdict = verdict_of(diagram(extra={"damping": Wrong(beta=3, k=2)}))
    assert (verdict.outcome, verdict.reason) == (
        "refuted",
        "damping: dS/dt is not what the block claims, though dV/dt of the diagram is; to blame: damping",
    )


def test_a_claim_that_needs_a_property_which_the_field_lacks_is_neither_proved_nor_refuted() -> None:
    verdict = verdict_of(diagram(extra={"damping": OddDamping(beta=3, v=0.1)}))
    assert verdict.outcome == "not_applicable"
    expected = "not decided: dV/dt equals what the blocks claim at every real point that was tried"
    assert verdict.reason.startswith(expected)


def test_an_error_in_a_certificate_is_reported_with_its_line() -> None:
    def broken(honest: Certificate, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        raise ZeroDivisionError("no reason")

    verdict = verdict_of(diagram(swapped=claiming("dynamic_compensator", broken)))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("dynamics: certificate(), test_lemmas.py:")
    assert verdict.reason.endswith(": ZeroDivisionError: no reason")


FOREIGN = ca.SX.sym("foreign")
FORMS = {
    "expected storage[0] to be a Square, an InformationSquare, a Potential or a LogDet, found a Lemma": lambda c, u: (
        Certificate((Lemma(ca.SX(1), u.sigma, u.sigma, ca.SX(1)),), (), c.supply)
    ),
    "expected dissipation[0] to be a Square, a NormSquare, a Lemma or an InformationSquare": lambda c, u: Certificate(
        c.storage, (ca.dot(u.sigma, u.sigma),), c.supply
    ),
    "expected columns of one length": lambda c, u: Certificate(c.storage, (Square(u.sigma, ca.SX(3, 1)),), c.supply),
    "expected columns of one length, or a square matrix": lambda c, u: Certificate(
        (*c.storage, InformationSquare(u.sigma, ca.SX(1), ca.SX.eye(3), ca.SX.eye(2), ca.SX([1, 1]), ca.SX(1))),
        (),
        c.supply,
    ),
    "expected a scalar supply, found 2 x 1": lambda c, u: Certificate(c.storage, (), u.sigma),
    "dominates has 2 factors, expected one for each of 0": lambda c, u: Certificate(
        c.storage, (), c.supply, dominates=(ca.SX(1), ca.SX(1))
    ),
    "a cascade has consumes and cannot have dominates": lambda c, u: Certificate(
        c.storage, (Square(u.sigma, ca.SX(1)),), c.supply, consumes=Consumed(u.sigma, ca.SX(1)), dominates=(ca.SX(1),)
    ),
    "a certificate with dominates must dissipate squares": lambda c, u: Certificate(
        c.storage, (Lemma(ca.SX(1), u.sigma, u.sigma, ca.SX(1)),), c.supply, dominates=(ca.SX(1),)
    ),
    "a certificate contains foreign, which is neither a signal": lambda c, u: Certificate(
        c.storage, (Square(u.sigma, FOREIGN),), c.supply
    ),
    "states another dissipation when evaluated again": lambda c, u: Certificate(
        c.storage, (Square(u.sigma, ca.SX.sym("fresh")),), c.supply
    ),
    "supply and dominates: expected expressions of its u, x, p and truth, found an MX": lambda c, u: Certificate(
        c.storage, supply=ca.MX(0)
    ),
    "expected a Certificate, found dict": lambda c, u: {},
}


@pytest.mark.parametrize("text", FORMS)
def test_an_ill_formed_certificate_is_not_applicable_with_the_reason(text: str) -> None:
    made = claiming("dynamic_compensator", lambda c, u, x, p, truth: FORMS[text](c, u))
    verdict = verdict_of(diagram(swapped=made))
    assert verdict.outcome == "not_applicable"
    assert text in verdict.reason


def test_a_subclass_of_a_term_is_refused() -> None:
    """Its value could be any expression."""
    kind = type("Fake", (Square,), {"value": property(lambda self: -1)})
    with pytest.raises(
        TypeError,
        match=r"expected storage\[0\] to be a Square, an InformationSquare, a Potential or a LogDet, found a Fake",
    ):
        Certificate((kind(ca.SX.sym("x")),))
