r"""What the projection lemma needs of a projected estimate, decided at the graph's numbers.

The lemma: with :math:`S = \tfrac12 |\theta - \theta_{true}|_W^2` a projection's correction c adds
:math:`(\theta - \theta_{true})^\top W c \le 0`. It holds if

1. the true value lies in the set, and does not move;
2. the estimate starts in the set;
3. c is normal to the set in the metric W;
4. c has that sign in every branch of its law, and with it no rate leads out of the set.

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
from dmframe.certify.begun import Begun
from dmframe.certify.checked import Checked, Finding, Numbers, sorted_out
from dmframe.certify.claim import Claim
from dmframe.certify.projection_laws import check_law
from dmframe.certify.sampler import over_horizon
from dmframe.certify.starts import ZERO, begun_at, start_expression, start_of
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
"""What rounding may take of the room that a source leaves."""
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
    """Everything that the projection lemma needs, for each projected state; and what is left to assume.

    A true value that the plant's start decides, such as the torque of a servo's integrator, is left to assume; that it
    does not move is not. `start` holds a graph's start values, by the state's name or ``block.state``, which go before
    what the blocks say.
    """
    return sorted_out(_needed(claim, numbers, start or {}))


def _needed(claim: Claim, numbers: Numbers, start: Mapping[str, Any]) -> Iterator[Finding]:
    for projection in claim.loop.projections:
        estimate = _estimated(claim, projection)
        if estimate is not None:
            truth = estimate.value + ca.SX.zeros(projection.state.shape[0])
            yield from _inside(projection, truth, numbers)
            yield from _still(projection.name, truth, numbers)
            askew = projection.set.askew(estimate.weight)
            if not askew.is_zero():
                yield _normal(projection.name, askew, numbers)
        yield from _starts(projection, numbers, start)
        yield check_law(projection, claim.loop)


def _estimated(claim: Claim, projection: Projection) -> TrueValue | None:
    """What the projected state estimates; None where V does not hold it."""
    found = (part.certificate.estimates for part in claim.parts if part.block == projection.block)
    return next(found, {}).get(projection.of)


def _inside(projection: Projection, truth: SX, numbers: Numbers) -> Iterator[Finding]:
    """That the true value lies in the set, decided or assumed."""
    text = Text(Label(projection.name), f": true value inside the {projection.kind}")
    room = projection.set.room(truth)
    known, rest = _decidable(room, numbers)
    if known.numel():
        shown = INSIDE[projection.kind].format("true value")
        yield numbers.decide(text, shown, SOURCE, known, strict=False)
    loop, handed = numbers.claim.loop, _handed(room, rest, numbers)
    for rows, says in (([row for row in rest if row not in handed], "where the plant starts"), (handed, "a source")):
        if rows:
            at = sorted({row % truth.shape[0] for row in rows})
            yield Assumption(Text(text, f"{_at(projection, at)}: {says} decides it"), SOURCE)
    if handed:
        yield from outside(text, ca.vertcat(*handed.values()), loop)


def _handed(room: SX, rows: Sequence[int], numbers: Numbers) -> dict[int, SX]:
    """The rows that a source decides, as functions of time and parameters."""
    loop = numbers.claim.loop
    known = symbols_in([loop.time, loop.p])
    return {row: path for row in rows if symbols_in([path := loop.on_path(room[row])]) <= known}


def rooms_on_path(claim: Claim, numbers: Numbers) -> Iterator[tuple[Text, SX]]:
    """Of each projection whose true value a source gives: its name, and the room as a function of time."""
    for projection in claim.loop.projections:
        estimate = _estimated(claim, projection)
        if estimate is not None:
            room = projection.set.room(estimate.value + ca.SX.zeros(projection.state.shape[0]))
            handed = _handed(room, _decidable(room, numbers)[1], numbers)
            if handed:
                text = Text(Label(projection.name), f": true value inside the {projection.kind}")
                yield text, ca.vertcat(*handed.values())


def outside(text: Text, room: SX, loop: ClosedLoop) -> Iterator[Checked]:
    """A condition that fails where a source's output, such as a load, is outside the set or NaN."""
    times, values = over_horizon(loop, room)
    found = np.min(values, axis=0)
    least = int(np.argmin(found))
    if not found[least] >= -ROUNDING:
        where = Text(text, f" at t = {times[least]:.6g} s")
        yield Checked(where, "as a source has it then", float(found[least]), False, SOURCE, "sampled", strict=False)


def _decidable(room: SX, numbers: Numbers) -> tuple[SX, list[int]]:
    """The rows that depend on parameters alone, and the positions of the others."""
    known = [row for row in range(room.shape[0]) if symbols_in([room[row]]) <= numbers.known]
    return room[known], [row for row in range(room.shape[0]) if row not in known]


def _at(projection: Projection, rows: Sequence[int]) -> str:
    if projection.kind != "box":
        return ""
    return f", in {'elements' if len(rows) > 1 else 'element'} {', '.join(map(str, rows))} (counted from 0)"


def _still(name: str, truth: SX, numbers: Numbers) -> Iterator[Checked]:
    """A true value that is more than a number does not move along the closed loop, whatever the trajectories do."""
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
    """That the estimate starts in the set, decided or assumed. A run that does not is refused."""
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
            margin = None  # where it starts depends on more than parameters, though its number does not
        least = partial(_least_room, projection, numbers, start)
        found = numbers.decide(text, shown, SOURCE, ca.SX(), strict=False, least=least)
        yield replace(found, margin=margin, begun=begun_in(projection, numbers, given))
    if unknown:
        yield Assumption(Text(text, f"{_at(projection, unknown)}: where the plant starts decides it"), SOURCE)


def begun_in(projection: Projection, numbers: Numbers, given: Mapping[str, Any]) -> Begun:
    """The room that the start of a projected state leaves."""
    return begun_at(_room_at(projection, projection.state), numbers, given, (projection.name,), zero=True)


def _room_at(projection: Projection, start: SX) -> SX:
    """The room of a start, which a run puts onto the rim where it misses that by rounding; of a box by elements."""
    room = ca.substitute(projection.set.room(projection.state), projection.state, start)
    sizes = 1 + ca.fabs(start)
    own = ca.vertcat(sizes, sizes) if projection.kind == "box" else ca.mmax(sizes)
    return room + ROUNDING * own


def _least_room(projection: Projection, numbers: Numbers, start: Sequence[Number | None]) -> Fraction:
    """The least room that a start leaves, over its known elements; zero where a run puts it on the rim."""
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
        return least  # where the rim is at the graph's own numbers decides nothing over intervals
    known = np.array([value is not None for value in start])
    at = np.array([0.0 if value is None else float(lower(value)) for value in start])
    put = np.ravel(held(*(p.value.ravel(order="F") for p in parameters), at).full())
    on_the_rim = (np.abs(at - put) <= ROUNDING * (1 + np.abs(at)))[known].all()
    return ZERO if on_the_rim else least
