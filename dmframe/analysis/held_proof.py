"""The sampling intervals up to which a loop on its clock is proved, or the reason why there are none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from dmframe.analysis.held import held_loop, other_steps
from dmframe.analysis.held_rise import Rise, rise_of
from dmframe.analysis.held_storage import find_storage
from dmframe.certify.claim import Claim
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram


@final
@dataclass(frozen=True)
class ClockProof:
    """Result of `prove_clock`.

    Parameters
    ----------
    clock
        Sampling period of the graph [s]; None in continuous time.
    interval
        For all sampling intervals up to this [s], equal or not, a storage function falls between samples and at them;
        None without a proof.
    states, held
        With a proof: the states of the storage function, and the signals that are held.
    reason
        Without a proof: the reason.
    rise
        A state from which V of the certificate rises over every short interval, if one was found.
    """

    clock: float | None
    interval: float | None = None
    states: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    reason: str = ""
    rise: Rise | None = None

    @property
    def covers_clock(self) -> bool:
        """True if the sampling period is at most the proved interval."""
        return self.clock is not None and self.interval is not None and self.clock <= self.interval

    @property
    def summary(self) -> dict[str, Any]:
        """The key ``sampling`` of ``dmframe verify --clock --json``."""
        return {
            "clock": self.clock,
            "interval": self.interval,
            "covers_clock": self.covers_clock,
            "states": list(self.states),
            "held": list(self.held),
            "reason": self.reason,
            "rise": None
            if self.rise is None
            else {"rho": self.rise.rho, "because": self.rise.because, "state": dict(self.rise.state)},
        }


def prove_clock(
    diagram: Diagram,
    clock: float | None,
    claim: Claim | None = None,
    *,
    kappa: float = 1.0,
    seed: int = 0,
    start: Mapping[str, Any] | None = None,
) -> ClockProof:
    """Prove a linear loop on its clock; for another loop, look for a state from which V of its certificate rises.

    Parameters
    ----------
    clock
        The graph's sampling period [s], or None.
    claim
        Its proved claim in continuous time, if there is one.
    kappa
        Weight of the servo level in V.
    seed, start
        Of the search for a state, and of its runs.
    """
    try:
        loop = held_loop(diagram)
        return ClockProof(clock, find_storage(loop).interval, loop.states, loop.held)
    except DmframeError as fault:
        emulated = not any(other_steps(diagram.loop))
        rise = rise_of(claim, kappa=kappa, seed=seed, start=start) if claim is not None and emulated else None
        return ClockProof(clock, reason=fault.text, rise=rise)


__all__ = ["ClockProof", "prove_clock"]
