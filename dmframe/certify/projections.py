r"""Conditions of the projection lemma for a projected estimate, decided at the graph's numbers.

The lemma: with :math:`S = \tfrac12 |\theta - \theta_{true}|_W^2` a projection's correction c adds
:math:`(\theta - \theta_{true})^\top W c \le 0`. It holds if

1. the true value is in the set and constant;
2. the estimate starts in the set;
3. c is normal to the set in the metric W;
4. c has that sign in every branch of its law, and with it no rate points out of the set.

The first three are decided in rational numbers, the fourth in `dmframe.certify.projection_laws`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Assumption, TrueValue
from dmframe.block.model import symbols_in
from dmframe.certify.assumed import decided_at_start
from dmframe.certify.begun import Begun
from dmframe.certify.checked import Checked, Finding, Numbers, sorted_out
from dmframe.certify.claim import Claim
from dmframe.certify.projection_laws import check_law
from dmframe.certify.sampler import over_horizon
from dmframe.certify.starts import ZERO, margin_from_start, start_expression, start_of
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import ValueFault
from dmframe.common.text import Label, Text, sentence
from dmframe.diagram.closed_loop import ClosedLoop, stack
from dmframe.diagram.projection import Projection
from dmframe.exact import ZeroDivision
from dmframe.exact.rational import Interval, evaluate
from dmframe.prove.definite import Number, lower
from dmframe.simulate.start import ROUNDING

ROUNDED = ROUNDING
"""Allowed rounding error of a true value from a source."""
LEMMA = "projection lemma"
SOURCE = "Remark 2"
INSIDE = {
    "box": "lower <= {} <= upper",
    "ball": "1 - |({} - centre) / radius|^2 >= 0",
    "set of bodies": "no eigenvalue of P0^-1 P({}) - share is below zero, P0 the nominal pseudo-inertia of each link",
}


def projection_conditions(
    claim: Claim, numbers: Numbers, start: Mapping[str, Any] | None = None
) -> tuple[list[Checked], list[Assumption]]:
    """All conditions of the projection lemma, for each projected state, and the remaining assumptions.

    If the plant's initial state determines a true value, such as the torque of a servo's integrator, its membership in
    the set is assumed; that it is constant is checked. `start` contains a graph's initial values, by the state's name
    or ``block.state``; they have precedence over those of the blocks.
    """
    return sorted_out(_needed(claim, numbers, start or {}))


def _needed(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    for projection in claim.loop.projections:
        estimate = _estimated(claim, projection)
        if estimate is not None:
            truth = estimate.value + ca.SX.zeros(projection.state.shape[0])
            yield from _inside(projection, truth, numbers, start)
            yield from _still(projection.name, truth, numbers)
            askew = projection.set.askew(estimate.weight)
            if not askew.is_zero():
                yield _normal(projection.name, askew, numbers)
        yield from _starts(projection, numbers, start)
        yield check_law(projection, claim.loop)


def _estimated(claim: Claim, projection: Projection) -> TrueValue | None:
    """True value of the projected state; None if V does not contain the state."""
    found = (part.certificate.estimates for part in claim.parts if part.block == projection.block)
    return next(found, {}).get(projection.of)


def _inside(projection: Projection, truth: SX, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    """The true value is in the set: decided, or assumed and true at the graph's own start."""
    text = Text(Label(projection.name), f": true value inside the {projection.kind}")
    room = projection.set.room(truth)
    known, rest = _decidable(room, numbers)
    if known.numel():
        shown = INSIDE[projection.kind].format("true value")
        yield numbers.decide(text, shown, SOURCE, known, strict=False)
    loop, handed = numbers.claim.loop, _handed(room, rest, numbers)
    for rows, origin in (([row for row in rest if row not in handed], "where the plant starts"), (handed, "a source")):
        if rows:
            at = sorted({row % truth.shape[0] for row in rows})
            yield Assumption(Text(text, f"{_at(projection, at)}: {origin} decides it"), SOURCE)
    own = [row for row in rest if row not in handed]
    found = decided_at_start(Text(text, " at the start"), room[own], numbers, start) if own else None
    if found is not None:
        yield found
    if handed:
        yield from outside(text, ca.vertcat(*handed.values()), loop)


def _handed(room: SX, rows: Sequence[int], numbers: Numbers) -> dict[int, SX]:
    """Rows that a source determines, as functions of time and parameters."""
    loop = numbers.claim.loop
    known = symbols_in([loop.time, loop.p])
    return {row: path for row in rows if symbols_in([path := loop.on_path(room[row])]) <= known}


def rooms_on_path(claim: Claim, numbers: Numbers) -> Iterator[tuple[Text, SX]]:
    """Each projection whose true value a source determines: its name, and the distance to the boundary over time."""
    for projection in claim.loop.projections:
        estimate = _estimated(claim, projection)
        if estimate is not None:
            room = projection.set.room(estimate.value + ca.SX.zeros(projection.state.shape[0]))
            handed = _handed(room, _decidable(room, numbers)[1], numbers)
            if handed:
                text = Text(Label(projection.name), f": true value inside the {projection.kind}")
                yield text, ca.vertcat(*handed.values())


def outside(text: Text, room: SX, loop: ClosedLoop) -> Iterator[Checked]:
    """A failing condition if a source's output, such as a load, is outside the set or NaN."""
    times, values = over_horizon(loop, room)
    found = np.min(values, axis=0)
    least = int(np.argmin(found))
    if not found[least] >= -ROUNDING:
        where = Text(text, f" at t = {times[least]:.6g} s")
        yield Checked(where, "for the values of a source", float(found[least]), False, SOURCE, "sampled", strict=False)


