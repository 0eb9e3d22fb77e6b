"""Tables of the linear analysis: servo margins, poles and largest stable sampling period."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common.errors import DmframeError, listed
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.diagram.fingerprint import short

if TYPE_CHECKING:
    from dmframe.analysis import Bracket, EmulationLimit, JointLoop, Linear, LoopAnalysis, StabilityProof

LONGEST: Final = 20.0
"""Upper limit of the simulated time in the search for the largest stable sampling period [s]."""

EMULATION_HEADS: Final = (
    "gain",
    "of the graph",
    "at the set-point",
    "along the path's start",
    "w at the end of its box",
)
JOINT_HEADS: Final = ("joint", "inertia", "crossover", "phase margin", "gain margin", "servo alone", "with the inverse")


@final
@dataclass(frozen=True)
class LinearView:
    """Tables and figures of the analysis; without an analysis, `sentence` gives the reason.

    Parameters
    ----------
    joints
        One row a joint, columns `JOINT_HEADS`.
    loop, periods
        Rows (quantity, at rest, moving) and (search, result, meaning).
    emulation
        One row an adapting block, columns `EMULATION_HEADS`.
    bode, nyquist
        SVG, or empty.
    numbers
        Data that ``dmframe analyse --json`` prints.
    """

    sentence: str
    joints: tuple[tuple[str, ...], ...] = ()
    loop: tuple[tuple[str, str, str], ...] = ()
    periods: tuple[tuple[str, str, str], ...] = ()
    emulation: tuple[tuple[str, ...], ...] = ()
    bode: str = ""
    nyquist: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)


def linear_view(graph: BaseGraph, tell: Callable[[str], None] = lambda _: None) -> LinearView:
    """Linearise at the set-point at the start of the path; an analysis error becomes `sentence`."""
    from dmframe.analysis import analyse, bode_svg, nyquist_svg

    clock = graph.file.clock
    try:
        found = analyse(
            graph.diagram,
            clock,
            solver=graph.solver.automatic,
            start=graph.start,
            horizon=min(LONGEST, graph.file.duration),
            tell=tell,
        )
    except DmframeError as error:
        return LinearView(f"This loop has no linear analysis: {error.text}.")
    view = rows_of(graph.name, found)
    return replace(view, bode=bode_svg(found.joints), nyquist=nyquist_svg(found.joints))


def rows_of(name: str, found: LoopAnalysis) -> LinearView:
    """Tables without figures; `name` is the name of the graph."""
    from dmframe.analysis import summary

    return LinearView(
        sentence=(
            "Near the set-point at which the path begins, with every estimate at its true value, the loop was "
            "linearised. The result holds for small motions there; it is neither the theorem nor the simulated run."
        ),
        joints=tuple(_joint(joint) for joint in found.joints),
        loop=tuple(_loop(found)),
        periods=tuple(_periods(found)),
        emulation=tuple(map(_limit, found.emulation)),
        numbers=summary(name, found),
    )


def _limit(limit: EmulationLimit) -> tuple[str, ...]:
    def most(factor: float | None) -> str:
        if factor is None or math.isinf(factor):
            return ""
        return f"{factor:.3g} times" if limit.value is None else f"{factor * limit.value:.3g}"

    own = "" if limit.value is None else f"{limit.value:g}"
    return limit.gain, own, *map(most, (limit.at_rest, limit.on_path, limit.at_bound))


def _joint(joint: JointLoop) -> tuple[str, ...]:
    margins = joint.margins
    port = "" if joint.passive_port is None else _passive(joint.passive_port.holds)
    return (
        joint.joint,
        f"{joint.inertia:.4g} kg m²",
        f"{margins.gain_crossover:.4g} rad/s",
        f"{margins.phase:.1f} deg",
        "infinite" if math.isinf(margins.gain) else f"{margins.gain:.3g}",
        _passive(joint.passive_servo.holds),
        port,
    )


def _passive(holds: bool) -> str:
    return "passive" if holds else "not passive"


def _loop(found: LoopAnalysis) -> Iterator[tuple[str, str, str]]:
    both = (found.at_rest, found.moving)
    sampled = found.at_rest.clock is not None
    for name, place in () if sampled else (("slowest pole, 1/s", 0), ("fastest pole, 1/s", -1)):
        slow, fast = (_pole(linear, place) for linear in both)
        yield name, slow, fast
    resting = "eigenvalues at one" if sampled else "poles at zero"
    yield f"{resting}, free equilibrium coordinates", str(both[0].at_rest), str(both[1].at_rest)
    if both[0].ramp_modes or both[1].ramp_modes:
        yield (
            "Jordan blocks there: ramp modes without a restoring term",
            str(both[0].ramp_modes),
            str(both[1].ramp_modes),
        )
    if found.clock is not None:
        at_rest, moving = (f"{linear.spectral_radius(found.clock):.6f}" for linear in both)
        yield f"spectral radius of the loop sampled every {plain(found.clock, 's')}; stable below 1", at_rest, moving
        at_rest, moving = (
            "not proved" if proof.radius is None else f"{proof.radius:.8f}".rstrip("0") for proof in found.proofs
        )
        yield f"its upper bound, proved by interval arithmetic for {_model(found)}", at_rest, moving


def _pole(linear: Linear, place: int) -> str:
    pole = linear.pole(place)
    if pole is None:
        return "none"
    return f"{pole.real:.4g}" + (f" ± {abs(pole.imag):.4g} j" if pole.imag else "")


def _periods(found: LoopAnalysis) -> Iterator[tuple[str, str, str]]:
    periods = found.periods
    yield "linearised, at rest", _bracket(periods.at_rest), periods.at_rest.meaning
    yield "linearised, moving", _bracket(periods.moving), "the same without the slope of Coulomb friction at rest"
    for moving, (name, proof) in enumerate(zip(("proved, at rest", "proved, moving"), found.proofs, strict=True)):
        period = "none" if proof.period is None else plain(proof.period, "s", 4)
        yield name, period, _meaning(proof, found, bool(moving))
    yield "simulated", _bracket(periods.simulated), periods.simulated.meaning


def _model(found: LoopAnalysis) -> str:
    """Model hash that runs of the graph store."""
    return f"the model {short(found.field_hash)}"


def _meaning(proof: StabilityProof, found: LoopAnalysis, moving: bool) -> str:
    """Statement and assumptions of the proof."""
    if proof.period is None:
        return f"no stability proof: {proof.reason}" if proof.reason else "no stability proof"
    rests = f"; {proof.resting} more directions are exact equilibria" if proof.resting else ""
    if proof.kept:
        rests += f"; {proof.kept} sums of states are invariant and keep their values there"
    return (
        f"proved by interval arithmetic: an equilibrium lies within {proof.within:.1g} of the set-point, and the loop "
        f"linearised there (Euler controller, exact zero-order hold) converges from every state, in "
        f"{proof.directions} directions{rests}. The proof holds for {_model(found)} and for this period only. "
        f"Assumed: {_assumed(found, moving)}"
    )


def _assumed(found: LoopAnalysis, moving: bool) -> str:
    """Assumptions of the proof."""
    parts = ["trajectories and loads as at t = 0 s", "no random signals, no jitter"]
    but = f" except {listed(found.unknown)}" if found.unknown else ""
    parts.append(f"estimates at their true values{but}")
    if found.averaged:
        parts.append(f"{listed(list(found.averaged))} without rounding")
    if moving:
        parts.append("no slope of Coulomb friction at rest")
    return listed(parts)


def _bracket(bracket: Bracket) -> str:
    if bracket.stable == 0:
        return f"none; unstable at {plain(bracket.unstable, 's', 4)}"
    if math.isinf(bracket.unstable):
        return f"above {plain(bracket.stable, 's', 4)}, the longest tested"
    ends = dict.fromkeys((plain(bracket.stable, "s", 4), plain(bracket.unstable, "s", 4)))
    return " to ".join(ends)
