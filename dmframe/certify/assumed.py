"""Weights that are positive by assumption: what of them is decided all the same, and how the rest is told.

An assumption can be false, but not at once: at the graph's own start such a weight has to be above zero, and where no
start is known, at one of many sampled states.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Assumption, Square
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.definite import is_mass_matrix
from dmframe.certify.starts import start_expression, start_is_said
from dmframe.diagram.closed_loop import stack
from dmframe.linalg import ldl

SIGNS: Final = "V is positive, dV/dt not"
SAMPLES: Final = 200
"""States at which a weight is looked at whose start nobody knows."""


def is_assumed(term: Square, numbers: Numbers) -> bool:
    """True for a weight with an assumption that parameters, or the robot's bodies, do not make needless."""
    weight = numbers.claim.loop.joined([ca.SX(term.weight)])[0]
    if not term.positive or symbols_in([weight]) <= numbers.known:
        return False
    return weight.is_column() or not is_mass_matrix(numbers.claim, weight)


def decidable(weight: SX, numbers: Numbers) -> SX:
    """The elements of a weight, or of a matrix's diagonal, that are made of parameters alone: a column."""
    rows = ca.SX(weight) if weight.is_column() else ca.diag(weight)
    elements = ca.vertsplit(ca.densify(rows))
    known = [one for one in elements if symbols_in(numbers.claim.loop.joined([one])) <= numbers.known]
    return ca.vertcat(ca.SX(0, 1), *known)


def assumed_weights(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> tuple[list[Checked], list[Assumption]]:
    """The weights that an author calls positive: whether they can be, and what is assumed."""
    checked, assumed = list[Checked](), list[Assumption]()
    for part, role, place, term in _squares(claim):
        if is_assumed(term, numbers):
            text = f"the weight {_written(claim, part, role, place)} of |{term.of}|^2 in {role}"
            assumed.append(Assumption(f"{part.block}: {text} stays above a positive constant: {term.positive}", SIGNS))
            checked.append(_looked_at(f"{part.block}: {text}", term.weight, numbers, start))
    return checked, assumed


def _squares(claim: Claim) -> Iterator[tuple[Part, str, int, Square]]:
    """Each square of V and of the dissipation, with its place among the terms."""
    for part in claim.parts:
        for role, terms in (("V", part.certificate.storage), ("dV/dt", part.certificate.dissipation)):
            yield from ((part, role, place, term) for place, term in enumerate(terms) if isinstance(term, Square))


def _written(claim: Claim, part: Part, role: str, place: int) -> str:
    """How the weight of a term prints."""
    law = claim.laws[part.block]
    return (law.storage if role == "V" else law.dissipation)[place].weight.text


def _looked_at(name: str, weight: SX, numbers: Numbers, start: Mapping[str, Any]) -> Checked:
    """Above zero at the start; where that is not known, at one of many states at least."""
    loop = numbers.claim.loop
    begun = _at_start(weight, numbers, start)
    if begun is None:
        least, where = _most(weight, numbers), f"at one of {SAMPLES} sampled states"
    else:
        least, where = _least(ca.Function("weight", [loop.p], [begun])(loop.p_values)), "at the start"
    return Checked(f"{name} is above zero {where}", "least value > 0", least, least > 0, SIGNS, "sampled", margin=begun)


def _at_start(weight: SX, numbers: Numbers, given: Mapping[str, Any]) -> SX | None:
    """What has to be above zero at the start, in parameters; None where the start is not known."""
    loop = numbers.claim.loop
    (weight,) = loop.joined([weight])
    used, leaves, starts = symbols_in([weight]), list[SX](), list[SX]()
    for variable in loop.variables:
        if used & symbols_in([variable.symbol]):
            said = start_is_said(variable.label, numbers, given)
            begun = start_expression(variable.label, numbers, given) if said else None
            if begun is None:
                return None
            leaves.append(ca.vec(variable.symbol))
            starts.append(ca.densify(begun))
    (value,) = ca.substitute([_signs(weight)], leaves, starts)
    return value if symbols_in([value]) <= numbers.known else None


def _signs(weight: SX) -> SX:
    """The elements of a column, or the pivots of a matrix."""
    weight = ca.densify(weight)
    return weight if weight.is_column() else ca.vertcat(*ldl((weight + weight.T) / 2)[1])


def _most(weight: SX, numbers: Numbers) -> float:
    """The largest of the least values at sampled states, times and trajectories, at the graph's parameters."""
    loop, rng = numbers.claim.loop, np.random.default_rng(0)
    (signs,) = loop.joined([_signs(weight)])
    leaves = [leaf for leaf in ca.symvar(signs) if not symbols_in([leaf]) <= numbers.known]
    function = ca.Function("weight", [stack(leaves), loop.p], [signs])
    return max(_least(function(rng.uniform(-np.pi, np.pi, len(leaves)), loop.p_values)) for _ in range(SAMPLES))


def _least(value: ca.DM) -> float:
    """The least element; what is no number is not above zero."""
    numbers = value.full()
    return float(np.min(numbers)) if np.all(np.isfinite(numbers)) else -np.inf
