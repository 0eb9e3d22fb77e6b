"""Names for the terms of a claim, printed from the expressions themselves; an author's own are not read."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Certificate, NormSquare
from dmframe.formula.law import PrintedLaw, PrintedTerm

TOLERANCE = 1e-9


def labelled(stated: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> dict[str, Certificate]:
    """Certificates whose terms bear their names; a name that two blocks give to different things carries its block."""
    double = _double(stated, laws)
    return {name: _named(name, certificate, laws[name], double) for name, certificate in stated.items()}


def _named(name: str, certificate: Certificate, law: PrintedLaw, double: set[str]) -> Certificate:
    def full(text: str) -> str:
        return f"{text} ({name})" if text in double else text

    def told(terms: Sequence[Any], printed: Sequence[PrintedTerm]) -> tuple[Any, ...]:
        return tuple(_with(term, line, full) for term, line in zip(terms, printed, strict=True))

    driven = tuple(
        replace(item, of=tuple(full(formula.text) for formula in formulas))
        for item, formulas in zip(certificate.driven, law.driven, strict=True)
    )
    return replace(
        certificate,
        storage=told(certificate.storage, law.storage),
        dissipation=told(certificate.dissipation, law.dissipation),
        excess=told(certificate.excess, law.excess),
        driven=driven,
    )


def _with(term: Any, line: PrintedTerm, full: Any) -> Any:
    named = replace(term, of=full(line.vector.text))
    return replace(named, by_of=line.by.text) if isinstance(term, NormSquare) and line.by is not None else named


def _double(stated: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> set[str]:
    """Names under which blocks write different vectors."""
    found = defaultdict[str, list[SX]](list)
    for name, certificate in stated.items():
        law = laws[name]
        for role in ("storage", "dissipation", "excess"):
            for term, line in zip(getattr(certificate, role), getattr(law, role), strict=True):
                if hasattr(term, "vector"):
                    found[line.vector.text].append(term.vector)
        for item, formulas in zip(certificate.driven, law.driven, strict=True):
            for vector, formula in zip(item.bounded, formulas, strict=True):
                found[formula.text].append(vector)
    return {text for text, vectors in found.items() if any(_differ(vectors[0], other) for other in vectors[1:])}


def _differ(one: SX, other: SX) -> bool:
    """Are they different, in shape or at a random point?"""
    if one.shape != other.shape:
        return True
    if ca.is_equal(one, other):
        return False
    symbols = ca.vertcat(*ca.symvar(ca.vertcat(one, other)))
    point = np.random.default_rng(0).uniform(0.5, 1.5, symbols.numel())
    values = ca.Function("difference", [symbols], [one - other])(point).full()
    return bool(np.any(np.abs(values) > TOLERANCE * (1 + np.abs(values))))
