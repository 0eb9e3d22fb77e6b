"""Warnings about tuned values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from dmframe.common.errors import listed
from dmframe.common.units import plain
from dmframe.study.design import Spread

if TYPE_CHECKING:
    from dmframe.study.tuned import Tuned

LONGER: Final = 5.0
"""Factor by which validation runs are longer than those of the search."""
CLOSE: Final = 0.02
"""Distance from a bound, as a fraction of the searched range, at which a better value may lie beyond it."""
_NO_NOISE: Final = "the study's loops have no noise, so that the objectives do not penalise high gains"


def notices(found: Tuned) -> list[str]:
    """Warnings, in words."""
    tuning, own, warnings = found.tuning, found.own, list[str]()
    first = tuning.objectives[0]
    study = tuning.study
    duration = study.points[0].graph.duration
    if not found.front:
        none = ["no trial meets all constraints: widen the searched bounds, or relax a constraint"]
        return [*none, *([_NO_NOISE] if found.quiet else [])]
    best = found.front[0]
    if best.fresh and best.searched and best.fresh[0] > 1.1 * best.searched[0]:
        now, then = first.shown(best.fresh[0]), first.shown(best.searched[0])
        warnings.append(f"{first.text} is {now} on fresh plants and {then} in the search: use more runs per trial")
    if best.longer:
        long, then = plain(LONGER * duration, "s"), first.shown(best.longer[0])
        if own is not None and own.longer and own.longer[0] < best.longer[0]:
            now = f"{first.text} is {then}" if math.isfinite(best.longer[0]) else "runs diverge"
            warnings.append(
                f"the runs are too short: over {long} {now}, and with the graph's own values {first.text} is "
                f"{first.shown(own.longer[0])}; tune over longer runs, set: {{duration: {long}}}"
            )
    lost = [each.label for each in found.front if each.longer and not all(map(math.isfinite, each.longer))]
    if lost:
        warnings.append(
            f"{listed(lost)}: runs of {plain(LONGER * duration, 's')} diverge that did not diverge "
            f"within {plain(duration, 's')}; tune over longer runs"
        )
    warnings += [f"{each.label}: {text}; tune over more plants" for each in found.front for text in each.broken]
    unstable = [each for each in found.front if each.unstable]
    if unstable:
        clock = plain(unstable[0].graph.clock or 0.0, "s")
        warnings.append(
            f"{listed([each.label for each in unstable])}: with the estimates at their true values the linearised loop "
            f"is unstable near its set-point on its clock; add subject_to: stable period >= {clock}"
        )
    for name, value in best.values.items():
        spread = tuning.columns[name].spread
        end = None if spread is None else near_end(value, spread)
        if end is not None:
            at = with_unit(value, tuning.columns[name].unit)
            warnings.append(f"{name} = {at} is at a bound of the search, {end:g}; widen the bounds")
    if best.proof is not None and not best.proof.proved:
        warnings.append(f"the best values are not proved: {best.proof.reason}")
    if found.quiet:
        warnings.append(_NO_NOISE)
    return warnings


def near_end(value: float, spread: Spread) -> float | None:
    """The bound that a value is at, within the resolution of some hundred trials; None if it is at none."""
    low, high, at = spread.lower, spread.upper, value
    if spread.kind == "log":
        low, high, at = math.log(low), math.log(high), math.log(at)
    fraction = (at - low) / (high - low)
    return spread.lower if fraction <= CLOSE else spread.upper if fraction >= 1 - CLOSE else None


def with_unit(value: float, unit: str) -> str:
    """A number with its unit."""
    return f"{value:g} {unit}".rstrip()
