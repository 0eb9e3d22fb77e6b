r"""Proof of asymptotic stability of the linearised sampled loop: Lyapunov inequality in ball arithmetic.

For a symmetric P of exact binary floating-point numbers,

.. math:: P > 0, \qquad P - F^\top P F > 0 \quad\text{for every F in the enclosure}

by L D L' of balls: all eigenvalues of every such F are inside the unit circle. F divided by a radius gives a bound on
the spectral radius.

The result is cross-checked against the linearised loop in floating point and the tick of a run. If they disagree, the
proof is withdrawn.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

import numpy as np
from flint import arb, arb_mat

from dmframe.analysis.enclosed import EnclosedLoop
from dmframe.analysis.linear import Linear, tick_jacobian
from dmframe.analysis.moves import SplitMoves
from dmframe.analysis.period import LONGEST, SHORTEST, Bracket
from dmframe.analysis.set_point import LARGE, MOST, at_rest
from dmframe.common.errors import DisagreementError, DmframeError, EngineError
from dmframe.diagram import Diagram
from dmframe.exact.ball_matrix import exactly, identity, middles, positive_definite, scaled
from dmframe.exact.balls import ball, precise
from dmframe.exact.rounded import Rounded, falls, gram, similar

_REFINED: Final = 6
_DENSE: Final = 80
"""Number of rows above which floating-point balls replace high precision: 0.1 s instead of minutes."""

_NOTHING: Final = 1e-25
_MOST_POWER: Final = 40
"""Threshold of rounding, and limit of the scaling exponent, in balancing: a nilpotent memory has no limit."""

_HOPELESS: Final = 1e-12
_STEPS: Final = 4
_FRACTIONS: Final = (0.9999, 0.999, 0.99, 0.9, 0.5)
"""Tested periods, as fractions of the largest stable one in floating point."""


_ROUNDING: Final = 1e-7
"""Tolerance of a spectral radius in floating point."""

_OTHER: Final = 1e-3
"""Largest difference of two spectral radii of one loop, above the splitting of a multiple eigenvalue."""

_EQUILIBRIUM_TOLERANCE: Final = 1e-3
"""Largest distance between the floating-point and the enclosed equilibrium."""

_INTEGRATED: Final = 1e-2
"""Largest relative difference between the tick of a run and the exact zero-order hold."""


@final
@dataclass(frozen=True)
class StabilityProof:
    """Stability proof of a linearised loop, or the `reason` for its absence.

    Parameters
    ----------
    directions
        Number of moving directions.
    resting
        Number of exact equilibrium coordinates.
    within
        Bound on the distance of the equilibrium from the set-point.
    radius
        Proved bound, at most one, on the spectral radius at the graph's period, without the equilibrium coordinates.
        None without a clock or a proof.
    period
        Longest proved period [s]; the proof does not extend to shorter ones. None without a proof.
    kept
        Number of invariant sums of states, fixed at their values at the set-point.
    disagrees
        True for a proof withdrawn after a cross-check, see `reason`.
    """

    directions: int = 0
    resting: int = 0
    within: float = 0.0
    radius: float | None = None
    period: float | None = None
    reason: str = ""
    kept: int = 0
    disagrees: bool = False


@precise()
def proved_schur(F: arb_mat, radius: arb | None = None) -> bool:
    """Prove that all matrices in the enclosure have a spectral radius below `radius`, by default one."""
    from scipy.linalg import LinAlgWarning, matrix_balance, solve_discrete_lyapunov

    if not F.nrows():
        return True
    F = F if radius is None else F / radius
    numbers = middles(F)
    if not np.max(np.abs(numbers)) < MOST:  # infinite numbers too
        return False
    if len(numbers) > _DENSE:
        return _falls(F)
    _, (sizes, _) = matrix_balance(numbers, permute=False, separate=True)
    powers = [int(power) for power in np.rint(np.log2(sizes))]
    even = scaled(F, [-power for power in powers], powers)
    numbers, one, across = middles(even), identity(len(powers)), even.transpose()
    if (
        not np.max(np.abs(np.linalg.eigvals(numbers))) < 1 - _HOPELESS
    ):  # necessary condition in floating point, saves time
        return False
    P, left = exactly(np.zeros_like(numbers)), np.eye(len(powers))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        for _ in range(_REFINED):  # iterative refinement in floating point
            try:
                more = solve_discrete_lyapunov(numbers.T, left)
            except np.linalg.LinAlgError:
                return False
            if not np.all(np.isfinite(more)):
                return False
            P = P + exactly((more + more.T) / 2)
            left = middles(one - (P - across * P * even))
            left = (left + left.T) / 2
            if np.max(np.abs(left)) < 1e-3 / len(powers):
                break
    return positive_definite(P) and positive_definite(P - across * P * even)


def _falls(F: arb_mat) -> bool:
    """The same for a large matrix in floating-point balls: a power of it, suitably scaled, has a norm below one."""
    from scipy.linalg import matrix_balance

    numbers = middles(F)
    numbers[np.abs(numbers) < _NOTHING] = 0.0
    _, (sizes, _) = matrix_balance(numbers, permute=False, separate=True)
    powers = [int(power) for power in np.clip(np.rint(np.log2(sizes)), -_MOST_POWER, _MOST_POWER)]
    even = Rounded.of(scaled(F, [-power for power in powers], powers))
    P = gram(even.middle)
    if not even.finite or not np.all(np.isfinite(P)):
        return False
    try:
        basis = np.linalg.inv(np.linalg.cholesky(P).T)
    except np.linalg.LinAlgError:
        return False
    moved = similar(even, np.ascontiguousarray(basis))
    return moved is not None and falls(moved)


def prove_stability(
    diagram: Diagram,
    linear: Linear,
    bracket: Bracket,
    clock: float | None,
    *,
    moving: bool = False,
    split: SplitMoves | None = None,
) -> tuple[StabilityProof, SplitMoves | None]:
    """Prove that a linearised loop is stable at its sampling period, and find the longest provable period.

    Returns the proof, and the factorisation of the loop, which is valid for the same loop with other parameter values.

    Parameters
    ----------
    bracket
        Longest stable period in floating point: the search starts below it.
    clock
        The graph's period [s], or None.
    """
    some = clock or bracket.stable or SHORTEST
    try:
        loop = EnclosedLoop(diagram, linear, some, moving=moving, split=split)
        within = loop.at(some).within
        radius = None if clock is None else _proved_radius(loop, clock)
        period = _longest(loop, bracket, clock if radius is not None else None)
        _compare(diagram, linear, loop, clock if radius is not None else None, radius, period, moving)
    except DmframeError as error:
        return StabilityProof(reason=error.text, disagrees=isinstance(error, DisagreementError)), split
    resting = len(linear.states) - loop.moving - loop.kept
    why = _why(linear, loop, clock, radius, period)
    return StabilityProof(loop.moving, resting, within, radius, period, why, loop.kept), loop.split


def _compare(
    diagram: Diagram,
    linear: Linear,
    loop: EnclosedLoop,
    clock: float | None,
    radius: float | None,
    period: float | None,
    moving: bool,
) -> None:
    """Raise `DisagreementError` if floating point or the tick of a run contradict the proof.

    Takes less than a second (two spectral radii and the Jacobian of a tick). For loops of more than `LARGE` states the
    tick is not differentiated.
    """
    proved = [(clock, radius)] if clock is not None and radius is not None else []
    proved += [(period, 1.0)] if period is not None else []
    if not at_rest(linear.drift, linear.point):
        return  # not at an equilibrium: another linearisation
    for own, bound in proved:
        found = linear.spectral_radius(own)
        if not found <= bound + _ROUNDING:
            raise _disagreement(
                own, f"the proved bound of the spectral radius is {bound:.8g}, its floating-point value {found:.8g}"
            )
    if not proved:
        return
    own, _ = proved[0]
    if not loop.at(own).within <= _EQUILIBRIUM_TOLERANCE:
        raise _disagreement(own, f"the enclosed equilibrium is {loop.at(own).within:.2g} from the floating-point one")
    found = linear.spectral_radius(own)
    if linear.at_rest == len(linear.states) - loop.moving - loop.kept:  # otherwise the omitted directions differ
        seen = float(np.max(np.abs(np.linalg.eigvals(middles(loop.transition(own)))), initial=0.0))
        if abs(seen - found) > _OTHER:
            raise _disagreement(
                own, f"the enclosed loop has a spectral radius of {seen:.6g}, the floating-point loop {found:.6g}"
            )
    if len(linear.states) > LARGE:
        return
    tick, Phi = tick_jacobian(diagram, linear.on(own), own, moving=moving), linear.sampled(own)
    missed = float(np.max(np.abs(tick - Phi), initial=0.0) / max(1.0, np.max(np.abs(Phi), initial=0.0)))
    if not missed <= _INTEGRATED:
        raise _disagreement(
            own, f"the slope of the tick of a run differs from that of the linearised loop by {missed:.2g}"
        )


def _disagreement(period: float, text: str) -> DisagreementError:
    return DisagreementError(
        f"the proof is withdrawn: sampled every {period:g} s, {text}; this indicates a defect of dmframe or of a "
        "block, please report it"
    )


def _why(linear: Linear, loop: EnclosedLoop, clock: float | None, radius: float | None, period: float | None) -> str:
    """Reason for a missing bound or period."""
    if period is not None and (clock is None or radius is not None):
        return ""
    if linear.ramp_modes > loop.kept:
        return f"it has {linear.ramp_modes - loop.kept} ramp modes without a restoring term"
    more = linear.at_rest - len(linear.states) + loop.moving + loop.kept
    if more > 0:
        return f"in floating point it has {more} more equilibrium directions, which do not follow from its equations"
    return "it is unstable in floating point" if clock is not None and linear.spectral_radius(clock) >= 1 else ""


def _proved_radius(loop: EnclosedLoop, clock: float) -> float | None:
    """Proved bound below one, slightly above the spectral radius."""
    F = loop.transition(clock)
    if not np.all(np.isfinite(numbers := middles(F))):
        return None
    seen = float(np.max(np.abs(np.linalg.eigvals(numbers)), initial=0.0))
    for fraction in (0.001, 0.1, 0.9):
        bound = float(np.format_float_positional(seen + fraction * (1 - seen), 8))
        if seen < bound < 1 and proved_schur(F, ball(bound)):
            return bound
    return 1.0 if proved_schur(F) else None


def _short(period: float) -> float:
    """Round down to four decimal digits."""
    digits = 3 - math.floor(math.log10(period))
    return float(Fraction(math.floor(Fraction(period) * Fraction(10) ** digits)) / Fraction(10) ** digits)


def _longest(loop: EnclosedLoop, bracket: Bracket, own: float | None) -> float | None:
    """Longest proved period by bisection; for a large loop, search upwards from its own period."""

    def proved(period: float) -> bool:
        try:
            return proved_schur(loop.transition(period))
        except EngineError:
            return False

    lower, upper, steps = 0.0, bracket.stable, _STEPS
    if len(loop.linear.states) > LARGE:
        lower, steps = own or 0.0, 2
        upper = 2 * lower
        while lower and upper <= LONGEST and proved(upper):
            lower, upper = upper, 2 * upper
    else:
        for fraction in _FRACTIONS if bracket.stable else ():
            period = _short(bracket.stable * fraction)
            if proved(period):
                lower = period
                break
            upper = period
    for _ in range(steps if lower and lower < 0.99 * upper <= LONGEST else 0):
        middle = _short((lower + upper) / 2)
        lower, upper = (middle, upper) if proved(middle) else (lower, middle)
    return lower or None


__all__ = ["StabilityProof", "prove_stability", "proved_schur"]
