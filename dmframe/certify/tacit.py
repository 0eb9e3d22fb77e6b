"""Checks of `verify` without a line of their own: as margins, or as the list of what each outcome depends on.

That nothing divides by zero, that a clipped term has a width, that a projection's set has an inside, that an equation
is stable for which its block would otherwise require more, that a path does not jump, that a load is a body, that what
is zero in the graph is zero, that a path of the tool is within its reach, that what is assumed to stay above zero does
not converge to it. None of it is computed by `verify` of a single graph: it is for intervals and for numbers that move.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Assumption, Clipped, InformationSquare, LogDet, StableLinear
from dmframe.block.linalg import ldl, square
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.closure import Bases, Closure
from dmframe.certify.conditions import load_labels
from dmframe.certify.contradicted import kept_above
from dmframe.certify.divisors import domains
from dmframe.certify.linear import stability_margin
from dmframe.certify.memories import gathered_from_start, pivots_at_start, reads_of
from dmframe.certify.partial_functions import domains_of, instructions
from dmframe.certify.positive import Signs
from dmframe.certify.projections import ROUNDED, begun_in, rooms_on_path
from dmframe.certify.reach import kept_within
from dmframe.certify.sampler import over_horizon
from dmframe.certify.smoothness import followed_by_numbers
from dmframe.certify.statements import bases_of
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import ValueFault
from dmframe.common.text import Label, Text, joined, name_of, sentence
from dmframe.diagram.closed_loop import Parameter, stack
from dmframe.diagram.projection import Ball, Bodies, Box, Projection
from dmframe.exact import ZeroDivision
from dmframe.program import JUMPS
from dmframe.prove.definite import Number, lower, upper
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import pseudo_inertia

ROUNDING: Final = 1e-9 / 4
"""Of a load's trace: less than the share of its largest eigenvalue that `verify` takes for rounding."""
TINY: Final = 1e-30
"""By which a load of nothing has pivots above zero."""


