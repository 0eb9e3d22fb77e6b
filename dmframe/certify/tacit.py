"""Checks of `verify` without a line in the verdict, as margins or as lists of the values that they depend on.

The checks are: no division by zero, positive widths of clipped terms, projection sets with an interior, stability of
linear equations that would otherwise have further conditions, continuous paths, rigid-body loads, parameters that are
zero, paths within reach, and assumptions that are not contradicted. `verify` of a single graph does not compute them;
they are for intervals and for varied numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import product
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
from dmframe.certify.memories import memory_start_name, pivots_at_start, reads_of
from dmframe.certify.partial_functions import domains_of, instructions
from dmframe.certify.positive import Signs
from dmframe.certify.projections import ROUNDED, margin_at_start, rooms_on_path
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
from dmframe.exact.balls import UndecidedError
from dmframe.exact.rational import as_float
from dmframe.program import JUMPS
from dmframe.prove.definite import Number, lower, upper
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import pseudo_inertia

ROUNDING: Final = 1e-9 / 4
"""Fraction of a load's trace, less than the fraction of its largest eigenvalue that `verify` allows for rounding."""
AFTER: Final = 1e-9
"""Time after a switch at which a piecewise constant function is evaluated [s]."""
TINY: Final = 1e-30
MOST_OPEN: Final = 6
"""Number of parameters with intervals of a load beyond which its corners are not tried."""
"""Offset with which the pivots of a zero load are positive."""


