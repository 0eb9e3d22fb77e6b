"""The sampling intervals up to which a loop on its clock is proved, or the reason why there are none."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

from dmframe.analysis.held import held_slopes, other_steps
from dmframe.analysis.held_box import interval_over_box
from dmframe.analysis.held_linearised import linearised_interval
from dmframe.analysis.held_rise import Rise, rise_of
from dmframe.block.model import SYMBOLIC
from dmframe.certify import Verdict
from dmframe.certify.begun import START
from dmframe.certify.claim import Claim
from dmframe.certify.uncertain import FACTOR, tie_of
from dmframe.common.errors import DisagreementError, DmframeError
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval


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
    over
        With a proof: the uncertain parameters over whose intervals it holds; empty if for the graph's numbers.
    bounded
        With a proof: True if the plant is nonlinear, so that it holds for states up to `dmframe.analysis.held.FAR`.
    reason
        Without a proof: the reason.
    rise
        A state from which V of the certificate rises over every short interval, if one was found.
    linearised
        Without a proof of the loop: the interval of the loop linearised at its set-point, without the slope of Coulomb
        friction at rest [s]; None if that is not proved either.
    linearised_reason
        The reason why not.
    """

    clock: float | None
    interval: float | None = None
    states: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    over: tuple[str, ...] = ()
    bounded: bool = False
    reason: str = ""
    rise: Rise | None = None
    linearised: float | None = None
    linearised_reason: str = ""

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
            "over": list(self.over),
            "reason": self.reason,
            "linearised": self.linearised,
            "linearised_reason": self.linearised_reason,
            "rise": None
            if self.rise is None
            else {"rho": self.rise.rho, "because": self.rise.because, "state": dict(self.rise.state)},
        }


def prove_clock(
    diagram: Diagram,
    clock: float | None,
    claim: Claim | None = None,
    *,
    uncertain: Mapping[str, Sequence[Interval]] | None = None,
    kappa: float = 1.0,
    seed: int = 0,
    start: Mapping[str, Any] | None = None,
) -> ClockProof:
    """Prove a linear law on its clock; for another law, look for a state from which V of its certificate rises.

    Parameters
    ----------
    clock
        The graph's sampling period [s], or None.
    uncertain
        Intervals of the plant's parameters (`dmframe.certify.uncertain`), over which a linear loop is proved.
    claim
        Its proved claim in continuous time, if there is one.
    kappa
        Weight of the servo level in V.
    seed, start
        Of the search for a state, and of its runs.
    """
    own = {label: given for label, given in (uncertain or {}).items() if _is_varied(label, given)}
    try:
        slopes = held_slopes(diagram, own)
        interval = interval_over_box(slopes, own)
        return ClockProof(clock, interval, slopes.states, slopes.held, over=_stated(own), bounded=not slopes.linear)
    except DmframeError as fault:
        if any(other_steps(diagram.loop)):
            return ClockProof(clock, reason=fault.text)
        rise = rise_of(claim, kappa=kappa, seed=seed, start=start) if claim is not None else None
        found = ClockProof(clock, reason=fault.text, rise=rise)
    try:
        return replace(found, linearised=linearised_interval(diagram, clock, start=start))
    except DisagreementError:
        raise
    except DmframeError as fault:
        return replace(found, linearised_reason=fault.text)


def _is_varied(label: str, given: Sequence[Interval]) -> bool:
    """True for a parameter that is not zero; a start does not matter to a linear loop."""
    return not label.startswith(START) and any(x.lower or x.upper for x in given)


def _stated(uncertain: Collection[str]) -> tuple[str, ...]:
    """The labels as a graph states them: without products of a ratio, and a factor as its parameter."""
    products = {tie[0] for label in uncertain if (tie := tie_of(label)) is not None and tie[1]}
    return tuple(label for label in uncertain if label not in products and not label.endswith(FACTOR))


def clock_proof_of(graph: BaseGraph, verdict: Verdict, seed: int, tell: Callable[[str], None]) -> ClockProof:
    """`prove_clock` of a graph over its intervals, with the claim of its verdict if that is proved."""
    tell("looking for sampling intervals")
    with graph.placing(), SYMBOLIC:
        return prove_clock(
            graph.diagram,
            graph.clock,
            verdict.flow_claim if verdict.outcome == "proved" else None,
            uncertain=graph.intervals(),
            kappa=1.0 if verdict.kappa is None else float(verdict.kappa.chosen),
            seed=seed,
            start=graph.start,
        )


__all__ = ["ClockProof", "clock_proof_of", "prove_clock"]
