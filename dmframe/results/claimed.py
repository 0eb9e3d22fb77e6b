"""V of a run whose graph was not proved: only conditions that are cheap to decide are checked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from dmframe.block.model import SYMBOLIC
from dmframe.certify.checked import Checked, Numbers, sorted_out
from dmframe.certify.claim import Claim, NotApplicableError, claim_of
from dmframe.certify.conditions import conditions_of
from dmframe.certify.discrete import discrete_conditions
from dmframe.certify.hypotheses import undefined
from dmframe.certify.residual import bounds_of
from dmframe.certify.small_gain import small_gain
from dmframe.certify.smoothness import smoothness
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval, as_float
from dmframe.results.along import StorageTrace, along
from dmframe.simulate import Recording

MOST = 300
"""Largest number of states and of elements in a matrix gain; beyond, checking the conditions takes seconds."""


def unproved_along(
    run: Recording, uncertain: Mapping[str, Sequence[Interval]], start: Mapping[str, Any]
) -> StorageTrace | None:
    """`claimed_along`, or None if there is no V."""
    try:
        return claimed_along(run, uncertain, start)[1]
    except DmframeError:
        return None


def claimed_along(
    run: Recording, uncertain: Mapping[str, Sequence[Interval]], start: Mapping[str, Any]
) -> tuple[Claim, StorageTrace]:
    """Certificate of a run's blocks, and V along the run with the weight that a proof would choose.

    Assembling the certificate and deciding its conditions takes 0.3 s for a UR10, plus 20 us per instant; for the
    sampled law of a UR10 1.8 s, plus 0.2 ms per sample. The exact test is left to `verify`.

    Raises
    ------
    DmframeError
        The reason: `verify` would find nothing to prove, as far as the cheap conditions show; the run did not record
        every state; or the loop is too large.
    """
    with SYMBOLIC:
        claim, kappa = checked_claim(run.diagram, uncertain, start)
        return claim, along(claim, run, kappa)


def checked_claim(
    diagram: Diagram, uncertain: Mapping[str, Sequence[Interval]], start: Mapping[str, Any]
) -> tuple[Claim, float]:
    """The claim of a diagram and the weight of its servo level; see `claimed_along` for the errors."""
    with SYMBOLIC:
        if not diagram.loop.discrete_time and (size := _large(diagram)):
            raise NotApplicableError(
                f"V is not computed along the run of a loop of that size, {size} numbers in one column or gain; "
                f"expected at most {MOST}; use `verify --report`"
            )
        claim = claim_of(diagram, held=False)  # V is that of these numbers
        numbers = Numbers(claim, uncertain)
        kappa = small_gain(claim, numbers) if claim.cascaded else None
        for reason in _faults(claim, numbers, start):
            raise NotApplicableError(reason)
        return claim, as_float(kappa.chosen) if kappa else 1.0


def _large(diagram: Diagram) -> int:
    """Size of a state column or gain with more than `MOST` elements; 0 if there is none."""
    loop = diagram.loop
    matrices = (parameter.symbol for parameter in loop.parameters if not parameter.symbol.is_column())
    return next((symbol.numel() for symbol in (loop.state, *matrices) if symbol.numel() > MOST), 0)


def _faults(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[str]:
    """Failed numeric conditions, undefined expressions, and jumps of V."""
    if claim.over_samples:
        yield from _failing(sorted_out(discrete_conditions(claim, numbers, start))[0])
        return
    yield from _failing(conditions_of(claim, numbers, start)[0])
    yield from _failing(undefined(claim, numbers))
    yield from smoothness(claim.diagram, claim).faults
    for bound in bounds_of(claim, numbers, symbols_of(claim, numbers.uncertain)):
        if not bound.known:
            yield f"the residual is not bounded: {bound.block}: {bound.of}"


def _failing(conditions: Iterable[Checked]) -> Iterator[str]:
    return (f"a condition of the claim fails: {item.name}" for item in conditions if not item.holds)