def tacit(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """All checks, as conditions that are met. They take as long as a part of `verify`, and are for pages and studies.

    A check with a margin is met if the margin is positive; if a `sufficient` margin is negative, `verify` would check
    another condition. The other checks are met as long as the values that they depend on are unchanged.
    """
    yield from _domains(claim)
    yield from _widths(claim)
    yield from _stable(claim)
    yield from at_one_point(claim, numbers)


def at_one_point(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Checks of `verify` at the graph's own numbers only, not over its intervals."""
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
    """Divisors and arguments made of parameters only, also those in bounds of a residual."""
    for name, model in claim.diagram.models.items():
        yield from domains(name, claim.risks[name], model.moving)
    moving = symbols_in([claim.loop.state, claim.loop.time, *(leaf.symbol for leaf in claim.loop.trajectories)])
    for part in claim.parts:
        terms = [ca.SX(term.value) for term in part.certificate.residual]
        yield from domains(f"{part.block}, bounds of its residual", list(domains_of(terms)), moving)


def _widths(claim: Claim) -> Iterator[Checked]:
    """Widths of clipped terms, as checked by `bounds_of`."""
    for part in claim.parts:
        for term in part.certificate.residual:
            if isinstance(term, Clipped):
                yield _held(Text(f"{part.block}: width of the clipped ", term.of, " > 0"), ca.SX(term.width))


def _replaced(item: StableLinear) -> bool:
    """True if its block states conditions that replace it if boundedness does not follow."""
    return not all(isinstance(condition, Assumption) for condition in item.otherwise)


def _stable(claim: Claim) -> Iterator[Checked]:
    """Stability of linear subsystems with a replacement, as the closure checks it."""
    for part in claim.parts:
        for item in part.certificate.linear:
            if _replaced(item):
                text = Text(f"{part.block}: the linear equation of ", joined(item.of), " is stable")
                yield _held(text, stability_margin(item), sufficient=True)


def _follows(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Boundedness at other numbers: it follows at almost all of them, or depends on them; in an interval, at zero."""
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
            name = sentence("the bounds from {V} follow at {text} too", text=text)
            yield _held(name, reads=ca.vertcat(ca.SX(0, 1), *known))


def _fixed(numbers: Numbers, parameter: Parameter) -> bool:
    return parameter.label not in numbers.uncertain


def _holds_zero(value: Number) -> bool:
    return lower(value) <= 0 <= upper(value)


def _lacking(
    claim: Claim, numbers: Numbers, bases: Bases, *, anywhere: bool = False, zeros: frozenset[str] = frozenset()
) -> list[list[str]] | None:
    """Conclusions that fail or need an assumption; None if a denominator vanishes."""
    try:
        return _left(Closure(claim, numbers, bases, seed=0, anywhere=anywhere, zeros=zeros))
    except (ValueFault, ZeroDivision):
        return None


def _left(closure: Closure) -> list[list[str]]:
    return [sorted(f"{b} {i.of}" for b, i in items) for items in (closure.missed, closure.assumed, closure.given)]


def _sets(claim: Claim) -> Iterator[Checked]:
    """Interior of projection sets: a projection's law does not depend on the location of its set."""
    for projection in claim.loop.projections:
        name = Text(Label(projection.name), f": the {projection.kind} has an interior")
        yield _held(name, _inside(projection.set), strict=not isinstance(projection.set, Box), sufficient=True)


def _inside(kept: Box | Ball | Bodies) -> SX:
    if isinstance(kept, Box):
        return kept.upper - kept.lower
    if isinstance(kept, Ball):
        gain = kept.gain if kept.gain.is_column() else ca.vertcat(*ldl(square(kept.gain))[1])
        return ca.vertcat(kept.radius, gain)
    return ca.vertcat(*_pivots(kept.nominal), kept.share)


def _pivots(bodies: SX, floor: bool = False) -> list[SX]:
    """Pivots of the pseudo-inertia of each body; with `floor`, increased by the allowed rounding error."""
    found = list[SX]()
    for body in ca.vertsplit(bodies, len(INERTIAL)):
        matrix = ca.blockcat(pseudo_inertia(ca.vertsplit(body)))
        lifted = (ROUNDING * ca.trace(matrix) + TINY) * ca.SX.eye(4) if floor else 0
        found += ldl(matrix + lifted)[1]
    return found


def _absent(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Parameters of the plant that are zero in the identity test: `symbols_of`."""
    for group in symbols_of(claim, numbers.uncertain).groups:
        if group.kind == "parameter" and group.values is not None and not any(group.values):
            name = Text(Label(group.label), " is zero, as in the proof")
            yield _held(name, reads=ca.vec(group.symbol))


def _paths(claim: Claim) -> Iterator[Checked]:
    for name, read in followed_by_numbers(claim.diagram, claim):
        yield _held(Text(Label(name), " is continuous"), reads=read)


def _loads(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """A load in a mass matrix is a rigid body."""
    for label in load_labels(claim):
        (leaf,) = (leaf for leaf in claim.diagram.resolver.trajectories.values() if leaf.name == label)
        pieces, rest = pieces_of(claim, numbers, claim.loop.on_path(leaf.symbol))
        if pieces:
            name = Text(Label(label), " is the inertia of a rigid body")
            margin = ca.vertcat(*_pivots(ca.vertcat(*pieces), floor=True))
            if (corners := _corners(numbers, ca.vertcat(*pieces))) is not None:
                at_corners = ca.vertcat(*_pivots(corners, floor=True))
                with suppress(ValueFault, UndecidedError):
                    margin = at_corners if min(map(lower, numbers.enclosed(at_corners))) > 0 else margin
            yield _held(name, margin, sufficient=True)
        yield _held(Text(Label(label), " changes at the same times as in the graph"), reads=rest)


def _corners(numbers: Numbers, bodies: SX) -> SX | None:
    """Bodies at the corners of the intervals of the parameters in which they are affine; None if they are not.

    The positive semidefinite matrices are a convex set, so that corners that are rigid bodies decide for the whole box.
    """
    open_ = [symbol for symbol in ca.symvar(bodies) if symbol.element_hash() in numbers.open]
    if (
        not 0 < len(open_) <= MOST_OPEN
        or not ca.jacobian(ca.jacobian(bodies, ca.vertcat(*open_)), ca.vertcat(*open_)).is_zero()
    ):
        return None
    ends = [(lower(value), upper(value)) for value in map(numbers.value_of, open_)]
    return ca.vertcat(
        *(
            ca.substitute(bodies, ca.vertcat(*open_), ca.vertcat(*(ca.SX(as_float(end)) for end in corner)))
            for corner in product(*ends)
        )
    )


def _rooms(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """A true value from a source lies in the set of its estimate."""
    for name, room in rooms_on_path(claim, numbers):
        pieces, rest = pieces_of(claim, numbers, room)
        if pieces:
            yield _held(Text(name, ", for the values of a source"), ca.vertcat(*pieces) + ROUNDED, strict=False)
        yield _held(Text(name, " changes at the same times as in the graph"), reads=rest)


def pieces_of(claim: Claim, numbers: Numbers, expression: SX) -> tuple[list[SX], SX]:
    """A piecewise constant function of time on each of its pieces, and the parameters of the switching instants.

    These are none if the instants are functions of the parameters, see `_moments`: the pieces are then those at any
    values. Without a piece, all its parameters, if it varies between steps. Pieces shorter than the sampling interval
    of `verify` are ignored, as by `verify`.
    """
    loop, expression = claim.loop, ca.densify(expression)
    slope = ca.jacobian(expression, loop.time)
    if not slope.is_zero():
        return [], numbers.reads(expression)
    steps = _steps(loop.time, expression)
    if not steps:
        return [expression], ca.SX(0, 1)
    if (moments := _moments(loop.time, steps)) is not None:
        return [ca.substitute([expression], [loop.time], [at])[0] for at in moments], ca.SX(0, 1)
    times, values = over_horizon(loop, ca.vertcat(*steps))
    _, first = np.unique(values, axis=1, return_index=True)
    pieces = [ca.substitute([expression], [loop.time], [ca.SX(float(times[k]))])[0] for k in sorted(first)]
    return pieces, numbers.reads(ca.vertcat(*steps))


def instants_of(time: SX, expression: SX) -> list[SX] | None:
    """Zero and an instant in each later piece of a piecewise constant function of time, as functions of the parameters.

    None if the function is not piecewise constant, or the instants are not known.
    """
    return _moments(time, _steps(time, expression)) if ca.jacobian(expression, time).is_zero() else None


def _steps(time: SX, expression: SX) -> list[SX]:
    """Operations on time whose value jumps."""
    return [x for x, _ in instructions([expression]) if x.op() in JUMPS and ca.depends_on(x, time)]


def _moments(time: SX, steps: Sequence[SX]) -> list[SX] | None:
    """Zero and an instant after each switch, as functions of the parameters; None for a switch that is no instant.

    A switch compares a term that is linear in time, without other switches. Each piece that is longer than `AFTER` then
    contains one of these instants, for all values of the parameters.
    """
    found = [ca.SX(0.0)]
    for step in steps:
        if step.op() not in (ca.OP_LE, ca.OP_LT):
            return None
        difference = step.dep(0) - step.dep(1)
        slope = ca.jacobian(difference, time)
        if not slope.is_constant() or slope.is_zero() or _steps(time, difference):
            return None
        at = -ca.substitute(difference, time, ca.SX(0)) / slope
        found.append(ca.fmax(at + AFTER, 0))
    return found


def _starts(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Requirements of `verify` on a numeric initial value."""
    for projection in claim.loop.projections:
        yield _started(projection, numbers)
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, InformationSquare):
                yield _memory_start(memory_start_name(part, term), term.memory, numbers)
            if isinstance(term, LogDet):
                begun = pivots_at_start(claim, numbers, {}, term.matrix)
                name = Text(f"{part.block}: ", term.of, " starts positive definite")
                yield _held(name, ca.SX(0, 1), begun=begun)
    for variable in claim.loop.variables:
        if variable.label in claim.memories:
            yield _memory_start(Text(f"{variable.block}: start of ", name_of(variable.name)), variable.symbol, numbers)


def _started(projection: Projection, numbers: Numbers) -> Checked:
    begun = margin_at_start(projection, numbers, {})
    name = Text(Label(projection.name), f": starts inside the {projection.kind}")
    return _held(name, ca.SX(0, 1), strict=False, begun=begun)


def _memory_start(name: Text, memory: SX, numbers: Numbers) -> Checked:
    return _held(name, reads=reads_of(numbers, {}, memory))
