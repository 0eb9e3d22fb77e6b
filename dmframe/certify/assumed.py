"""Weights that are assumed positive: the decidable part, and the text of the assumption.

An assumption must not be false at the start: such a weight must be positive at the graph's initial state or, if that is
unknown, at one of many sampled states.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Assumption, Square
from dmframe.block.linalg import ldl
from dmframe.block.model import symbols_in
from dmframe.certify.begun import Begun
from dmframe.certify.checked import Checked, Finding, Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.definite import is_mass_matrix
from dmframe.certify.starts import margin_from_start
from dmframe.common.errors import ValueFault
from dmframe.common.text import DISSIPATION, Formula, Text, V, sentence, square_of
from dmframe.diagram.closed_loop import stack
from dmframe.exact.balls import UndecidedError
from dmframe.exact.rational import as_float
from dmframe.prove.definite import lower, upper

SIGNS: Final = sentence("{V} is positive, {dV/dt} not")
SAMPLES: Final = 200
"""Number of sampled states at which a weight with an unknown initial value is evaluated."""


def is_assumed(term: Square, numbers: Numbers) -> bool:
    """True for a weight with an assumption that does not follow from parameters or from the robot's inertias."""
    weight = numbers.claim.loop.joined([ca.SX(term.weight)])[0]
    if not term.positive or symbols_in([weight]) <= numbers.known:
        return False
    return weight.is_column() or not is_mass_matrix(numbers.claim, weight)


def decidable(weight: SX, numbers: Numbers) -> SX:
    """Elements of a weight, or of a matrix's diagonal, that consist of parameters only: a column."""
    rows = ca.SX(weight) if weight.is_column() else ca.diag(weight)
    elements = ca.vertsplit(ca.densify(rows))
    known = [one for one in elements if symbols_in(numbers.claim.loop.joined([one])) <= numbers.known]
    return ca.vertcat(ca.SX(0, 1), *known)


def assumed_weights(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    """Weights that an author declares positive: whether they can be, and the assumption."""
    for part, role, place, term in _squares(claim):
        if is_assumed(term, numbers):
            text = _named(claim, part, role, place, term)
            yield Assumption(Text(text, f" stays above a positive constant: {term.positive}"), SIGNS)
            yield _evaluated(text, term.weight, numbers, start)


@final
@dataclass(frozen=True)
class Assumed:
    """A quantity that is assumed to stay above a positive constant: each element of a column."""

    text: Text
    column: SX


def assumed_positive(claim: Claim, numbers: Numbers) -> list[Assumed]:
    """Weights declared positive that parameters do not decide; of a matrix, its pivots."""
    found = list[Assumed]()
    for part, role, place, term in _squares(claim):
        if is_assumed(term, numbers):
            (column,) = claim.loop.joined([_signs(ca.SX(term.weight))])
            found.append(Assumed(_named(claim, part, role, place, term), ca.densify(column)))
    return found


def _squares(claim: Claim) -> Iterator[tuple[Part, Formula | str, int, Square]]:
    """Each square of V and of the dissipation, with its position among the terms."""
    for part in claim.parts:
        for role, terms in ((V, part.certificate.storage), (DISSIPATION, part.certificate.dissipation)):
            yield from ((part, role, place, term) for place, term in enumerate(terms) if isinstance(term, Square))


def _named(claim: Claim, part: Part, role: Formula | str, place: int, term: Square) -> Text:
    law = claim.laws[part.block]
    weight = (law.storage if role is V else law.dissipation)[place].weight
    text = "{block}: the weight {weight} of {square} in {role}"
    return sentence(text, block=part.block, weight=weight, square=square_of(term.of), role=role)


def _evaluated(name: Text, weight: SX, numbers: Numbers, start: Mapping[str, Any]) -> Checked:
    """Positive at the start or, if that is unknown, at one of many states at least."""
    begun = _begun(weight, numbers, start)
    margin = begun.at(numbers.starts)
    known = margin is not None
    where = "at the start" if known else f"at one of {SAMPLES} sampled states"
    least, margin = _most(weight, numbers) if margin is None else (_least_of(margin, numbers), margin)
    name, text = Text(name, f" is above zero {where}"), "least value > 0"
    found = Checked(name, text, least, least > 0, SIGNS, "sampled", margin=margin, begun=begun, sufficient=not known)
    if not symbols_in([margin]) & numbers.open:
        return found
    return _over(found, margin, numbers)


def decided_at_start(name: Text, column: SX, numbers: Numbers, start: Mapping[str, Any]) -> Checked | None:
    """The condition that no element is below zero at the initial state; None if that state is not known."""
    (column,) = numbers.claim.loop.joined([ca.densify(column)])
    begun = margin_from_start(column, numbers, start)
    margin = begun.at(numbers.starts)
    if margin is None:
        return None
    return _over(Checked(name, "least value >= 0", None, False, SIGNS, "", False, margin, begun=begun), margin, numbers)


def _over(found: Checked, margin: SX, numbers: Numbers) -> Checked:
    """The same condition over the intervals on which its margin depends."""
    try:
        least = as_float(min(map(lower, numbers.enclosed(margin))))
    except (ValueFault, UndecidedError, OverflowError):
        text = f"{found.expression}; not decided over the intervals"
        return replace(found, holds=False, value=None, how="undecided", expression=text)
    return replace(found, holds=least > 0 if found.strict else least >= 0, value=least, how="exact")


def _least_of(margin: SX, numbers: Numbers) -> float:
    """Least value at the graph's own numbers; initial values in intervals are taken at their centre."""
    loop = numbers.claim.loop
    columns = [loop.p, *(numbers.claim.starts[label] for label in numbers.starts)]
    middle = ([as_float(lower(x) + upper(x)) / 2 for x in given] for given in numbers.starts.values())
    return _least(ca.Function("weight", columns, [margin])(loop.p_values, *middle))


def _begun(weight: SX, numbers: Numbers, given: Mapping[str, Any]) -> Begun:
    """The quantity that must be positive at the start."""
    (weight,) = numbers.claim.loop.joined([weight])
    return margin_from_start(_signs(weight), numbers, given)


def _signs(weight: SX) -> SX:
    """Elements of a column, or pivots of a matrix."""
    weight = ca.densify(weight)
    return weight if weight.is_column() else ca.vertcat(*ldl((weight + weight.T) / 2)[1])


def _most(weight: SX, numbers: Numbers) -> tuple[float, SX]:
    """The largest of the least values at sampled states, times and trajectories, and the least element there."""
    loop, rng = numbers.claim.loop, np.random.default_rng(0)
    (signs,) = loop.joined([_signs(weight)])
    leaves = [leaf for leaf in ca.symvar(signs) if not symbols_in([leaf]) <= numbers.known]
    function = ca.Function("weight", [stack(leaves), loop.p], [signs])
    points = [rng.uniform(-np.pi, np.pi, len(leaves)) for _ in range(SAMPLES)]
    values = [_least(function(point, loop.p_values)) for point in points]
    best = int(np.argmax(values))
    (there,) = ca.substitute([signs], [stack(leaves)], [ca.SX(ca.DM(points[best]))]) if leaves else [signs]
    return values[best], there


def _least(value: ca.DM) -> float:
    """Least element; minus infinity if one is NaN or infinite."""
    numbers = value.full()
    return float(np.min(numbers)) if np.all(np.isfinite(numbers)) else -np.inf
