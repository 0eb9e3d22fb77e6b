r"""Bounds on the tracking error of a cascade, over the intervals of a graph.

Let S be the storage of the servo level and :math:`p = \sum_i |v_i|^2_{W_i}` the dissipation of the block that dominates
the cross term. The proof of a claim shows :math:`\dot S \le -p`. A disturbance torque :math:`|d_j(t)| \le D_j` adds
:math:`\sum_i (c_i v_i)^\top d` (`dmframe.bounds.disturbed`). Let :math:`s_{ij}` be the root mean square of element j of
:math:`v_i` from 0 to t. Since S is not negative and by Cauchy's inequality for the integral,

.. math::

    \sum_{ij} W_{ij} s_{ij}^2 \le \frac{S(0)}{t} + \sum_{ij} |c_{ij}| D_j s_{ij}
    \quad\Leftrightarrow\quad
    \sum_{ij} W_{ij} \Big(s_{ij} - \frac{|c_{ij}| D_j}{2 W_{ij}}\Big)^2 \le \frac{S(0)}{t} + \frac{\delta^2}{4},
    \qquad \delta^2 = \sum_{ij} \frac{c_{ij}^2 D_j^2}{W_{ij}}                                          \tag{1}

The cascade's cross term is :math:`c\,|a|^2` with :math:`a = \sum_i a_i v_i`. If its error moves as
:math:`\dot e = -\lambda e + a`, :math:`\lambda = 1/c`, which is tested exactly, it is a first-order lag with the gain
:math:`1/\lambda`. With :math:`\rho = \max_j \sum_i a_{ij}^2 / W_{ij}` and
:math:`m_j = \sum_i |a_{ij} c_{ij}| D_j / (2 W_{ij})`:

.. math::

    \mathrm{RMS}_{[0,t]}(e) \le \frac1\lambda \Big(|m| + \sqrt{\rho\, S(0)/t + \rho\, \delta^2/4}\Big)
    + \frac{|e(0)|}{\sqrt{2 \lambda t}}                                                              \tag{2}

:math:`V = \kappa S + S_t`, with the storage :math:`S_t` of the cascade and :math:`\kappa = c \rho / r`, 0 < r < 1,
leaves the fraction 1 - r of p, so that :math:`\dot V \le \kappa \delta^2 / (4 (1 - r))`. For all times up to t, with
the weight w of :math:`\tfrac12 |e|^2` in :math:`S_t`, of any cascade:

.. math::

    w\, |e|^2 \le 2 S_t(0) + \frac{2 c}{r} \Big(\rho\, S(0) + \frac{t\, \rho\, \delta^2}{4 (1 - r)}\Big)      \tag{3}

M, C and friction do not appear: monotone friction and projections only decrease S. All numbers are upper ends over the
intervals, in exact, ball or outward rounded interval arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import inf, isfinite, sqrt
from typing import Any, Final, final

import casadi as ca

from dmframe.block.certificate import SX, Square
from dmframe.bounds.disturbed import NoBoundError, require_disturbed
from dmframe.bounds.given import OVER, Torque, torques_of
from dmframe.bounds.initial import Begin, Initial, initial_terms
from dmframe.bounds.motion import extent
from dmframe.bounds.stored import StoredError, StoredErrors
from dmframe.bounds.supremum import Box
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim, Part, total
from dmframe.certify.error_bound import ErrorBound, ErrorBounds, Kind, Share
from dmframe.certify.form import stepping
from dmframe.certify.reach import largest_tube
from dmframe.certify.shell import largest_jacobian
from dmframe.certify.symbols import symbols_of
from dmframe.certify.tacit import instants_of
from dmframe.certify.verdict import Verdict
from dmframe.common.errors import ValueFault
from dmframe.common.text import Text, Written
from dmframe.common.units import plain
from dmframe.diagram.closed_loop import stack
from dmframe.exact import zero_test
from dmframe.exact.balls import UndecidedError
from dmframe.exact.rational import Interval
from dmframe.program import TO_READ

ROUNDED: Final = 1 + 1e-12
"""Factor that covers the rounding of the last operations in floating point."""
TOOL: Final = Text(Written("x - x(q_d)", "x − x(q_d)", r"x - x(q_d)"))
"""Distance of the tool from its place at the desired joint positions."""
DISTURBED: Final = Share(Text("the disturbance"), of_start=False)
SPLITS: Final = tuple(k / 200 for k in range(1, 200))
"""Values of r in (3)."""


def error_bounds(
    verdict: Verdict,
    *,
    over: float | None = None,
    disturbance: Torque = 0.0,
    uncertain: Mapping[str, Sequence[Interval]] | None = None,
    start: Mapping[str, Any] | None = None,
) -> ErrorBounds:
    """Bounds (2) and (3) on the tracking errors of a proved claim.

    Parameters
    ----------
    verdict
        Of `dmframe.certify.verify` with the same `uncertain` and `start`.
    over
        Length of the run, t [s]; by default a minute.
    disturbance
        D, one for all joints or one for each [N m].

    Raises
    ------
    ValueFault
        `over` is not above zero, or `disturbance` is no torque of 0 or above for each joint.
    """
    over = OVER if over is None else over
    if not (over > 0 and isfinite(over)):
        raise ValueFault(f"over: expected a time above 0 s, found {over:g} s")
    try:
        claim = _bounded(verdict)
        torques = torques_of(disturbance, claim.diagram.robot.n)
        return _ErrorBounds(claim, over, torques, uncertain or {}, start or {}).bounds()
    except NoBoundError as fault:
        return ErrorBounds(missing=(fault.text,))
    except (ValueFault, UndecidedError) as fault:
        return ErrorBounds(missing=(f"the bound is not enclosed over the intervals: {fault.text}",))
    except OverflowError:
        return ErrorBounds(missing=("the bound is larger than any floating-point number",))


def _bounded(verdict: Verdict) -> Claim:
    """The claim of a verdict. Raises `NoBoundError` if it does not bound V by the start alone."""
    claim = verdict.flow_claim
    if verdict.outcome != "proved" or claim is None:
        raise NoBoundError("a bound needs a proof in continuous time")
    if verdict.bounds:
        raise NoBoundError("the proof is up to a residual, whose effect grows with time")
    if not claim.cross_terms:
        raise NoBoundError("V holds no error that the servo level drives through a cross term")
    return claim


@final
class _ErrorBounds:
    """Evaluation of the bounds of one claim."""

    def __init__(
        self,
        claim: Claim,
        over: float,
        torques: Sequence[float],
        uncertain: Mapping[str, Sequence[Interval]],
        start: Mapping[str, Any],
    ) -> None:
        self._claim, self._over, self._torques, self._start = claim, over, tuple(torques), start
        self._numbers = Numbers(claim, uncertain)
        self._box, self._symbols = Box(self._numbers), symbols_of(claim, self._numbers.uncertain)

    def bounds(self) -> ErrorBounds:
        """The bounds on all tracking errors."""
        for leaf in stepping(self._claim):
            if not self._is_constant(leaf.symbol):
                raise NoBoundError(f"V jumps where {leaf.name} does")
        found, missing, level = list[ErrorBound](), list[str](), self._level(self._servo())
        for consumer, _ in self._claim.cross_terms:
            for error, unit, moved, wanted in self._errors(consumer):
                rate = self._lag(consumer, error)
                own = list(self._stored(consumer, error, unit)) if rate is not None else []
                if rate is not None:
                    candidates = [self._rms(level, consumer, error, unit, rate), *(x for x in own if x.kind == "rms")]
                    found.append(replace(min(candidates, key=_value), moved=moved))
                else:
                    missing.append(f"{consumer.block}: no bound on the mean square of {error.of}: {self._why(wanted)}")
                candidates = [self._sup(level, error, unit), *(x for x in own if x.kind == "sup")]
                found.append(replace(min(candidates, key=_value), moved=moved))
        found += list(_at_the_tool(self._claim, found))
        if not found:
            missing.append("V holds no tracking error as a square")
        return ErrorBounds(tuple(found), tuple(missing))

    def _is_constant(self, signal: SX) -> bool:
        """True for a piecewise constant signal that is the same function of the uncertain parameters on all pieces."""
        loop, uncertain = self._claim.loop, self._numbers.uncertain
        expression = ca.densify(loop.on_path(signal))
        known = [parameter for parameter in loop.parameters if parameter.label not in uncertain]
        symbols, values = [p.symbol for p in known], [ca.SX(ca.DM(p.value.reshape(p.symbol.shape))) for p in known]
        pieces = [
            ca.substitute(ca.substitute([expression], [loop.time], [at]), symbols, values)[0]
            for at in instants_of(loop.time, expression) or ()
        ]
        return bool(pieces) and _vanishes(ca.vertcat(ca.SX(0), *(piece - pieces[0] for piece in pieces[1:])))

    def _servo(self) -> Part:
        """The block that dominates all cross terms."""
        servos = {id(servo): servo for _, servo in self._claim.cross_terms}
        (servo,) = servos.values() if len(servos) == 1 else (None,)
        if servo is None or servo.cascade:
            raise NoBoundError("the cross terms of the cascades are not dominated by one block on the servo level")
        if not servo.certificate.disturbed:
            raise NoBoundError(f"{servo.block}: its certificate does not state how a joint torque acts on V")
        return servo

    def _why(self, wanted: str) -> str:
        """Why the error of a tool has no bound on its mean square, and by how much the tube is too wide."""
        why = "it is no first-order lag of the servo level's error; a least singular value of J is needed"
        tube = largest_tube(self._claim.diagram, wanted, self._over)
        return (
            why
            if tube is None
            else f"{why} on the tube that V allows, and J loses rank at most {plain(tube, 'm')} from the path"
        )

    def _errors(self, consumer: Part) -> Iterator[tuple[Square, str, float | None, str]]:
        """Squares in a cascade's storage that are tracking errors: with unit, `extent`, name of the desired value."""
        units = {signal.label: signal.unit for signal in self._claim.loop.outputs}
        pairs = [(ca.vec(pair.found) - ca.vec(pair.wanted), pair) for pair in self._claim.loop.goals]
        for term in consumer.certificate.storage:
            if isinstance(term, Square) and ca.SX(term.weight).is_column():
                fitting = [(e, pair) for e, pair in pairs if e.shape == term.vector.shape]
                for e, pair in fitting:
                    (joined,) = self._claim.loop.joined([e])
                    if any(self._symbols.vanishes("error", term.vector + sign * joined) for sign in (-1, 1)):
                        yield term, units[pair.actual], extent(self._claim.loop, pair, self._over), pair.desired
                        break

    @cached_property
    def _terms(self) -> list[Initial]:
        return initial_terms(self._claim, self._numbers, self._start)

    def _level(self, servo: Part) -> _Level:
        """The quantities of the servo level in (2) and (3)."""
        storage = total([part.storage for part in self._claim.parts if not part.cascade])
        require_disturbed(self._claim, self._symbols, servo, storage)
        D, (a, c, W) = ca.DM(list(self._torques)), _coefficients(servo)
        rho = ca.vertsplit(sum((a_i * a_i / W_i for a_i, W_i in zip(a, W, strict=True)), ca.SX(0)))
        middle = sum((ca.fabs(a_i * c_i) / W_i * D / 2 for a_i, c_i, W_i in zip(a, c, W, strict=True)), ca.SX(0))
        return self._scaled(servo, rho, middle)

    def _scaled(self, servo: Part, rho: Sequence[SX], middle: SX) -> _Level:
        """S(0) and delta^2 times rho, and the norm of m."""
        D, (_, c, W) = ca.DM(list(self._torques)), _coefficients(servo)
        power = ca.sum1(sum((c_i * c_i / W_i * D * D for c_i, W_i in zip(c, W, strict=True)), ca.SX(0)))
        m = sqrt(sum(float(each) ** 2 for each in self._box.tops(ca.vertsplit(middle))))
        driven = max(map(float, self._box.tops_of_products([power], rho)[0])) if any(self._torques) else 0.0
        shares = [(x, _summed(self._box.tops_of_products(x.elements, rho))) for x in self._terms if not x.cascade]
        stored = max(float(sum(each)) for each in zip(*(products for _, products in shares), strict=True))
        largest, products = max(shares, key=lambda item: max(item[1]))
        dominating = Share(largest.of, largest.lowered_by())
        if m + sqrt(driven / 4) > sqrt(float(max(products)) / self._over):
            dominating = DISTURBED
        return _Level(stored, driven, m, dominating)

    def _stored(self, consumer: Part, error: Square, unit: str) -> Iterator[ErrorBound]:
        """Bounds of `dmframe.bounds.stored`, for an error that is a first-order lag."""
        cross, servo = consumer.certificate.consumes, self._servo()
        assert cross is not None
        stored = StoredErrors(self._claim, self._numbers, self._symbols, servo, self._start)
        (ones, c), rate = (ca.SX.ones(error.vector.shape[0]), cross.c), 1 / self._top([cross.c])
        for own in stored.driven_by(cross.vector):
            begun = ca.vertsplit(Begin(self._claim, self._numbers, self._start).at(error.vector - own.term.vector))
            first, ratio = sqrt(self._top([each * each for each in begun])), own.kappa * c * ones
            if own.dissipated is not None:
                _, shares, W = _coefficients(servo, own.dissipated + 1)
                share, weight = shares[own.dissipated], W[own.dissipated]
                middle = ca.fabs(share) / weight * ca.DM(list(self._torques)) / 2
                level = self._scaled(servo, ca.vertsplit(ones / weight), middle)
                gain = max(1.0, *map(float, self._box.tops(ca.vertsplit(ca.fabs(ratio)))))
                value = level.middle + sqrt(level.stored / self._over + level.driven / 4)
                yield self._bound("rms", error, unit, gain * value + first / sqrt(2 * rate * self._over), level)
            level = self._scaled(servo, ca.vertsplit(2 * ones / own.term.weight), ca.SX(0))
            gain = 1 + max(map(float, self._box.tops(ca.vertsplit(ca.fabs(ratio - 1)))))
            largest = level.stored + self._over * level.driven / 4
            yield self._bound("sup", error, unit, gain * sqrt(largest) + first, level)
            level = self._always(stored, own, level)
            yield self._bound("sup", error, unit, gain * sqrt(level.stored + level.driven) + first, level)

    def _always(self, stored: StoredErrors, own: StoredError, level: _Level) -> _Level:
        """The second bound of (3) in `dmframe.bounds.stored`, times the largest of 2 / A."""
        try:
            boxed = stored.boxed
        except (NoBoundError, ValueFault, UndecidedError):
            return replace(level, stored=inf)
        rho = ca.vertsplit(2 * ca.SX.ones(own.term.vector.shape[0]) / own.term.weight)
        shares = [(of, max(map(float, _summed(self._box.tops_of_products(x, rho))))) for of, x in boxed.boxes]
        begun = max(map(float, _summed(self._box.tops_of_products(boxed.others, rho)))) if boxed.others else 0.0
        driven = level.driven / (4 * boxed.theta * boxed.rate)
        of, most = max(shares, key=_second, default=(Text(""), 0.0))
        dominating = DISTURBED if driven > most else Share(of, of_start=False)
        return _Level(sum(value for _, value in shares), max(begun, driven), 0.0, dominating)

    def _rms(self, level: _Level, consumer: Part, error: Square, unit: str, rate: float) -> ErrorBound:
        """(2)."""
        begun = [x for term in self._terms if term.block == consumer.block for x in term.elements]
        first = sqrt(2 * self._top(begun))
        value = (level.middle + sqrt(level.stored / self._over + level.driven / 4)) / rate
        return self._bound("rms", error, unit, value + first / sqrt(2 * rate * self._over), level)

    def _sup(self, level: _Level, error: Square, unit: str) -> ErrorBound:
        """(3), with all cascades together: the claim is that of the sum of their storage functions."""
        crossing = [part.certificate.consumes.c for part, _ in self._claim.cross_terms if part.certificate.consumes]
        begun = [x for term in self._terms if term.cascade for x in term.elements]
        drift = self._over * level.driven / 4
        grown = min((level.stored + drift / (1 - r)) / r for r in SPLITS) if drift else level.stored
        weight = float(self._numbers.least(ca.SX(error.weight)))
        value = sqrt(2 * (self._top(begun) + self._top(crossing) * grown) / weight)
        return self._bound("sup", error, unit, value, level)

    def _top(self, elements: Sequence[SX]) -> float:
        """Upper end of a sum of scalars."""
        return float(sum(self._box.tops(elements), Fraction(0)))

    def _bound(self, kind: Kind, error: Square, unit: str, value: float, level: _Level) -> ErrorBound:
        return ErrorBound(error.of, kind, self._over, value * ROUNDED, unit, self._torques, level.dominating)

    def _lag(self, consumer: Part, error: Square) -> float | None:
        """Lambda, if the error moves as de/dt = -lambda e + a with lambda = 1/c, and is all that is stored."""
        cross = consumer.certificate.consumes
        assert cross is not None
        alone = len(consumer.certificate.storage) == 1 and ca.SX(error.weight).is_one()
        if not alone or error.vector.shape != cross.vector.shape:
            return None
        rest = self._claim.flow.unrecorded(error.vector) + error.vector / cross.c - cross.vector
        if not self._symbols.vanishes("lag", rest):
            return None
        return 1 / max(map(float, self._box.tops([cross.c])))


