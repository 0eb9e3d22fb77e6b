"""Least gain K_c of the feedback correction of the reference in a PID inverse."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.certify.symbols import exact_values
from dmframe.common.errors import ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.view import view
from dmframe.exact.rational import Interval, evaluate
from dmframe.robot.rational import decimal

GAIN: Final = "K_c"
GAINS: Final = ("K_D", "K_P", "K_I", "B", "K")
DIGITS: Final = 4
"""Significant digits to which a least K_c is rounded upwards."""

Gain = float | Fraction | tuple[float, float] | Interval
"""Number, or lower and upper end of its interval."""


@final
@dataclass(frozen=True)
class ReferenceGain:
    """K_c of one joint, and the least K_c with M_bar >= 0, rounded upwards [1/s].

    Parameters
    ----------
    block
        The PID inverse.
    own
        K_c of the graph.
    holds
        True if M_bar >= 0 for `own`, decided exactly; `own` may lie between the root and `least`, its rounding.
    least
        Least K_c with the lower bound of viscous friction in the graph, and the motor constant.
    least_without_friction
        Least K_c for B = 0, as in Remark 5 of [WangTAC2020]_; never below `least`.
    """

    block: str
    joint: str
    own: Fraction
    holds: bool
    least: Fraction
    least_without_friction: Fraction


def least_K_c(
    K_D: Gain, K_P: Gain, K_I: Gain, *, B: Gain = Fraction(0), K: Gain = Fraction(1), digits: int = DIGITS
) -> Fraction:
    r"""Least K_c of one joint with M_bar >= 0 for all gains of the servo in their intervals.

    .. math::

        \bar M(k) &= (K_D + B/K) k + K_P - K_I/k                                             \tag{1} \\
        \bar M(k) \ge 0 &\iff k \ge k_\star = \frac{2 K_I}{K_P + \sqrt{K_P^2 + 4 K_I (K_D + B/K)}}  \tag{2}

    One corner of the box of gains suffices: for k > 0

    .. math::

        \partial \bar M / \partial K_D = k > 0, \quad \partial \bar M / \partial K_P = 1 > 0, \quad
        \partial \bar M / \partial B = k/K > 0, \quad
        \partial \bar M / \partial K = -B k/K^2 \le 0, \quad \partial \bar M / \partial K_I = -1/k < 0,

    each of one sign over the whole box. For every k, M_bar is therefore least at the same corner: K_D, K_P and B at
    their lower ends, K_I and K at their upper ends. There :math:`k^2 (K_D + B/K) + k K_P - K_I` increases with k > 0
    and has one positive root, (2), since its last coefficient is negative: every smaller k fails at that corner, every
    larger k is valid in the whole box.

    The root is irrational in general. Rational arithmetic brackets it and rounds upwards, so the printed result
    satisfies M_bar >= 0 when copied into a graph; one unit less in its last digit does not.

    Parameters
    ----------
    K_D, K_P, K_I
        Gains of the PID servo [V s/rad, V/rad, V/(rad s)], > 0. They may all be multiplied by one factor, such as K,
        together with B/K.
    B
        Viscous friction [N m s/rad], >= 0. Zero is conservative, as in Remark 5.
    K
        Motor constant [N m/V], > 0.
    digits
        Number of significant digits of the result.

    Raises
    ------
    ValueFault
        A gain is not positive, or an interval is empty.

    References
    ----------
    [WangTAC2020]_ Remark 5.
    """
    if digits < 1:
        raise ValueFault(f"digits: expected at least 1, found {digits}")
    return _worst(K_D, K_P, K_I, B, K).root_rounded_up(digits)


@final
@dataclass(frozen=True)
class _Worst:
    """M_bar at its worst corner, times k: a k^2 + b k - c with a, b, c > 0."""

    a: Fraction
    b: Fraction
    c: Fraction

    def holds(self, k: Fraction) -> bool:
        """True if M_bar >= 0 for this K_c > 0, that is if k is not below the root."""
        return k > 0 and (self.a * k + self.b) * k >= self.c

    def root_rounded_up(self, digits: int) -> Fraction:
        """Least number with so many significant digits for which M_bar >= 0."""
        power = Fraction(1)
        while self.holds(power):
            power /= 10
        while not self.holds(10 * power):  # the root lies above `power`, and not above ten times it
            power *= 10
        first: int = 10 ** (digits - 1)
        unit = power / first
        above = bisect_left(range(first, 10 * first), True, key=lambda n: self.holds(n * unit))
        return (first + above) * unit


def _worst(K_D: Gain, K_P: Gain, K_I: Gain, B: Gain, K: Gain) -> _Worst:
    """Corner of the box of gains at which M_bar is least, for every K_c."""
    positive = {"K_D": K_D, "K_P": K_P, "K_I": K_I, "K": K}
    box = {name: _interval(name, gain, positive=True) for name, gain in positive.items()}
    friction = _interval("B", B, positive=False)
    return _Worst(box["K_D"].lower + friction.lower / box["K"].upper, box["K_P"].lower, box["K_I"].upper)


def _interval(name: str, gain: Gain, *, positive: bool) -> Interval:
    if isinstance(gain, Interval):
        found = gain
    elif isinstance(gain, tuple):
        found = Interval(decimal(gain[0]), decimal(gain[1]))
    else:
        found = Interval.of(gain if isinstance(gain, Fraction) else decimal(gain))
    if found.upper < found.lower:
        raise ValueFault(f"{name}: expected [lower, upper], found {float(found.lower):g} above {float(found.upper):g}")
    if found.lower < 0 or (positive and found.lower == 0):
        bound = "> 0" if positive else ">= 0"
        raise ValueFault(f"{name}: expected a gain {bound}, found {float(found.lower):g}")
    return found


def reference_gains(
    diagram: Diagram, uncertain: Mapping[str, Sequence[Interval]] | None = None
) -> tuple[ReferenceGain, ...]:
    """K_c of each PID inverse and its least admissible value for the servo, by joint.

    A PID inverse is a block with a parameter K_c whose certificate reads K_D, K_P, K_I, B and K of the plant.

    Parameters
    ----------
    uncertain
        Intervals of the plant's parameters, ``{"servo.K_D": [Interval, ...]}``: see the graph key ``uncertain`` and
        `dmframe.certify.uncertain.intervals`. Other parameters have the values of the graph.
    """
    return tuple(gain for name in diagram.blocks for gain in _gains_of(diagram, name, uncertain or {}))


def _gains_of(diagram: Diagram, name: str, uncertain: Mapping[str, Sequence[Interval]]) -> Iterator[ReferenceGain]:
    model = diagram.models[name]
    if GAIN not in model.parameters or not {*GAINS} <= {port.name for port in model.block.truth}:
        return
    seen = view(diagram, name)
    if not all(gain in seen.truth for gain in GAINS):
        return
    n = model.parameters[GAIN].shape[0]
    symbols = [getattr(seen.p, GAIN), *(getattr(seen.truth, gain) for gain in GAINS)]
    spread = [ca.SX.ones(n) * expression for expression in symbols]
    own, *gains = _values(diagram, spread, uncertain)
    names = diagram.robot.joint_names if diagram.robot is not None else tuple(f"joint {j + 1}" for j in range(n))
    for joint, k, *gains_of_joint in zip(names, own, *gains, strict=True):
        K_D, K_P, K_I, B, K = gains_of_joint
        K_c = Interval.of(k).lower  # a controller gain, so never an interval
        yield ReferenceGain(
            block=name,
            joint=joint,
            own=K_c,
            holds=_worst(K_D, K_P, K_I, B, K).holds(K_c),
            least=least_K_c(K_D, K_P, K_I, B=B, K=K),
            least_without_friction=least_K_c(K_D, K_P, K_I),
        )


def _values(
    diagram: Diagram, expressions: Sequence[SX], uncertain: Mapping[str, Sequence[Interval]]
) -> list[list[Fraction | Interval]]:
    """Values of column expressions in parameters, at the graph's numbers or over their intervals."""
    parameters = diagram.loop.parameters
    known: dict[str, Sequence[Fraction | Interval]] = dict(exact_values(diagram))
    known |= dict(uncertain)
    columns = [ca.densify(column) for column in diagram.loop.joined(list(expressions))]
    function = ca.Function("gains", [stack([p.symbol]) for p in parameters], columns)
    return evaluate(function, [known[p.label] for p in parameters])
