"""Exact certificates: V, dV/dt, conditions and assumptions of a diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from dmframe.certify.claim import Claim, NotApplicableError, claim_of
    from dmframe.certify.verdict import Verdict
    from dmframe.certify.verifier import verify

_HOMES: Final = {
    "Claim": "claim",
    "NotApplicableError": "claim",
    "Verdict": "verdict",
    "claim_of": "claim",
    "verify": "verifier",
}
"""Module of each name, imported when the name is first used: a run needs the claim without its proof."""

__all__ = ["Claim", "NotApplicableError", "Verdict", "claim_of", "verify"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
