"""A verdict as plain data: the output of ``verify --json``."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

from dmframe.block.certificate import Clipped, InformationSquare, Lemma, LogDet, NormSquare, Potential, Square
from dmframe.certify.claim import Claim
from dmframe.certify.error_bound import ErrorBound
from dmframe.certify.verdict import Verdict
from dmframe.exact.rational import as_float

KINDS = {
    Square: "square",
    NormSquare: "norm_square",
    Lemma: "lemma",
    Clipped: "clipped",
    InformationSquare: "gathered",
    Potential: "potential",
    LogDet: "log_det",
}
"""Printed kind of each class of terms."""


def summary(name: str, verdict: Verdict) -> dict[str, Any]:
    """Plain data for JSON; numbers that are not finite are None."""
    test, claim, flow = verdict.test, verdict.claim, verdict.flow_claim
    return {
        "graph": name,
        "verdict": verdict.outcome,
        "reason": verdict.reason,
        "field_hash": None if claim is None else claim.diagram.fingerprint,
        "residual_zero": None if test is None else test.zero,
        "trials": 0 if test is None else test.trials,
        "primes": [] if test is None else [str(prime) for prime in test.primes],
        "seed": None if test is None else test.seed,
        "degree_bound": None if test is None else str(test.degree_bound),
        "log2_error_bound": None if test is None else _finite(test.log2_error_bound),
        "storage": [] if flow is None else _terms(flow, "storage"),
        "dissipation": [] if flow is None else _terms(flow, "dissipation"),
        "residual_bound": None if flow is None else _finite(verdict.residual_bound),
        "bounded_by": [_picked(b, "block of value:bound constant times weight") for b in verdict.bounds],
        "kappa": None if verdict.kappa is None else _picked(verdict.kappa, "least chosen"),
        "conditions": [_picked(item, "name expression value holds how source") for item in verdict.conditions],
        "assumptions": [_picked(item, "text source") for item in verdict.assumptions],
        "statements": [_picked(item, "signal says step assumes concludes") for item in verdict.statements],
        "states": None if verdict.states is None else _picked(verdict.states, "bounded unfelt open"),
        "fixed": list(verdict.fixed),
        "bounds": [] if verdict.errors is None else list(map(_error_bound, verdict.errors.found)),
        "bounds_missing": [] if verdict.errors is None else list(verdict.errors.missing),
        "notices": [],
        "mutants": {
            "tried": len(verdict.controls),
            "refuted": sum(control.refuted for control in verdict.controls),
            "faults": [control.fault for control in verdict.controls],
        },
        "refutation": None
        if verdict.refutation is None
        else {
            "blame": list(verdict.refutation.blame),
            "signals": list(verdict.refutation.signals),
            "prime": str(verdict.refutation.prime),
            "residue": str(verdict.refutation.residue),
            "point": {label: [str(x) for x in values] for label, values in verdict.refutation.point},
        },
        "time": {"build": verdict.build, "check": verdict.check},
    }


def _error_bound(bound: ErrorBound) -> dict[str, Any]:
    return {
        **_picked(bound, "signal kind over_s value unit disturbance"),
        "dominated_by": bound.dominated_by.of,
        "lowered_by": list(bound.dominated_by.lowered_by),
        "holds": bound.holds,
    }


def _terms(claim: Claim, role: str) -> list[dict[str, Any]]:
    """Each term: its block, its vector, its kind, and its weight in V."""
    return [
        {
            "block": part.block,
            "of": term.of,
            "kind": KINDS[type(term)],
            "weight": "kappa" if claim.cascaded and not part.cascade else "1",
        }
        for part in claim.parts
        for term in getattr(part.certificate, role)
    ]


def _picked(item: Any, names: str) -> dict[str, Any]:
    """These attributes as plain data; ``attribute:key`` renames one."""
    found = dict[str, Any]()
    for name in names.split():
        attribute, _, key = name.partition(":")
        value = getattr(item, attribute)
        value = as_float(value) if isinstance(value, Fraction) else list(value) if isinstance(value, tuple) else value
        found[key or attribute] = _finite(value) if isinstance(value, float) else value
    return found


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