def _at_the_tool(claim: Claim, found: Sequence[ErrorBound]) -> Iterator[ErrorBound]:
    """Distance of the tool from its place at q_d: at most the bound of q - q_d times that of the Jacobian."""
    largest = largest_jacobian(claim.diagram.robot)
    for bound in found:
        if bound.unit == "rad" and largest is not None:
            moved = None if bound.moved is None else largest * bound.moved
            yield replace(bound, signal=TOOL, value=largest * bound.value, unit="m", moved=moved)


def _value(bound: ErrorBound) -> float:
    return bound.value


def _vanishes(expression: SX) -> bool:
    """True if an expression is zero for all values of its symbols."""
    return bool(zero_test(ca.Function("zero", [stack(ca.symvar(expression))], [ca.densify(expression)], TO_READ)).zero)


def _second(pair: tuple[Text, float]) -> float:
    return pair[1]


@final
@dataclass(frozen=True)
class _Level:
    """Upper ends for the servo level: rho S(0), rho delta^2, |m|; and the largest contribution."""

    stored: float
    driven: float
    middle: float
    dominating: Share


def _summed(products: list[list[Fraction]]) -> list[Fraction]:
    """The sum over the elements of a term, for each joint."""
    return [sum(column, Fraction(0)) for column in zip(*products, strict=True)]


def _coefficients(servo: Part, count: int = 0) -> tuple[list[SX], list[SX], list[SX]]:
    """a_i, c_i and W_i as columns, of at least `count` dissipated squares."""
    stated = servo.certificate
    squares = stated.dissipation[: max(len(stated.dominates), len(stated.disturbed), count)]
    ones = ca.SX.ones(squares[0].pieces[0].shape[0])
    columns = [[share * ones for share in shares] for shares in (stated.dominates, stated.disturbed)]
    a, c = ([*items, *[0 * ones] * (len(squares) - len(items))] for items in columns)
    return a, c, [term.weight * ones for term in squares]
