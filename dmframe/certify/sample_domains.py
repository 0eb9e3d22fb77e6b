"""Where the map of a sample is defined: what it divides by, and arguments of roots and logarithms."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Assumption
from dmframe.certify.identity import at_random_point
from dmframe.certify.risky import risky
from dmframe.certify.samples import SampledClaim, SampledPart
from dmframe.certify.symbols import Symbols
from dmframe.diagram.closed_loop import stack
from dmframe.exact import Tape

SHOWN = 6
"""Signals of which so many are named."""


def domains(claim: SampledClaim, symbols: Symbols, seed: int) -> Iterator[Assumption]:
    """That what V and a block's memories hold is defined at the next sample: assumed where signals decide it.

    What steps divide by is positive, such as their norms, and so is the period; both are left out.
    """
    for part in claim.parts:
        asked = list(_asked(claim, part, symbols))
        norms = [size for item in part.steps for size in item.sizes]
        tape = Tape.from_function(symbols.function("domains", [stack(asked), stack(norms)]))
        values, known = at_random_point(tape, symbols, seed)
        left = stack(x for x, value in zip(asked, values, strict=True) if value not in known)
        moving = [g.label for g in symbols.groups if g.kind != "parameter" and ca.depends_on(left, g.symbol)]
        if moving:
            more = "" if len(moving) <= SHOWN else " and others"
            yield Assumption(
                f"{part.block}: what its samples divide by stays away from zero, and what they take roots or "
                f"logarithms of stays where these are defined, whatever {', '.join(moving[:SHOWN])}{more} do",
                "its equations need it",
            )


def _asked(claim: SampledClaim, part: SampledPart, symbols: Symbols) -> Iterator[SX]:
    """All that what V and the memories hold at the next sample needs, and that moves."""
    own = symbols_in([part.V])
    kept = {f"{part.block}.{item.state}" for item in part.kept}
    becomes = [claim.next[label] for label, x in claim.symbols.items() if label in kept or own & symbols_in([x])]
    still = symbols_in(group.symbol for group in symbols.groups if group.kind == "parameter")
    period = claim.base.loop.period.element_hash()
    for _, needed in risky(becomes):
        if needed.element_hash() != period and symbols_in([needed]) - still:
            yield needed
