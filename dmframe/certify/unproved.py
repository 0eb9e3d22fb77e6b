"""V of a run whose graph nobody has asked to prove: what the blocks claim, held to what is decided at little cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dmframe.block.model import SYMBOLIC
from dmframe.certify.along import Along, along
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, claim_of
from dmframe.certify.conditions import conditions_of
from dmframe.certify.excess import bounds_of
from dmframe.certify.hypotheses import undefined
from dmframe.certify.payment import payment
from dmframe.certify.smoothness import smoothness
from dmframe.certify.symbols import symbols_of
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError
from dmframe.exact.rational import Interval, as_float
from dmframe.simulate import Recording

INSTANTS = 400
"""Of a run at which V is evaluated: more than a figure can show."""

MOST = 300
"""States of the loop, and numbers in a gain that is a matrix: of more, deciding the conditions takes seconds."""


def unproved_along(
    run: Recording, uncertain: Mapping[str, Sequence[Interval]], start: Mapping[str, Any]
) -> Along | None:
    """V and its terms at some of a run's instants, with the weight that a proof would choose.

    None where `verify` would find nothing to prove, as far as is seen without the exact test of dV/dt; where the run
    did not keep every state; and where the loop is so large that it would hold up the run.
    """
    kept = np.unique(np.linspace(0, run.time.size - 1, INSTANTS).astype(int))
    states = {label: rows[kept] for label, rows in run.states.items()}
    try:
        with SYMBOLIC:
            if _large(run.diagram):
                return None
            claim = claim_of(run.diagram, near=True)
            numbers = Numbers(claim, uncertain)
            kappa = payment(claim, numbers) if claim.cascaded else None
            if not _sound(claim, numbers, start):
                return None
            return along(
                claim, replace(run, time=run.time[kept], states=states), as_float(kappa.chosen) if kappa else 1.0
            )
    except DmframeError:
        return None


def _large(diagram: Diagram) -> bool:
    loop = diagram.loop
    matrices = (parameter.symbol for parameter in loop.parameters if not parameter.symbol.is_column())
    return any(symbol.numel() > MOST for symbol in (loop.state, *matrices))


def _sound(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> bool:
    """Every condition holds that numbers decide, and what V holds does not jump."""
    return (
        all(condition.holds for condition in conditions_of(claim, numbers, start)[0])
        and not any(undefined(claim, numbers))
        and not smoothness(claim.diagram, claim).faults
        and all(bound.known for bound in bounds_of(claim, numbers, symbols_of(claim, numbers.uncertain)))
    )
