"""The conditions of a claim, each decided exactly at the graph's own numbers, or over its intervals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block.certificate import (
    SX,
    Assumption,
    CommonLyapunov,
    Condition,
    Dissipated,
    Inequality,
    InformationSquare,
    Lemma,
    LogDet,
    NormSquare,
    Potential,
    Square,
    Stored,
)
from dmframe.block.faults import fault_context
from dmframe.block.fields import fault_of
from dmframe.block.model import symbols_in
from dmframe.certify.assumed import SIGNS, assumed_weights, decidable, is_assumed
from dmframe.certify.checked import Checked, Finding, Numbers, sorted_out
from dmframe.certify.claim import Claim, NotApplicableError, Part
from dmframe.certify.definite import (
    body_pivots,
    is_mass_matrix,
    is_matrix,
    least_body_pivot,
    least_sampled,
    load_in,
    unphysical_links,
)
from dmframe.certify.memories import matrix_start, memory_starts, pivots_at_start
from dmframe.certify.projections import projection_conditions
from dmframe.certify.sampler import over_horizon
from dmframe.certify.small_gain import small_gain_conditions
from dmframe.certify.wording import worded
from dmframe.common.errors import BlockError
from dmframe.common.text import DISSIPATION, Formula, Label, Text, V, Written, sentence, square_of
from dmframe.diagram.view import view
from dmframe.exact.rational import as_float
from dmframe.formula.reading import place_of
from dmframe.prove.definite import Number, lower, pivots, upper
from dmframe.prove.stability import common_margin
from dmframe.robot.pseudo_inertia import pseudo_inertia

ROUNDING = 1e-9
"""Relative rounding error of the least eigenvalue of a load: that of a point mass is zero."""

MASS = Written("M(q)", "M(q)", "M(q)")
BODIES = Text(MASS, " > 0")
LYAPUNOV = Written("A'P + P A", "AᵀP + P A", r"A^\top P + P A")


def conditions_of(
    claim: Claim, numbers: Numbers, start: Mapping[str, Any] | None = None
) -> tuple[list[Checked], list[Assumption]]:
    """Conditions of a theorem in continuous time that numbers can decide, and the remaining assumptions.

    Raises `NotApplicableError` for a claim in discrete time, whose conditions are those of `dmframe.certify.discrete`.
    """
    if claim.over_samples:
        raise NotApplicableError(f"{claim.loop.discrete_time}; a proof in continuous time does not reach it")
    return sorted_out(_needed(claim, numbers, start or {}))


def _needed(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    yield from decide(conditions_stated(claim), numbers)
    yield from _weights(claim, numbers)
    yield from memory_starts(claim, numbers, start)
    yield from dict.fromkeys(_memories(claim))
    yield from assumed_weights(claim, numbers, start)
    yield from _inside(claim, numbers, start)
    yield from chain(*projection_conditions(claim, numbers, start))
    matrices = list(dict.fromkeys(_matrices(claim, numbers)))
    yield from matrices
    if any(item.how == "sampled" for item in matrices):
        found = " and ".join(unphysical_links(claim.diagram.robot))
        text = f" between the sampled poses, since what joint {found} moves is no physical body"
        yield Assumption(Text(BODIES, text), "property P2")
    yield from _loads(claim)
    if claim.cascaded:
        yield from small_gain_conditions(claim, numbers)


def decide(stated: Iterable[tuple[str, Condition]], numbers: Numbers) -> Iterator[Finding]:
    """Conditions, each with the block that states it: those that numbers decide, and those that are assumed."""
    for name, condition in stated:
        if isinstance(condition, Assumption):
            yield condition
        elif isinstance(condition, CommonLyapunov):
            yield _stable(name, condition, numbers)
        else:
            yield _inequality(name, condition, numbers)


def conditions_stated(claim: Claim) -> Iterator[tuple[str, Condition]]:
    """Conditions that blocks state. Raises `NotApplicableError` for a block that cannot state its conditions."""
    for name, block in claim.diagram.blocks.items():
        seen = view(claim.diagram, name, claim.truths)
        try:
            with fault_context(name, "conditions()"):
                stated = block.composed_conditions(seen.p, seen.truth)
        except BlockError as error:
            raise NotApplicableError(error.text) from None
        given = tuple(stated) if isinstance(stated, list) else stated
        fault = fault_of("what it returns", tuple[Condition, ...], given)
        if fault:
            raise NotApplicableError(f"{name}: conditions(), {place_of(type(block), 'conditions')}: {fault}")
        for condition in stated:
            texts = [value for value in vars(condition).values() if isinstance(value, str)]
            if unfit := next((text for text in texts if not text.isprintable()), ""):
                raise NotApplicableError(
                    f"{name}: conditions(), {place_of(type(block), 'conditions')}: expected texts of one line, "
                    f"found {unfit!r}"
                )
            yield name, condition


def _inequality(name: str, condition: Inequality, numbers: Numbers) -> Checked:
    words, text = worded(numbers.claim, name, condition)
    found = numbers.decide(Text(f"{name}: ", words), text, condition.source, condition.expression, condition.strict)
    if found.holds or not condition.otherwise:
        return found
    return replace(found, name=Text(f"{name}: ", condition.otherwise))


def remedies(claim: Claim, numbers: Numbers) -> list[Text]:
    """Remedies that blocks give for failing conditions of their identity, such as a missing friction column."""
    try:
        stated = [
            (name, item) for name, item in conditions_stated(claim) if isinstance(item, Inequality) and item.otherwise
        ]
    except NotApplicableError:
        return []
    return [item.name for item in sorted_out(decide(stated, numbers))[0] if not item.holds]


def _terms(claim: Claim) -> Iterator[tuple[Part, Formula | str, Stored | Dissipated]]:
    for part in claim.parts:
        yield from ((part, V, term) for term in part.certificate.storage)
        yield from ((part, DISSIPATION, term) for term in part.certificate.dissipation)


def _weights(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Weights: positive for each square of V and of the dissipation, nonnegative for every other term."""
    for part, role, term in _terms(claim):
        weight = term.weight
        if isinstance(term, Square) and is_assumed(term, numbers):
            weight = decidable(weight, numbers)
            if weight.is_empty():
                continue
        if isinstance(term, Lemma):
            if not weight.is_zero():
                yield _least(part, Text("weight of ", term.of, " in ", role), numbers, weight, strict=False)
                text = Text(f"width of {term.phi} in the term of ", term.of, " in ", role)
                yield _least(part, text, numbers, term.scale)
        elif isinstance(term, InformationSquare):
            square = Text(square_of(term.of, "G"), " in ", role)
            yield _least(part, Text("weight of ", square), numbers, weight, strict=False)
            gathered = sentence("weight of the rate of {G} for {square}", square=square)
            yield _least(part, gathered, numbers, term.by, strict=False)
        elif isinstance(term, LogDet):
            yield _least(part, Text("weight of the divergence of ", term.of, " in ", role), numbers, weight)
            text = Text("what ", term.of, " estimates is positive definite (least pivot)")
            yield numbers.decide(Text(f"{part.block}: ", text), text, SIGNS, term.true, matrix=True)
        elif isinstance(term, Potential):
            potential = Text(" of the potential of ", term.of, " in ", role)
            yield _least(part, Text("weight", potential), numbers, weight)
            yield _least(part, Text("width", potential), numbers, term.width)
        elif not is_matrix(claim, weight):
            strict = role is V  # positive in V, since V bounds the vector; zero in dV/dt only loses a conclusion
            yield _least(part, Text("weight of ", square_of(term.of), " in ", role), numbers, weight, strict=strict)


