"""Exact certificates: V, dV/dt, conditions and assumptions of a diagram."""

from dmframe.certify.claim import Claim, NotApplicableError, claim_of
from dmframe.certify.verdict import Verdict
from dmframe.certify.verify import verify

__all__ = ["Claim", "NotApplicableError", "Verdict", "claim_of", "verify"]
