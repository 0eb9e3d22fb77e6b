"""A verdict as plain data: what ``verify --json`` prints."""

from __future__ import annotations

import math
from typing import Any

from dmframe.certificate import Clipped, Gathered, Lemma, LogDet, NormSquare, Potential, Square
from dmframe.certify.claim import Claim
from dmframe.certify.verify import Verdict
from dmframe.exact.rational import as_float

KINDS = {
    Square: "square",
    NormSquare: "norm_square",
    Lemma: "lemma",
    Clipped: "clipped",
    Gathered: "gathered",
    Potential: "potential",
    LogDet: "log_det",
}
"""Of a term, as it is printed."""


def summary(name: str, verdict: Verdict) -> dict[str, Any]:
    """Plain data that JSON can hold; numbers that are not finite are None."""
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
        "bounded_by": [
            {
                "block": b.block,
                "of": b.of,
                "bound": _finite(b.value),
                "constant": b.constant,
                "times": b.times,
                "weight": b.weight,
            }
            for b in verdict.bounds
        ],
        "kappa": None
        if verdict.kappa is None
        else {"least": _finite(as_float(verdict.kappa.least)), "chosen": _finite(as_float(verdict.kappa.chosen))},
        "conditions": [
            {
                "name": condition.name,
                "expression": condition.expression,
                "value": _finite(condition.value),
                "holds": condition.holds,
                "how": condition.how,
                "source": condition.source,
            }
            for condition in verdict.conditions
        ],
        "assumptions": [{"text": item.text, "source": item.source} for item in verdict.assumptions],
        "statements": [
            {
                "signal": item.signal,
                "says": item.says,
                "step": item.step,
                "assumes": list(item.assumes),
                "concludes": item.concludes,
            }
            for item in verdict.statements
        ],
        "states": None
        if verdict.states is None
        else {
            "bounded": list(verdict.states.bounded),
            "unfelt": list(verdict.states.unfelt),
            "open": list(verdict.states.open),
        },
        "fixed": list(verdict.fixed),
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


def _terms(claim: Claim, role: str) -> list[dict[str, Any]]:
    """Each term: whose, of what, a square or a lemma, and its weight in V."""
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


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
