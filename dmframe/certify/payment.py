r"""Who pays for what a cascade consumes, and how much weight that gives the servo level.

A payer dissipates :math:`|v_1|^2_{W_1} + |v_2|^2_{W_2} + \dots` and composes what is consumed of it,
:math:`a = \sum_j a_j v_j`, element by element. By Cauchy's inequality, which is sharp here,

.. math:: c\,|a|^2 \le c\,\sum_j \frac{a_j^2}{W_j} \sum_j |v_j|^2_{W_j}

so a payer that V holds with the weight kappa pays if :math:`\kappa \ge c \sum_j a_j^2 / W_j`, with c the sum of all
that it pays for; one that V holds with the weight 1 pays if that number is below 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import final

import casadi as ca

from dmframe.certificate import SX
from dmframe.certify.checked import Checked, Numbers, upper
from dmframe.certify.claim import Claim, Part, total
from dmframe.errors import ValueFault
from dmframe.exact.rational import as_float

SOURCE = "composition of storage functions"
NEED = "c (a_1^2/d_1 + a_2^2/d_2 + ...)"
WHERE = "c |a_1 v_1 + a_2 v_2 + ...|^2 is consumed, and dV/dt spends d_1 |v_1|^2 + d_2 |v_2|^2 + ..."


@final
@dataclass(frozen=True)
class Kappa:
    """The weight of the servo level: above `least`, the servo level pays for the cascade; `chosen` is twice that."""

    least: Fraction
    chosen: Fraction


def payment(claim: Claim, numbers: Numbers) -> Kappa | None:
    """The weight with which every payer that has it pays; None where one cannot pay."""
    needs = [_need(payer, consumers, numbers) for payer, consumers in _payers(claim)]
    if any(payer is None for _, payer in claim.payments) or None in needs:
        return None
    scaled = [need for need, (payer, _) in zip(needs, _payers(claim), strict=True) if not payer.cascade]
    least = max((need for need in scaled if need is not None), default=Fraction(0))
    return Kappa(least, 2 * least if least > 0 else Fraction(1))


def payment_conditions(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """What the composition of a cascade with the servo level needs."""
    for consumer, payer in claim.payments:
        if payer is None:
            text = f"some block pays for what {consumer.block} consumes"
            yield Checked(text, "expected a block whose certificate says pays, found none", None, False, SOURCE)
    found = False
    for payer, consumers in _payers(claim):
        need = _need(payer, consumers, numbers)
        if payer.cascade:
            text = f"{payer.block} pays for the cascade with the weight 1 that V gives it"
            left = None if need is None else 1 - need
            value = None if left is None else as_float(left)
            wanted, weights = _composed(payer, consumers)
            margin = ca.vertcat(1 - wanted, weights)
            yield Checked(text, f"1 > {NEED}: {WHERE}", value, left is not None and left > 0, SOURCE, margin=margin)
        elif not found:
            found = True
            kappa = payment(claim, numbers)
            unpaid = [] if kappa else list(_unpaid(claim, numbers))
            text = "the servo level pays for the cascade, with any kappa above"
            if unpaid:
                text = f"the servo level pays for the cascade; it lacks a weight above zero of |{unpaid[0]}|^2 in dV/dt"
            value = as_float(kappa.least) if kappa else None
            weights = ca.vertcat(*(_composed(*pair)[1] for pair in _payers(claim)))
            yield Checked(text, f"kappa > {NEED}: {WHERE}", value, kappa is not None, SOURCE, margin=weights)


def kappa_needs(claim: Claim) -> SX:
    """Expressions in the claim's parameters of which `Kappa.least` is the largest; zero is one of them."""
    needs = [_composed(payer, consumers)[0] for payer, consumers in _payers(claim) if not payer.cascade]
    return ca.vertcat(ca.SX(0), *needs)


def _composed(payer: Part, consumers: list[Part]) -> tuple[SX, SX]:
    """The sum of c a_j^2 / W_j of each joint, and the weights W_j of what is consumed."""
    c = total([part.certificate.consumes.c for part in consumers if part.certificate.consumes is not None])
    need, weights = ca.SX.zeros(payer.composed.shape[0]), ca.SX(0, 1)
    for share, term in zip(payer.certificate.pays, payer.paying, strict=True):
        if not share.is_zero():
            need += c * share * share / term.weight
            weights = ca.vertcat(weights, term.weight)
    return need, weights


def _unpaid(claim: Claim, numbers: Numbers) -> Iterator[str]:
    """What is consumed and has no weight above zero in dV/dt at the graph's numbers."""
    for payer, _ in _payers(claim):
        for share, term in zip(payer.certificate.pays, payer.paying, strict=True):
            with suppress(ZeroDivisionError, ValueFault):
                if not share.is_zero() and numbers.least(term.weight) <= 0:
                    yield term.of


def _payers(claim: Claim) -> list[tuple[Part, list[Part]]]:
    """Each payer with all whom it pays for."""
    found = list[tuple[Part, list[Part]]]()
    for consumer, payer in claim.payments:
        if payer is None:
            continue
        paid = next((consumers for other, consumers in found if other is payer), None)
        if paid is None:
            found.append((payer, [consumer]))
        else:
            paid.append(consumer)
    return found


def _need(payer: Part, consumers: list[Part], numbers: Numbers) -> Fraction | None:
    """The largest c sum a_j^2 / W_j over the joints; None where a share has nothing to pay with."""
    need, weights = _composed(payer, consumers)
    try:
        if weights.numel() and numbers.least(weights) <= 0:
            return None
        return max(upper(value) for value in numbers.of(need))
    except (ZeroDivisionError, ValueFault):
        return None