def _memories(claim: Claim) -> Iterator[Assumption]:
    for part, _, term in _terms(claim):
        if isinstance(term, InformationSquare):
            text = "{block}: {G} of {square} starts at zero, or positive semidefinite"
            yield Assumption(sentence(text, block=part.block, square=square_of(term.of, "G")), SIGNS)


def _inside(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    """Initial positive definiteness of the argument of a divergence, which is preserved if V does not increase."""
    rising = any(part.certificate.residual for part in claim.parts)
    for part, _, term in _terms(claim):
        if not isinstance(term, LogDet):
            continue
        first = matrix_start(claim, numbers, start, term.matrix)
        name = Text(f"{part.block}: ", term.of, " starts positive definite")
        if first is None:
            yield Assumption(name, SIGNS)
        else:
            least = min(pivots(first))
            begun = pivots_at_start(claim, numbers, start, term.matrix)
            margin, text = begun.at(numbers.starts), "least pivot at the start"
            yield Checked(name, text, as_float(least), least > 0, SIGNS, margin=margin, begun=begun)
        if rising:
            text = "{block}: {of} stays positive definite, although {V} may rise by a residual"
            yield Assumption(sentence(text, block=part.block, of=term.of), SIGNS)


def _least(part: Part, of: Text, numbers: Numbers, expression: SX, strict: bool = True) -> Checked:
    text = Text(of, " > 0" if strict else " >= 0")
    return numbers.decide(Text(f"{part.block}: ", text), text, SIGNS, expression, strict)


def _matrices(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Positive definiteness of every matrix weight: by its factors, or as the mass matrix of the robot."""
    for part, role, term in _terms(claim):
        if isinstance(term, Square) and is_assumed(term, numbers):
            continue
        if isinstance(term, Square | NormSquare) and is_matrix(claim, term.weight):
            weight = (term.weight + term.weight.T) / 2
            if not symbols_in(numbers.claim.loop.joined([weight])) <= numbers.known and is_mass_matrix(claim, weight):
                yield _mass_matrix(claim, weight)
                continue
            text = Text("weight of ", square_of(term.of), " in ", role, " > 0 (least pivot)")
            yield numbers.decide(Text(f"{part.block}: ", text), text, SIGNS, weight, matrix=True)
    for name, model in claim.diagram.models.items():
        for inverted in model.inverted if model.robot is not None else ():
            matrix = claim.loop.joined([claim.diagram.resolver.expand(name, ca.SX(inverted.matrix))])[0]
            if is_mass_matrix(claim, matrix):
                yield _mass_matrix(claim, matrix)


def load_labels(claim: Claim) -> list[str]:
    """Labels of loads contained in a mass matrix."""
    found = [
        load_in(claim, (term.weight + term.weight.T) / 2)
        for _, _, term in _terms(claim)
        if isinstance(term, Square | NormSquare) and is_matrix(claim, term.weight)
    ]
    return [label for label in dict.fromkeys(found) if label]


def _loads(claim: Claim) -> Iterator[Finding]:
    """Loads contained in a mass matrix: assumed to be rigid bodies at all times, checked at some."""
    for label in load_labels(claim):
        name = Text(Label(label), " is the inertia of a rigid body")
        yield Assumption(Text(name, ": its pseudo-inertia is not negative"), "property P2")
        time, least = _least_of_load(claim, label)
        if not least >= 0:
            found = f"least eigenvalue of its pseudo-inertia over the largest >= 0, at t = {time:.6g} s"
            yield Checked(name, found, least, False, "property P2", "sampled", strict=False)


def _least_of_load(claim: Claim, label: str) -> tuple[float, float]:
    """Time at which a load is furthest from a rigid body, and its least eigenvalue over the largest; 0 for rounding."""
    loop = claim.loop
    (leaf,) = (leaf for leaf in claim.diagram.resolver.trajectories.values() if leaf.name == label)
    times, values = over_horizon(loop, loop.on_path(leaf.symbol))
    rows = np.unique(np.column_stack([values.T, times]).round(12), axis=0)
    _, first = np.unique(rows[:, :-1], axis=0, return_index=True)  # most loads are constant most of the time
    found = list[tuple[float, float]]()
    for *body, time in rows[first]:
        values = np.linalg.eigvalsh(np.array(pseudo_inertia(body), dtype=float))
        share = values[0] / max(values[-1], -values[0], np.finfo(float).tiny)
        found.append((0.0 if abs(share) < ROUNDING else float(share), float(time)))
    least, time = min(found)
    return time, least


def _mass_matrix(claim: Claim, weight: SX) -> Checked:
    """M(q) > 0: exactly, if each link's inertia is that of some mass distribution; else at sampled poses."""
    least = least_body_pivot(claim.diagram.robot)
    if least > 0:
        text = "each link's pseudo-inertia is positive definite"
        return Checked(BODIES, text, as_float(least), True, "property P2", margin=body_pivots(claim.diagram))
    sampled = least_sampled(claim, weight)
    text = Text("least eigenvalue of ", MASS, " at 200 sampled poses > 0; not every link is a physical body")
    reads = Numbers(claim, {}).reads(weight)
    return Checked(BODIES, text, sampled, sampled > 0, "property P2", "sampled", reads=reads)


def _stable(name: str, condition: CommonLyapunov, numbers: Numbers) -> Checked:
    def least() -> Fraction:
        a, b = (_rows(numbers.of(box), box.shape[0]) for box in (condition.a, condition.b))
        return min(common_margin(corners, rates) for corners, rates in zip(a, b, strict=True))

    text = sentence("{sum} < 0 at the four corners of the box, one {P} > 0", sum=LYAPUNOV)
    found = numbers.decide(Text(f"{name}: ", condition.name), text, condition.source, ca.SX(), least=least)
    return replace(found, margin=None, reads=numbers.reads(ca.vertcat(ca.vec(condition.a), ca.vec(condition.b))))


def _rows(values: Sequence[Number], rows: int) -> list[tuple[Fraction, Fraction]]:
    return [(lower(values[row]), upper(values[rows + row])) for row in range(rows)]
