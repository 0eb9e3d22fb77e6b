"""The conditions of a claim, each decided exactly at the graph's own numbers, or over its intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX, Assumption, CommonLyapunov, Inequality, Square
from dmframe.certify.claim import Claim, Part
from dmframe.certify.symbols import exact_values
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.model import hashes, symbols_in
from dmframe.diagram.view import view
from dmframe.errors import ValueFault
from dmframe.exact.rational import Interval, evaluate
from dmframe.port import Side

Number = Fraction | Interval


@final
@dataclass(frozen=True)
class Checked:
    """A condition with its margin.

    Parameters
    ----------
    value
        The least value that must be positive; the margin. None where it could not be computed.
    how
        How it was decided, ``exact`` or ``sampled``.
    """

    name: str
    expression: str
    value: float | None
    holds: bool
    source: str
    how: str = "exact"


@final
@dataclass(frozen=True)
class Kappa:
    """The weight of the servo level: above `least`, the servo level pays for the cascade; `chosen` is twice that."""

    least: Fraction
    chosen: Fraction


def conditions_of(claim: Claim, uncertain: Mapping[str, Sequence[Interval]]) -> tuple[list[Checked], list[Assumption]]:
    """Everything that the theorem needs and that numbers can decide; and what is left to assume."""
    numbers = Numbers(claim, uncertain)
    checked, assumed = list[Checked](), list[Assumption]()
    for name, block in claim.diagram.blocks.items():
        if block.side is Side.SOURCE:
            continue
        seen = view(claim.diagram, name, claim.truths)
        for condition in block.conditions(seen.p, seen.truth):
            if isinstance(condition, Assumption):
                assumed.append(condition)
            elif isinstance(condition, CommonLyapunov):
                checked.append(_stable(name, condition, numbers))
            else:
                checked.append(_inequality(name, condition, numbers))
    checked += _weights(claim, numbers)
    checked += _boxes(claim, numbers)
    checked += _physical(claim)
    if claim.cascaded:
        checked.append(_payment(claim, numbers))
    return checked, assumed


@final
class Numbers:
    """Exact values of expressions in parameters alone, at the graph's numbers or over its intervals."""

    def __init__(self, claim: Claim, uncertain: Mapping[str, Sequence[Interval]]) -> None:
        self.claim = claim
        values: dict[str, Sequence[Number]] = dict(exact_values(claim.diagram))
        self.values = values | dict(uncertain)
        self._p = claim.loop.parameters

    def of(self, expression: SX) -> list[Number]:
        """The elements of an expression, dense; raises `ValueFault` where it needs more than parameters."""
        joined = ca.vec(ca.densify(self.claim.loop.joined([ca.SX(expression)])[0]))
        function = ca.Function("value", [stack([p.symbol]) for p in self._p], [joined], {"allow_free": True})
        if function.has_free():
            raise ValueFault(f"expected an expression in parameters alone, found {function.get_free()}")
        return evaluate(function, [self.values[p.label] for p in self._p])[0]

    def least(self, expression: SX) -> Fraction:
        """The least element; of an interval, its lower end."""
        return min((lower(value) for value in self.of(expression)), default=Fraction(1))


def lower(value: Number) -> Fraction:
    """The least that a number can be."""
    return value.lower if isinstance(value, Interval) else value


def upper(value: Number) -> Fraction:
    """The most that a number can be."""
    return value.upper if isinstance(value, Interval) else value


def _inequality(name: str, condition: Inequality, numbers: Numbers) -> Checked:
    least = numbers.least(condition.expression)
    holds = least > 0 if condition.strict else least >= 0
    return Checked(f"{name}: {condition.name}", condition.name, float(least), holds, condition.source)


