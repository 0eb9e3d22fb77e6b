"""Largest stable sampling periods near the set-point, for a live page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.analysis import linearise, linearised_period
from dmframe.analysis.set_point import LARGE
from dmframe.certify import Verdict
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram

SET_POINT: Final = "set-point"
"""Place that faults of the search for an equilibrium name."""
NO_POINT: Final = "the loop has no equilibrium for which its stability could be computed"


@final
@dataclass(frozen=True)
class Periods:
    """Largest stable sampling periods of the loop linearised at its set-point, as in `analyse`.

    Parameters
    ----------
    at_rest, moving
        [s]; infinite if every tested period is stable, None if unknown.
    reason
        Reason if unknown.
    """

    at_rest: float | None = None
    moving: float | None = None
    reason: str = ""

    @property
    def data(self) -> dict[str, Any]:
        """Plain data for JSON; ``Infinity`` as a string."""
        return {"rest": _shown(self.at_rest), "moving": _shown(self.moving), "reason": self.reason}


def stable_periods(
    diagram: Diagram,
    clock: float | None,
    verdict: Verdict,
    start: Mapping[str, Any] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Periods | None:
    """Periods of a sampled graph with a continuous-time proof; None for other graphs.

    Takes two to five seconds for a UR10, mostly for two linearisations; loops of more than `LARGE` states, which would
    take minutes, are skipped.
    """
    if clock is None or verdict.samples is not None:
        return None
    if (size := diagram.loop.state.numel()) > LARGE:
        return Periods(reason=f"the loop has {size} states, and more than {LARGE} take minutes")
    try:
        tell("linearising")
        at_rest = linearise(diagram, start=start, clock=clock)
        moving = linearise(diagram, at_rest.point, moving=True, clock=clock)
        tell("searching the largest stable sampling period")
        return Periods(linearised_period(at_rest).stable, linearised_period(moving).stable)
    except DmframeError as error:
        return Periods(
            reason=NO_POINT if error.text.startswith(f"{SET_POINT}: expected an equilibrium") else error.text
        )


def _shown(period: float | None) -> float | str | None:
    return period if period is None or np.isfinite(period) else "Infinity"