def _decidable(room: SX, numbers: Numbers) -> tuple[SX, list[int]]:
    """Rows that depend on parameters only, and the indices of the others."""
    known = [row for row in range(room.shape[0]) if symbols_in([room[row]]) <= numbers.known]
    return room[known], [row for row in range(room.shape[0]) if row not in known]


def _at(projection: Projection, rows: Sequence[int]) -> str:
    if projection.kind != "box":
        return ""
    return f", in {'elements' if len(rows) > 1 else 'element'} {', '.join(map(str, rows))} (counted from 0)"


def _still(name: str, truth: SX, numbers: Numbers) -> Iterator[Checked]:
    """Condition that a true value that is not numeric is constant along the closed loop, for all trajectories."""
    claim = numbers.claim
    (truth,) = claim.loop.joined([truth])
    if symbols_in([truth]) <= numbers.known:
        return
    rate = claim.flow.D(truth, f"{name}: the true value")
    name_of_check = Text(Label(name), ": true value stands still")
    text = "d(true value)/dt is identically zero along the closed loop"
    uncertain = [label for label, values in numbers.values.items() if any(isinstance(v, Interval) for v in values)]
    symbols = symbols_of(claim, uncertain)
    try:
        still = symbols.vanishes("rate", rate)
    except (ValueFault, ZeroDivision) as error:
        yield Checked(name_of_check, f"{text}; undecided: {error}", None, False, LEMMA, "undecided")
        return
    yield Checked(name_of_check, text, None, still, LEMMA, margin=ca.SX(0, 1))


def _normal(name: str, askew: SX, numbers: Numbers) -> Checked:
    text = sentence("weight in {V} times adaptation gain is one number for all elements")
    name_of_check = sentence("{name}: projected in the metric of {V}", name=Label(name))
    return numbers.decide(name_of_check, text, LEMMA, ca.vertcat(askew, -askew), strict=False)


def _starts(projection: Projection, numbers: Numbers, given: Mapping[str, Any]) -> Iterator[Finding]:
    """The estimate starts in the set, decided or assumed; a run that does not is rejected."""
    text = Text(Label(projection.name), f": starts inside the {projection.kind}")
    shown = INSIDE[projection.kind].format("start")
    start = start_of(projection.name, numbers, given)
    room = projection.set.room(projection.state)
    moving = [row for row in range(len(start)) if ca.depends_on(room, projection.state[row])]
    known = [row for row in moving if start[row] is not None]
    unknown = [row for row in moving if start[row] is None]
    if known and (projection.kind == "box" or not unknown):
        begin = start_expression(projection.name, numbers, given)
        margin = None if begin is None else _decidable(_room_at(projection, begin), numbers)[0]
        rows = {row % len(start) for row in known} if projection.kind == "box" else {0}
        if margin is not None and margin.numel() < len(rows):
            margin = None  # the initial value depends on more than parameters, although its number does not
        least = partial(_least_room, projection, numbers, start)
        found = numbers.decide(text, shown, SOURCE, ca.SX(), strict=False, least=least)
        yield replace(found, margin=margin, begun=margin_at_start(projection, numbers, given))
    if unknown:
        yield Assumption(Text(text, f"{_at(projection, unknown)}: where the plant starts decides it"), SOURCE)


def margin_at_start(projection: Projection, numbers: Numbers, given: Mapping[str, Any]) -> Begun:
    """Margin of the initial value of a projected state inside its set."""
    return margin_from_start(_room_at(projection, projection.state), numbers, given, (projection.name,), zero=True)


def _room_at(projection: Projection, start: SX) -> SX:
    """Margin of an initial value; a run projects values outside by rounding errors. For a box, by elements."""
    room = ca.substitute(projection.set.room(projection.state), projection.state, start)
    sizes = 1 + ca.fabs(start)
    own = ca.vertcat(sizes, sizes) if projection.kind == "box" else ca.mmax(sizes)
    return room + ROUNDING * own


def _least_room(projection: Projection, numbers: Numbers, start: Sequence[Number | None]) -> Fraction:
    """Least margin of an initial value, over its known elements; zero if a run projects it onto the boundary."""
    n = projection.state.numel()
    parameters = numbers.claim.loop.parameters
    inputs = [*(stack([p.symbol]) for p in parameters), projection.state]
    sets = [projection.set.room(projection.state), projection.set.held(projection.state)]
    room, held = (ca.Function("at_start", inputs, [ca.densify(item)]) for item in sets)
    values = [numbers.values[p.label] for p in parameters]
    found = evaluate(room, [*values, [ZERO if value is None else value for value in start]])[0]
    box = projection.kind == "box"
    least = min(lower(value) for row, value in enumerate(found) if not box or start[row % n] is not None)
    if least >= 0 or any(isinstance(value, Interval) for value in (*found, *start)):
        return least  # the boundary at the graph's own numbers decides nothing over intervals
    known = np.array([value is not None for value in start])
    at = np.array([0.0 if value is None else float(lower(value)) for value in start])
    put = np.ravel(held(*(p.value.ravel(order="F") for p in parameters), at).full())
    on_the_rim = (np.abs(at - put) <= ROUNDING * (1 + np.abs(at)))[known].all()
    return ZERO if on_the_rim else least