def _weights(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """Every square of V and of the dissipation has a positive weight; a matrix (M) is decided by `_physical`."""
    for part in claim.parts:
        for role, terms in (("V", part.certificate.storage), ("dV/dt", part.certificate.dissipation)):
            for term in terms:
                if isinstance(term, Square) and term.weight.is_column():
                    least = numbers.least(term.weight)
                    text = f"weight of |{term.of}|^2 in {role} > 0"
                    yield Checked(f"{part.block}: {text}", text, float(least), least > 0, "V is positive, dV/dt not")


def _boxes(claim: Claim, numbers: Numbers) -> Iterator[Checked]:
    """A projection needs the true value in its box; so does the start, or it would jump."""
    for projection in claim.loop.projections:
        own = hashes(projection.state)
        for part in claim.parts:
            for square in part.certificate.storage:
                if symbols_in([square.vector]) & own:
                    zero = ca.SX.zeros(projection.state.shape[0])
                    truth = -ca.substitute(square.vector, projection.state, zero)
                    room = ca.vertcat(truth - projection.lower, projection.upper - truth)
                    least = numbers.least(room)
                    name = f"{projection.name}: true value inside the box"
                    yield Checked(name, "lower <= true value <= upper", float(least), least >= 0, "Remark 2")


def payment(claim: Claim, numbers: Numbers) -> Kappa | None:
    """Kappa from c |sigma|^2 <= kappa (|v_1|^2_W1 + ...) with sigma = a_1 v_1 + ...: c sum a_j^2 / W_j, by Cauchy."""
    payers = [part for part in claim.parts if part.certificate.sigma]
    if len(payers) != 1:
        return None
    (part,) = payers
    shares = zip(part.certificate.sigma, part.certificate.dissipation, strict=True)
    c = sum((other.certificate.consumes for other in claim.parts if other.certificate.consumes is not None), ca.SX(0))
    ones = ca.SX.ones(claim.sigma.shape[0])
    need = sum((share * share * ones / _weight(term) for share, term in shares), ca.SX(0)) * c
    try:
        least = max(upper(value) for value in numbers.of(need))
    except ZeroDivisionError:
        return None
    positive = all(numbers.least(_weight(term)) > 0 for term in part.certificate.dissipation)
    return Kappa(least, 2 * least) if positive else None


def _weight(term: Any) -> SX:
    return term.weight


def _payment(claim: Claim, numbers: Numbers) -> Checked:
    kappa = payment(claim, numbers)
    name = "the servo level pays for the cascade: some kappa > 0 exists"
    value = float(kappa.least) if kappa else None
    return Checked(name, "kappa >= c sum_j a_j^2 / W_j", value, kappa is not None, "composition of storage functions")


def _stable(name: str, condition: CommonLyapunov, numbers: Numbers) -> Checked:
    a, b = (_rows(numbers.of(box), box.shape[0]) for box in (condition.a, condition.b))
    margins = [common_margin(corners, rates) for corners, rates in zip(a, b, strict=True)]
    least = min(margins)
    text = "A'P + P A < 0 at the four corners of the box, one P > 0"
    return Checked(f"{name}: {condition.name}", text, float(least), least > 0, condition.source)


def _rows(values: Sequence[Number], rows: int) -> list[tuple[Fraction, Fraction]]:
    return [(lower(values[row]), upper(values[rows + row])) for row in range(rows)]


def common_margin(a: tuple[Fraction, Fraction], b: tuple[Fraction, Fraction]) -> Fraction:
    r"""How negative :math:`A^\top P + P A` is, at its worst corner, for the best P = [[x, y], [y, 1]] found.

    The largest eigenvalue of a symmetric [[r, s], [s, t]] is below -m iff r + m < 0 and (r + m)(t + m) > s^2: decided
    in rational numbers, with m found by bisection; positive m proves stability, none found proves nothing.
    """
    corners = list(product(a, b))
    x, y = _search(np.array([[float(u), float(v)] for u, v in corners]))
    P = (Fraction(x).limit_denominator(10**6), Fraction(y).limit_denominator(10**6))
    if P[0] - P[1] * P[1] <= 0:
        return Fraction(0)
    low, high = Fraction(0), Fraction(16)
    if not _negative(P, corners, low):
        return Fraction(0)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if _negative(P, corners, middle) else (low, middle)
    return low


def _search(corners: np.ndarray) -> tuple[float, float]:
    """P that makes the worst corner's largest eigenvalue least; a plain search in two numbers is enough."""
    from scipy.optimize import minimize

    def worst(z: np.ndarray) -> float:
        x, y = z
        lyapunov = [np.array([[-2 * y * b, x - y * a - b], [x - y * a - b, 2 * y - 2 * a]]) for a, b in corners]
        definite = np.linalg.eigvalsh([[x, y], [y, 1]])[0]
        return float(max(*(np.linalg.eigvalsh(L)[1] for L in lyapunov), -1e3 * min(0.0, definite)))

    a, b = corners.mean(axis=0)
    starts = [(b + a * y, y) for y in (0.1 * a, 0.3 * a, 0.6 * a)]
    options = {"maxiter": 2000, "xatol": 1e-9, "fatol": 1e-12}
    found = [minimize(worst, start, method="Nelder-Mead", options=options) for start in starts]
    best = min(found, key=lambda result: result.fun)
    return float(best.x[0]), float(best.x[1])


def _negative(P: tuple[Fraction, Fraction], corners: Sequence[tuple[Fraction, Fraction]], m: Fraction) -> bool:
    x, y = P
    for a, b in corners:
        r, s, t = -2 * y * b + m, x - y * a - b, 2 * y - 2 * a + m
        if not (r < 0 and r * t > s * s):
            return False
    return True


def _physical(claim: Claim) -> Iterator[Checked]:
    """M(q) > 0: exactly, if each link's inertia is that of some mass distribution; else at sampled poses."""
    matrices = [part for part in claim.parts for term in part.certificate.storage if not term.weight.is_column()]
    if not matrices:
        return
    robot = claim.diagram.robot
    if robot is not None and all(_is_body(row) for row in robot.inertia):
        least = min(min(pivots(pseudo_inertia(row))) for row in robot.inertia)
        text = "each link's pseudo-inertia is positive definite"
        yield Checked("M(q) > 0", text, float(least), True, "property P2")
        return
    least_sampled = _sampled_mass(claim, matrices[0])
    text = "least eigenvalue of M(q) at 200 sampled poses > 0; not every link is a physical body"
    yield Checked("M(q) > 0", text, least_sampled, least_sampled > 0, "property P2", "sampled")


def _is_body(row: Sequence[Fraction]) -> bool:
    found = pivots(pseudo_inertia(row))
    return len(found) == 4 and found[-1] > 0


def pseudo_inertia(row: Sequence[Fraction]) -> list[list[Fraction]]:
    r"""[[tr(I)/2 1 - I, h], [h', m]] of ten inertial parameters [Wensing2018]_."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = row
    half = (xx + yy + zz) / 2
    return [[half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m]]


def pivots(matrix: Sequence[Sequence[Fraction]]) -> list[Fraction]:
    """The diagonal of LDL' in rational numbers, up to the first pivot that is not positive."""
    rows = [list(row) for row in matrix]
    found = list[Fraction]()
    for j in range(len(rows)):
        pivot = rows[j][j]
        found.append(pivot)
        if pivot <= 0:
            break
        for i in range(j + 1, len(rows)):
            factor = rows[i][j] / pivot
            rows[i] = [above - factor * below for above, below in zip(rows[i], rows[j], strict=True)]
    return found


def _sampled_mass(claim: Claim, part: Part) -> float:
    loop = claim.loop
    (weight,) = (term.weight for term in part.certificate.storage if not term.weight.is_column())
    function = ca.Function("M", [loop.state, loop.p], [weight])
    rng = np.random.default_rng(0)
    states = rng.uniform(-np.pi, np.pi, (200, loop.state.numel()))
    return min(float(np.linalg.eigvalsh(function(state, loop.p_values).full())[0]) for state in states)