def tacit(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """All of it, as conditions that hold. Costs about as much as a part of `verify`, for pages and studies.

    Those with a margin hold where that is above zero, but for `sufficient` ones, of which `verify` would then ask
    something else; the others as long as what they read keeps its value.
    """
    yield from _domains(claim)
    yield from _widths(claim)
    yield from _stable(claim)
    yield from at_one_point(claim, numbers)


def at_one_point(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """What `verify` decides at the graph's own numbers alone, and not over its intervals."""
    yield from _follows(claim, numbers)
    yield from _sets(claim)
    yield from _absent(claim, numbers)
    yield from _paths(claim)
    yield from _loads(claim, numbers)
    yield from _rooms(claim, numbers)
    yield from _starts(claim, numbers)
    for name, margin, reads in kept_within(claim):
        yield _held(name, margin, reads=reads, sufficient=True)
    for name, reads in kept_above(claim, numbers):
        yield _held(name, reads=reads)


def _held(name: Text, margin: SX | None = None, *, strict: bool = True, **others: Any) -> Checked:
    """A check that the graph's own numbers pass."""
    return Checked(name, "", None, True, "", strict=strict, margin=margin, **others)


def _domains(claim: Claim) -> Iterator[Checked]:
    """Divisors and arguments made of parameters alone; and those of what bounds a residual."""
    for name, model in claim.diagram.models.items():
        yield from domains(name, claim.risks[name], model.moving)
    moving = symbols_in([claim.loop.state, claim.loop.time, *(leaf.symbol for leaf in claim.loop.trajectories)])
    for part in claim.parts:
        terms = [ca.SX(term.value) for term in part.certificate.residual]
        yield from domains(f"{part.block}, what bounds its residual", list(domains_of(terms)), moving)


def _widths(claim: Claim) -> Iterator[Checked]:
    """As `bounds_of` looks at clipped terms."""
    for part in claim.parts:
        for term in part.certificate.residual:
            if isinstance(term, Clipped):
                yield _held(Text(f"{part.block}: width of the clipped ", term.of, " > 0"), ca.SX(term.width))


def _replaced(item: StableLinear) -> bool:
    """True where its block states conditions that replace it where it does not follow."""
    return not all(isinstance(condition, Assumption) for condition in item.otherwise)


def _stable(claim: Claim) -> Iterator[Checked]:
    """Stability of linear subsystems with a replacement, as the closure checks it."""
    for part in claim.parts:
        for item in part.certificate.linear:
            if _replaced(item):
                text = Text(f"{part.block}: the linear equation of ", joined(item.of), " is stable")
                yield _held(text, stability_margin(item), sufficient=True)


def _follows(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """What follows at the graph's numbers follows at almost all others, or depends on them; in an interval, at zero."""
    if not any(_replaced(item) for part in claim.parts for item in part.certificate.linear):
        return
    symbols = symbols_of(claim, numbers.uncertain)
    bases = bases_of(claim, symbols, Signs(claim, numbers))
    zeros = frozenset(label for label in numbers.uncertain if all(map(_holds_zero, numbers.values[label])))
    own = Closure(claim, numbers, bases, seed=0)
    lacking = _left(own)
    for text, other, labels in (
        ("other numbers", _lacking(claim, numbers, bases, anywhere=True), None),
        ("zero", _lacking(claim, numbers, bases, zeros=zeros) if zeros else lacking, zeros),
    ):
        if other is None or lacking != other:
            used = symbols_in(symbol for expression in own.read for symbol in ca.symvar(expression))
            given = [p.symbol for p in claim.loop.parameters if (p.label in zeros if labels else _fixed(numbers, p))]
            known = [symbol for symbol in ca.vertsplit(stack(given)) if symbol.element_hash() in used]
            name = sentence("what {V} bounds follows at {text} too", text=text)
            yield _held(name, reads=ca.vertcat(ca.SX(0, 1), *known))


def _fixed(numbers: Numbers, parameter: Parameter) -> bool:
    return parameter.label not in numbers.uncertain


def _holds_zero(value: Number) -> bool:
    return lower(value) <= 0 <= upper(value)


def _lacking(
    claim: Claim, numbers: Numbers, bases: Bases, *, anywhere: bool = False, zeros: frozenset[str] = frozenset()
) -> list[list[str]] | None:
    """What does not follow, or by an assumption alone; None where a denominator vanishes there."""
    try:
        return _left(Closure(claim, numbers, bases, seed=0, anywhere=anywhere, zeros=zeros))
    except (ValueFault, ZeroDivision):
        return None


def _left(closure: Closure) -> list[list[str]]:
    return [sorted(f"{b} {i.of}" for b, i in items) for items in (closure.missed, closure.assumed, closure.given)]


def _sets(claim: Claim) -> Iterator[Checked]:
    """A projection's law is the same wherever its set lies, as long as that has an inside."""
    for projection in claim.loop.projections:
        name = Text(Label(projection.name), f": the {projection.kind} has an inside")
        yield _held(name, _inside(projection.set), strict=not isinstance(projection.set, Box), sufficient=True)


def _inside(kept: Box | Ball | Bodies) -> SX:
    if isinstance(kept, Box):
        return kept.upper - kept.lower
    if isinstance(kept, Ball):
        gain = kept.gain if kept.gain.is_column() else ca.vertcat(*ldl(square(kept.gain))[1])
        return ca.vertcat(kept.radius, gain)
    return ca.vertcat(*_pivots(kept.nominal), kept.share)


def _pivots(bodies: SX, floor: bool = False) -> list[SX]:
    """Of the pseudo-inertia of each body; with `floor`, moved up by what is taken for rounding."""
    found = list[SX]()
    for body in ca.vertsplit(bodies, len(INERTIAL)):
        matrix = ca.blockcat(pseudo_inertia(ca.vertsplit(body)))
        lifted = (ROUNDING * ca.trace(matrix) + TINY) * ca.SX.eye(4) if floor else 0
        found += ldl(matrix + lifted)[1]
    return found


def _absent(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """The identity was tested with the plant's zeros as zeros: `symbols_of`."""
    for group in symbols_of(claim, numbers.uncertain).groups:
        if group.kind == "parameter" and group.values is not None and not any(group.values):
            name = Text(Label(group.label), " is zero, as the proof takes it")
            yield _held(name, reads=ca.vec(group.symbol))


def _paths(claim: Claim) -> Iterator[Checked]:
    for name, read in followed_by_numbers(claim.diagram, claim):
        yield _held(Text(Label(name), " is continuous"), reads=read)


def _loads(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """That a load which a mass matrix holds is a body."""
    for label in load_labels(claim):
        (leaf,) = (leaf for leaf in claim.diagram.resolver.trajectories.values() if leaf.name == label)
        pieces, rest = pieces_of(claim, numbers, claim.loop.on_path(leaf.symbol))
        if pieces:
            name = Text(Label(label), " is the inertia of a rigid body")
            yield _held(name, ca.vertcat(*_pivots(ca.vertcat(*pieces), floor=True)), sufficient=True)
        yield _held(Text(Label(label), " changes when it does in the graph"), reads=rest)


def _rooms(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """That a true value which a source gives lies in the set of its estimate."""
    for name, room in rooms_on_path(claim, numbers):
        pieces, rest = pieces_of(claim, numbers, room)
        if pieces:
            yield _held(Text(name, ", as a source has it"), ca.vertcat(*pieces) + ROUNDED, strict=False)
        yield _held(Text(name, " changes when it does in the graph"), reads=rest)


def pieces_of(claim: Claim, numbers: Numbers, expression: SX) -> tuple[list[SX], SX]:
    """A function of time that is constant between steps, on each of its pieces, and what these depend on.

    No piece, and all its parameters, where it moves between steps. Pieces that are passed within the step of the
    instants at which `verify` looks are none to it either.
    """
    loop, expression = claim.loop, ca.densify(expression)
    slope = ca.jacobian(expression, loop.time)
    if not slope.is_zero():
        return [], numbers.reads(expression)
    time = symbols_in([loop.time])
    steps = [x for x, _ in instructions([expression]) if x.op() in JUMPS and symbols_in([x]) & time]
    if not steps:
        return [expression], ca.SX(0, 1)
    times, values = over_horizon(loop, ca.vertcat(*steps))
    _, first = np.unique(values, axis=1, return_index=True)
    pieces = [ca.substitute([expression], [loop.time], [ca.SX(float(times[k]))])[0] for k in sorted(first)]
    return pieces, numbers.reads(ca.vertcat(*steps))


def _starts(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Requirements of `verify` on a start with a known number."""
    for projection in claim.loop.projections:
        yield _started(projection, numbers)
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, InformationSquare):
                yield _gathers(gathered_from_start(part, term), term.memory, numbers)
            if isinstance(term, LogDet):
                begun = pivots_at_start(claim, numbers, {}, term.matrix)
                name = Text(f"{part.block}: ", term.of, " starts positive definite")
                yield _held(name, ca.SX(0, 1), begun=begun)
    for variable in claim.loop.variables:
        if variable.label in claim.memories:
            yield _gathers(Text(f"{variable.block}: start of ", name_of(variable.name)), variable.symbol, numbers)


def _started(projection: Projection, numbers: Numbers) -> Checked:
    begun = begun_in(projection, numbers, {})
    name = Text(Label(projection.name), f": starts inside the {projection.kind}")
    return _held(name, ca.SX(0, 1), strict=False, begun=begun)


def _gathers(name: Text, memory: SX, numbers: Numbers) -> Checked:
    return _held(name, reads=reads_of(numbers, {}, memory))
