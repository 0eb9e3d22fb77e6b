"""What the terms of a claim are called: as the code prints that states them, and never alike where they differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Certificate, NormSquare
from dmframe.errors import BlockError
from dmframe.formula.law import PrintedLaw, PrintedTerm

ROLES = ("storage", "dissipation", "excess")


def labelled(certificates: Mapping[str, Certificate], laws: Mapping[str, PrintedLaw]) -> dict[str, Certificate]:
    """Certificates whose terms bear the names under which they print.

    Two vectors that print alike in two blocks and are not the same are told apart by their blocks' names: else what is
    proved of the one would be said of the other.
    """
    told = {name: _told(name, certificate, laws[name]) for name, certificate in certificates.items()}
    alike = dict[str, list[tuple[str, SX]]]()
    for name, certificate in told.items():
        for text, vector in _vectors(certificate):
            alike.setdefault(text, []).append((name, vector))
    apart = {text for text, places in alike.items() if not _one(places)}
    if not apart:
        return told

    def qualified(name: str, text: str) -> str:
        return f"{name}: {text}" if text in apart else text

    return {name: _renamed(certificate, lambda text, n=name: qualified(n, text)) for name, certificate in told.items()}


def _told(name: str, certificate: Certificate, law: PrintedLaw) -> Certificate:
    """The certificate with the printed names of its terms."""

    def terms(role: str) -> tuple[Any, ...]:
        stated, printed = getattr(certificate, role), getattr(law, role)
        if len(stated) != len(printed):
            raise BlockError(f"{name}: certificate() states {len(stated)} terms of its {role}, then {len(printed)}")
        return tuple(_called(*pair) for pair in zip(stated, printed, strict=True))

    driven = tuple(
        replace(item, of=tuple(formula.text for formula in formulas))
        for item, formulas in zip(certificate.driven, law.driven, strict=True)
    )
    changed: dict[str, Any] = {role: terms(role) for role in ROLES}
    return replace(certificate, driven=driven, **changed)


def _called(term: Any, printed: PrintedTerm) -> Any:
    if isinstance(term, NormSquare) and printed.by is not None:
        return replace(term, of=printed.vector.text, by_of=printed.by.text)
    return replace(term, of=printed.vector.text)


def _vectors(certificate: Certificate) -> Iterator[tuple[str, SX]]:
    """What each name of a certificate stands for."""
    for role in ROLES:
        for term in getattr(certificate, role):
            if hasattr(term, "vector"):
                yield term.of, term.vector
    for item in certificate.driven:
        yield from zip(item.of, item.bounded, strict=True)


def _one(places: Sequence[tuple[str, SX]]) -> bool:
    """Is it the same vector in all places?"""
    vectors = [ca.SX(vector) for _, vector in places]
    first, others = vectors[0], [item for item in vectors[1:] if not ca.is_equal(item, vectors[0])]
    if any(item.shape != first.shape for item in others):
        return False
    if not others:
        return True
    symbols = ca.vertcat(*ca.symvar(ca.vertcat(first, *others)))
    point = np.random.default_rng(0).uniform(0.5, 1.5, symbols.numel())
    values = ca.Function("values", [symbols], [ca.horzcat(first, *others)])(point).full()
    return bool(np.allclose(values, values[:, :1], rtol=1e-9, atol=1e-9))


def _renamed(certificate: Certificate, rename: Any) -> Certificate:
    def terms(role: str) -> tuple[Any, ...]:
        return tuple(replace(term, of=rename(term.of)) for term in getattr(certificate, role))

    driven = tuple(replace(item, of=tuple(map(rename, item.of))) for item in certificate.driven)
    changed: dict[str, Any] = {role: terms(role) for role in ROLES}
    return replace(certificate, driven=driven, **changed)
