"""What a user should know of tuned values before using them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from dmframe.errors import listed
from dmframe.study.design import Spread
from dmframe.units import plain

if TYPE_CHECKING:
    from dmframe.study.tuned import Tuned

LONGER: Final = 5.0
"""By this factor the runs are longer that show whether the search's horizon misled it."""
CLOSE: Final = 0.02
"""Share of what was searched, from which on the best value may lie beyond its end."""
_NO_NOISE: Final = "the study's loops have no noise: high gains that it would punish are not punished here"


def notices(found: Tuned) -> list[str]:
    """In words, one a caution."""
    tuning, own, told = found.tuning, found.own, list[str]()
    first = tuning.objectives[0]
    study = tuning.study
    duration = study.points[0].graph.duration
    if not found.front:
        said = ["no trial keeps to all limits: widen what is searched, or loosen a limit"]
        return [*said, *([_NO_NOISE] if found.quiet else [])]
    best = found.front[0]
    if best.fresh and best.searched and best.fresh[0] > 1.1 * best.searched[0]:
        now, then = first.shown(best.fresh[0]), first.shown(best.searched[0])
        told.append(f"on fresh plants {first.text} is {now}, in the search {then}: more runs a trial would tell more")
    if best.longer:
        long, then = plain(LONGER * duration, "s"), first.shown(best.longer[0])
        if own is not None and own.longer and own.longer[0] < best.longer[0]:
            now = f"{first.text} is {then}" if math.isfinite(best.longer[0]) else "runs diverge"
            told.append(
                f"the horizon misleads: over {long} {now}, and with the graph's own values {first.text} is "
                f"{first.shown(own.longer[0])}; tune over longer runs, set: {{duration: {long}}}"
            )
    lost = [each.label for each in found.front if each.longer and not all(map(math.isfinite, each.longer))]
    if lost:
        told.append(
            f"{listed(lost)}: over {plain(LONGER * duration, 's')} runs diverge that did not over "
            f"{plain(duration, 's')}; tune over longer runs"
        )
    told += [f"{each.label}: {text}; tune over more plants" for each in found.front for text in each.broken]
    shaky = [each for each in found.front if each.unstable]
    if shaky:
        clock = plain(shaky[0].graph.clock or 0.0, "s")
        told.append(
            f"{listed([each.label for each in shaky])}: with the estimates at their true values the loop is unstable "
            f"near its set-point on its clock, linearised; add subject_to: stable period >= {clock}"
        )
    for name, value in best.values.items():
        spread = tuning.columns[name].spread
        end = None if spread is None else near_end(value, spread)
        if end is not None:
            at = with_unit(value, tuning.columns[name].unit)
            told.append(f"{name} = {at} lies at an end of what was searched, {end:g}; look beyond it")
    if best.proof is not None and not best.proof.proved:
        told.append(f"the best values are not proved: {best.proof.reason}")
    if found.quiet:
        told.append(_NO_NOISE)
    return told


def near_end(value: float, spread: Spread) -> float | None:
    """The end of what was searched that a value lies at, as far as a search of some hundred trials can tell."""
    low, high, at = spread.lower, spread.upper, value
    if spread.kind == "log":
        low, high, at = math.log(low), math.log(high), math.log(at)
    share = (at - low) / (high - low)
    return spread.lower if share <= CLOSE else spread.upper if share >= 1 - CLOSE else None


def with_unit(value: float, unit: str) -> str:
    """A number as it is told."""
    return f"{value:g} {unit}".rstrip()
