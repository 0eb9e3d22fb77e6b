"""Terminal lines on a proof on a clock."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Final

from dmframe.common.units import plain, rounded_down

if TYPE_CHECKING:
    from dmframe.analysis.held_proof import ClockProof

WIDEST: Final = 116


def clock_text(proof: ClockProof) -> str:
    """The clock with the proved sampling intervals, or the reasons why there are none."""
    own = "no clock" if proof.clock is None else f"clock {plain(proof.clock, 's')}"
    if proof.interval is not None:
        limit = plain(rounded_down(proof.interval), "s")
        covered = "" if proof.covers_clock or proof.clock is None else ": the clock is slower"
        lines = [
            f"{own}: proved on a clock for all sampling intervals up to {limit}, equal or not{covered}",
            f"a storage function of {', '.join(proof.states)} falls between samples and at them; the difference of "
            "two motions on one path goes to zero in these states",
        ]
        if proof.bounded:
            from dmframe.analysis.held import FAR

            lines.append(f"for all angles, and other states up to {FAR:.0f} in their units")
        if proof.over:
            lines.append(f"for all robots in the intervals of {', '.join(proof.over)}")
    else:
        lines = [f"{own}: not proved on a clock: {proof.reason}"]
        if proof.rise is not None:
            size = f"{proof.rise.rho:.3g} T²/2 and terms in T³"
            lines.append(
                f"V rises over every short sampling interval T, from a robot at rest on a path at rest, by {size}; "
                f"largest share: the held {proof.rise.because} (state: --json)"
            )
        if proof.linearised is not None:
            limit = plain(rounded_down(proof.linearised), "s")
            lines.append(
                f"linearised at its set-point, a storage function falls for all intervals up to {limit}, equal or not; "
                "this is about the linearisation, without the slope of Coulomb friction at rest"
            )
        if proof.linearised_reason:
            lines.append(f"linearised at its set-point it has no such interval: {proof.linearised_reason}")
    first, *rest = lines
    return "\n".join([_wrap(first, "  "), *(_wrap(line, "    ") for line in rest)])


def _wrap(text: str, indent: str) -> str:
    return fill(text, WIDEST, initial_indent=indent, subsequent_indent=indent + "  ", break_long_words=False)
