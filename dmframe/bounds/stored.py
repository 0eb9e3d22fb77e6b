r"""Bounds from an error that V stores on the servo level.

Let a block on the servo level store :math:`\tfrac12 |E|^2_A`, where E moves with the signal a that drives the error e
of a cascade,

.. math:: \dot E = -\kappa E + a, \qquad \dot e = -\lambda e + a,

with constants :math:`\kappa \ge 0` for each joint and :math:`\lambda > 0`. Both equations are tested exactly. Then
:math:`d = e - E` has :math:`\dot d = -\lambda d + (\kappa - \lambda) E`, so e is E filtered by
:math:`(s + \kappa) / (s + \lambda)`, plus :math:`d(0)\, e^{-\lambda t}`. The largest gain of this filter over all
frequencies is :math:`\max(1, \kappa / \lambda)`, and the integral of its impulse response's absolute value is
:math:`1 + |\kappa - \lambda| / \lambda`:

.. math::

    \mathrm{RMS}_{[0,t]}(e) &\le \max(1, \tfrac{\kappa}{\lambda})\, \mathrm{RMS}_{[0,t]}(E)
                                + \frac{|d(0)|}{\sqrt{2 \lambda t}}                                      \tag{1} \\
    \sup |e| &\le \Big(1 + \frac{|\kappa - \lambda|}{\lambda}\Big) \sup |E| + |d(0)|                     \tag{2}

With :math:`\kappa = \lambda` and a start on the path, E is the error itself. If V also dissipates
:math:`|E|^2_W`, its mean square follows as in `dmframe.bounds.mean_square`. The largest value follows from the
storage S of the servo level, :math:`|E|^2 \le \max_j (2 / A_j)\, S`, and S from one of these bounds:

.. math::

    S(t) \le S(0) + \tfrac14 t\, \delta^2, \qquad
    S(t) \le c + \max\Big(S(0) - S_{est}(0),\ \frac{\delta^2}{4\, \theta \mu}\Big)                       \tag{3}

The second one holds for all times. It requires that S contains the kinetic term :math:`\tfrac12 v^\top M v` of a
dissipated :math:`|v|^2_W`, dissipated errors such as E, and errors of estimates in boxes, whose storage
:math:`S_{est}` is at most c. For :math:`\mu \le 2 \min \kappa`, and :math:`\theta = 1 - \tfrac12 \mu\, r` with
:math:`r \ge \lambda_{max}(W^{-1/2} M W^{-1/2})` at all joint positions,
:math:`\dot S \le -\mu (S - S_{est}) + \delta^2 / (4 \theta)`. The trace of :math:`W^{-1} M` is such an r.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import pi
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX, Square
from dmframe.block.model import symbols_in
from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.initial import Begin
from dmframe.bounds.supremum import Box
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, Part
from dmframe.certify.definite import is_mass_matrix
from dmframe.certify.form import stepping
from dmframe.certify.symbols import Symbols
from dmframe.common.text import Label, Text
from dmframe.diagram.projection import Box as Intervals
from dmframe.exact.balls import UndecidedError
from dmframe.exact.ranges import ranges
from dmframe.exact.rational import Interval
from dmframe.program import TO_READ, read
from dmframe.prove.definite import upper

TURN: Final = Interval(-Fraction(355, 113), Fraction(355, 113))
"""All positions of a revolute joint up to whole turns; the fraction exceeds pi."""
assert pi < TURN.upper


@final
@dataclass(frozen=True, eq=False)
class StoredError:
    """E: a stored square, its rate kappa for each joint, and the index of the dissipated square of E, if any."""

    term: Square
    kappa: SX
    dissipated: int | None


@final
@dataclass(frozen=True, eq=False)
class Bounded:
    """The part of S that the boxes of estimates bound, and the rest at the start, each with its name and elements."""

    boxes: tuple[tuple[Text, tuple[SX, ...]], ...]
    others: tuple[SX, ...]
    rate: float
    theta: float


@final
class StoredErrors:
    """The stored errors of one block on the servo level."""

    def __init__(self, claim: Claim, numbers: Numbers, symbols: Symbols, servo: Part, start: Mapping[str, Any]) -> None:
        self._claim, self._numbers, self._symbols, self._servo = claim, numbers, symbols, servo
        self._box, self._begin = Box(numbers), Begin(claim, numbers, start)

    def driven_by(self, signal: SX) -> Iterator[StoredError]:
        """Stored squares with dE/dt = -kappa E + signal."""
        for term in self._servo.certificate.storage:
            if not isinstance(term, Square) or term.vector.shape != signal.shape:
                continue
            if not ca.SX(term.weight).is_column() or not self._known(ca.SX(term.weight)):
                continue
            rest = ca.densify(signal - self._claim.flow.unrecorded(term.vector))
            fitting = (x for x in self._rates(term.vector, rest) if self._vanishes(rest - x * term.vector))
            kappa = next(fitting, None)
            if kappa is not None:
                place = self._place(term)
                known = place is None or self._known(ca.SX(self._servo.certificate.dissipation[place].weight))
                yield StoredError(term, kappa, place if known else None)

    def _rates(self, vector: SX, rest: SX) -> Iterator[SX]:
        """Candidates of kappa in rest = kappa E, from the derivatives by states on which E depends as +-1."""
        for variable in self._claim.loop.variables:
            if variable.symbol.shape == vector.shape and ca.depends_on(vector, variable.symbol):
                slope = ca.jacobian(vector, variable.symbol)
                for sign in (1, -1):
                    kappa = ca.densify(sign * ca.diag(ca.jacobian(rest, variable.symbol)))
                    if (slope - sign * ca.SX.eye(vector.numel())).is_zero() and self._known(kappa):
                        yield kappa

    def _known(self, expression: SX) -> bool:
        return symbols_in(self._claim.loop.joined([expression])) <= self._numbers.known

    def _vanishes(self, expression: SX) -> bool:
        return self._symbols.vanishes("stored", ca.densify(self._claim.loop.joined([expression])[0]))

    def _same(self, one: Square, other: Square) -> bool:
        first, second = one.pieces[0], other.pieces[0]
        fitting = first.shape == second.shape and ca.SX(one.weight).is_column()
        return fitting and any(self._vanishes(first + sign * second) for sign in (-1, 1))

    @cached_property
    def boxed(self) -> Bounded:
        """What the second bound of (3) requires.

        Raises `NoBoundError` if S contains a term that neither decays nor lies in a box.
        """
        boxes, others = list[tuple[Text, tuple[SX, ...]]](), list[SX]()
        spent = dict[int, list[SX]]()
        for part in (part for part in self._claim.parts if not part.cascade):
            for term in part.stored:
                held = self._held(part, term)
                if held is not None:
                    boxes.append(held)
                    continue
                place = self._place(term) if isinstance(term, Square) else None
                if place is None or not isinstance(term, Square):
                    raise NoBoundError(f"{part.block}: {term.of} neither decays nor is in a box")
                others += self._begin.elements(term)
                spent.setdefault(place, []).append(ca.SX(term.weight))
        kinetic, rates, ratio = self._servo.dominating, list[float](), 0.0
        for place, weights in spent.items():
            if place < len(kinetic) and all(is_mass_matrix(self._claim, weight) for weight in weights):
                W = kinetic[place].weight
                ratio = max(ratio, sum(self._largest(ca.sum1(ca.diag(M) / W)) for M in weights))
            else:
                rates.append(self._decay(place, weights))
        if not rates:
            raise NoBoundError("no stored error decays")
        rate = min([*rates, *([1 / ratio] if ratio else [])])
        return Bounded(tuple(boxes), tuple(others), rate, 1 - rate * ratio / 2)

    def _place(self, term: Square) -> int | None:
        """Index of the dissipated square of the same vector."""
        for k, each in enumerate(self._servo.certificate.dissipation):
            if isinstance(each, Square) and self._same(each, term):
                return k
        return None

    def _held(self, part: Part, term: object) -> tuple[Text, tuple[SX, ...]] | None:
        """Upper bound of a term of an estimate in a box, element by element; None for another term."""
        for projection in self._claim.loop.projections:
            true = part.certificate.estimates.get(projection.of) if projection.block == part.block else None
            if true is None or not isinstance(term, Square) or not isinstance(projection.set, Intervals):
                continue
            error = projection.state - true.value
            if (
                term.vector.shape == error.shape
                and ca.SX(term.weight).is_column()
                and self._vanishes(term.vector - error)
            ):
                value = self._begin.at(true.value + ca.SX.zeros(error.shape[0]))
                weight = self._begin.at(ca.densify(term.weight * ca.SX.ones(error.shape[0])))
                ends = (ca.fabs(end - value) for end in projection.set.ends)
                most = ca.fmax(*ends)
                return Text("the box of ", Label(projection.name)), tuple(ca.vertsplit(most * most * weight / 2))
        return None

    def _decay(self, place: int, stored: Sequence[SX]) -> float:
        """At most the rate at which V dissipates stored squares of one vector, relative to half of their sum.

        Raises `NoBoundError` if a torque acts on this vector: its dissipation is then needed against the torque.
        """
        shares, square = self._servo.certificate.disturbed, self._servo.certificate.dissipation[place]
        if place < len(shares) and not ca.SX(shares[place]).is_zero():
            raise NoBoundError(f"a torque acts on {square.of}")
        ones = ca.SX.ones(square.pieces[0].shape[0])
        A, W = sum((weight * ones for weight in stored), 0 * ones), square.weight * ones
        if not self._known(ca.vertcat(A, W)):
            raise NoBoundError(f"the weight of {square.of} is not constant")
        pairs = zip(ca.vertsplit(A), ca.vertsplit(W), strict=True)
        return 2 / max(float(self._box.tops_of_products([a], [1 / w])[0][0]) for a, w in pairs)

    def _largest(self, scalar: SX) -> float:
        """Upper end of a scalar that depends on the positions of revolute joints, over all of them."""
        loop = self._claim.loop
        for leaf in stepping(self._claim):  # constant, or there is no bound
            scalar = ca.substitute(scalar, leaf.symbol, ca.substitute(loop.on_path(leaf.symbol), loop.time, 0))
        columns, given = self._numbers.given
        chain = self._claim.diagram.robot
        for variable in loop.plant:
            if ca.depends_on(scalar, variable.symbol):
                if chain is None or variable.symbol.numel() != chain.n:
                    raise NoBoundError(f"the mass matrix depends on {variable.label}")
                if any(joint.kind != "revolute" for joint in chain.joints):
                    raise NoBoundError("the mass matrix of a robot with a prismatic joint is not bounded")
                columns, given = [*columns, ca.vec(variable.symbol)], [*given, [TURN] * variable.symbol.numel()]
        function = ca.Function("inertia", columns, [self._numbers.tied(scalar)], {"allow_free": True, **TO_READ})
        if function.has_free():
            raise NoBoundError(f"the mass matrix depends on {function.get_free()[0]}")
        try:
            return float(max(map(upper, ranges(read(function), given))))
        except UndecidedError as fault:
            raise NoBoundError(f"the mass matrix is not bounded: {fault.text}") from None
