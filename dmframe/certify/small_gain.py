r"""Small-gain condition for a cascade: chooses the weight kappa of the servo level so that it dominates the cross term.

The cross term of the cascade is :math:`c\,|a|^2`. The block that dominates it dissipates
:math:`|v_1|^2_{W_1} + |v_2|^2_{W_2} + \dots`, and :math:`a = \sum_j a_j v_j`, element by element. By Cauchy's
inequality, which is sharp here,

.. math:: c\,|a|^2 \le c\,\sum_j \frac{a_j^2}{W_j} \sum_j |v_j|^2_{W_j}

so a block with the weight kappa in V dominates if :math:`\kappa \ge c \sum_j a_j^2 / W_j`, with c the sum over all
cascades on it; a block with the weight 1 does if that number is below 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim, Part, total
from dmframe.common.errors import ValueFault
from dmframe.common.text import Text, Written, sentence, square_of
from dmframe.exact.rational import as_float
from dmframe.prove.definite import upper

SOURCE = "composition of storage functions"
NEED = sentence(
    "{need}: the cross term is {cross}, and {dV/dt} dissipates {spent}",
    need=Written(
        "c (a_1^2/d_1 + a_2^2/d_2 + ...)",
        "c (a_1²/d_1 + a_2²/d_2 + …)",
        r"c\, (a_1^2/d_1 + a_2^2/d_2 + \ldots)",
    ),
    cross=Written("c |a_1 v_1 + a_2 v_2 + ...|^2", "c |a_1 v_1 + a_2 v_2 + …|²", r"c\, |a_1 v_1 + a_2 v_2 + \ldots|^2"),
    spent=Written(
        "d_1 |v_1|^2 + d_2 |v_2|^2 + ...", "d_1 |v_1|² + d_2 |v_2|² + …", r"d_1 |v_1|^2 + d_2 |v_2|^2 + \ldots"
    ),
)


@final
@dataclass(frozen=True)
class Kappa:
    """Weight of the servo level: the small-gain condition is met above `least`; `chosen` is twice that."""

    least: Fraction
    chosen: Fraction


def small_gain(claim: Claim, numbers: Numbers) -> Kappa | None:
    """Weight for which every dominating block satisfies its condition; None if one cannot."""
    needs = [_need(block, consumers, numbers) for block, consumers in _dominating(claim)]
    if any(block is None for _, block in claim.cross_terms) or None in needs:
        return None
    scaled = [need for need, (block, _) in zip(needs, _dominating(claim), strict=True) if not block.cascade]
    least = max((need for need in scaled if need is not None), default=Fraction(0))
    return Kappa(least, 2 * least if least > 0 else Fraction(1))


def small_gain_conditions(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """The small-gain conditions of all cascades."""
    for consumer, block in claim.cross_terms:
        if block is None:
            text = Text(f"some block dominates the cross term of {consumer.block}")
            yield Checked(text, "expected a certificate with dominates, found none", None, False, SOURCE)
    found = False
    for block, consumers in _dominating(claim):
        need = _need(block, consumers, numbers)
        if block.cascade:
            text = sentence("{block} dominates the cascade's cross term with its weight 1 in {V}", block=block.block)
            left = None if need is None else 1 - need
            value = None if left is None else as_float(left)
            wanted, weights = _composed(block, consumers)
            margin = ca.vertcat(1 - wanted, weights)
            yield Checked(text, Text("1 > ", NEED), value, left is not None and left > 0, SOURCE, margin=margin)
        elif not found:
            found = True
            kappa = small_gain(claim, numbers)
            missing = [] if kappa else list(_missing(claim, numbers))
            text = sentence("the servo level dominates the cascade's cross term for {kappa} above")
            if missing:
                lacks = "; missing is a weight above zero of {a} in the dissipation"
                text = sentence("the servo level dominates the cascade's cross term" + lacks, a=square_of(missing[0]))
            value = as_float(kappa.least) if kappa else None
            weights = ca.vertcat(*(_composed(*pair)[1] for pair in _dominating(claim)))
            expression = sentence("{kappa} > {need}", need=NEED)
            yield Checked(text, expression, value, kappa is not None, SOURCE, margin=weights)


def kappa_needs(claim: Claim) -> SX:
    """Expressions in the claim's parameters whose maximum is `Kappa.least`; zero is one of them."""
    needs = [_composed(block, consumers)[0] for block, consumers in _dominating(claim) if not block.cascade]
    return ca.vertcat(ca.SX(0), *needs)


def _composed(block: Part, consumers: list[Part]) -> tuple[SX, SX]:
    """The sum of c a_j^2 / W_j of each joint, and the weights W_j of the dominating squares."""
    c = total([part.certificate.consumes.c for part in consumers if part.certificate.consumes is not None])
    need, weights = ca.SX.zeros(block.composed.shape[0]), ca.SX(0, 1)
    for share, term in zip(block.certificate.dominates, block.dominating, strict=True):
        if not share.is_zero():
            need += c * share * share / term.weight
            weights = ca.vertcat(weights, term.weight)
    return need, weights


def _missing(claim: Claim, numbers: Numbers) -> Iterator[Text]:
    """Parts of the cross term without a positive weight in dV/dt at the graph's numbers."""
    for block, _ in _dominating(claim):
        for share, term in zip(block.certificate.dominates, block.dominating, strict=True):
            with suppress(ZeroDivisionError, ValueFault):
                if not share.is_zero() and numbers.least(term.weight) <= 0:
                    yield term.of


def _dominating(claim: Claim) -> list[tuple[Part, list[Part]]]:
    """Each dominating block with the cascades on it."""
    found = dict[str, tuple[Part, list[Part]]]()
    for consumer, block in claim.cross_terms:
        if block is not None:
            found.setdefault(block.block, (block, []))[1].append(consumer)
    return list(found.values())


def _need(block: Part, consumers: list[Part], numbers: Numbers) -> Fraction | None:
    """The largest c sum a_j^2 / W_j over the joints; None if a weight W_j is not positive."""
    need, weights = _composed(block, consumers)
    try:
        if weights.numel() and numbers.least(weights) <= 0:
            return None
        return max(upper(value) for value in numbers.of(need))
    except (ZeroDivisionError, ValueFault):
        return None
