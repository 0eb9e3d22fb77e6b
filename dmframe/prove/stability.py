"""Stability of numeric matrices, and of z'' + a z' + b z = 0 for all a and b in given intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from itertools import product

from dmframe.exact.rational import as_float
from dmframe.prove.definite import Number, lower, upper

Corners = Sequence[tuple[Fraction, Fraction]]
Range = tuple[Fraction, Fraction]

STEPS = 50
"""Number of steps of the searches; each narrows its interval by a third or a half."""


def is_stable_matrix(A: Sequence[Sequence[Number]]) -> bool:
    """Stability of a 1 x 1 or 2 x 2 matrix of numbers or intervals.

    1 x 1: A < 0 at its upper end. 2 x 2 of numbers: trace A < 0 and det A > 0. 2 x 2 of intervals: a companion form
    [[0, 1], [-b, -a]] with a common Lyapunov matrix for all corners of the box.
    """
    if len(A) == 1:
        return upper(A[0][0]) < 0
    if len(A) != 2:
        return False
    ends = [[(lower(x), upper(x)) for x in row] for row in A]
    if all(low == high for row in ends for low, high in row):
        (a, b), (c, d) = [[low for low, _ in row] for row in ends]
        return a + d < 0 and a * d - b * c > 0
    companion = [low for low, _ in ends[0]] == [high for _, high in ends[0]] == [0, 1]
    (b_low, b_high), (a_low, a_high) = ends[1]
    return companion and common_margin((-a_high, -a_low), (-b_high, -b_low)) > 0


@cache
def common_margin(a: Range, b: Range) -> Fraction:
    r"""Margin of :math:`A^\top P + P A < 0` at the worst corner, for the best P = [[x, y], [y, 1]] found.

    With :math:`A = [[0, 1], [-b, -a]]` it is [[-2 y b, x - y a - b], [., 2 y - 2 a]]. The largest eigenvalue of a
    symmetric [[r, s], [s, t]] is below -m iff r + m < 0 and (r + m)(t + m) > s^2: decided in rational numbers, with m
    found by bisection. A positive margin proves stability; zero means that no P exists, or that the search found none.
    """
    corners = list(product(a, b))
    return max((_margin(P, corners) for P in _candidates(corners)), default=Fraction(0))


def _margin(P: tuple[Fraction, Fraction], corners: Corners) -> Fraction:
    low, high = Fraction(0), Fraction(1)
    if P[0] <= P[1] * P[1] or not _negative(P, corners, low):
        return low
    while _negative(P, corners, high):
        high *= 2
    for _ in range(STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if _negative(P, corners, middle) else (low, middle)
        if low > 0 and high - low < low / 2**20:
            break
    return low


def _negative(P: tuple[Fraction, Fraction], corners: Corners, m: Fraction) -> bool:
    x, y = P
    for a, b in corners:
        r, s, t = -2 * y * b + m, x - y * a - b, 2 * y - 2 * a + m
        if not (r < 0 and r * t > s * s):
            return False
    return True


def _candidates(corners: Corners) -> list[tuple[Fraction, Fraction]]:
    """Candidates for P: the centre of the admissible interval, and the largest margin that a search finds.

    For a given y, x must lie within sqrt(4 y b (a - y)) of y a + b at each corner. The width of the admissible interval
    is concave in y, so that a ternary search finds its maximum, and no P if there is none.
    """
    if any(a <= 0 or b <= 0 for a, b in corners):
        return []
    points = [(as_float(a), as_float(b)) for a, b in corners]
    if not all(0 < number < math.inf for point in points for number in point):
        return []  # beyond the range of floats
    top = min(a for a, _ in points)
    widest = _ternary_search(lambda y: _width(y, points)[0], 0.0, top)
    width, middle = _width(widest, points)
    if width <= 0:
        return []
    best = _ternary_search(lambda y: -_worst(_best_x(y, points), y, points), 0.0, top)
    pairs = [(middle, widest), (_best_x(best, points), best)]
    return [(Fraction(x), Fraction(y)) for x, y in pairs]


def _width(y: float, points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Width and centre of the admissible interval of x."""
    reaches = [(y * a + b, 2 * math.sqrt(max(0.0, y * b * (a - y)))) for a, b in points]
    lower, upper = max(x - r for x, r in reaches), min(x + r for x, r in reaches)
    return upper - lower, (lower + upper) / 2


def _best_x(y: float, points: Sequence[tuple[float, float]]) -> float:
    ends = [y * a + b for a, b in points]
    return _ternary_search(lambda x: -_worst(x, y, points), min(ends), max(ends))


def _worst(x: float, y: float, points: Sequence[tuple[float, float]]) -> float:
    """The largest eigenvalue at any corner; convex in (x, y)."""
    return max(y - a - y * b + math.hypot(y - a + y * b, x - y * a - b) for a, b in points)


def _ternary_search(f: Callable[[float], float], low: float, high: float) -> float:
    """Maximiser of a concave function by ternary search."""
    for _ in range(STEPS):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        low, high = (low, right) if f(left) > f(right) else (left, high)
    return (low + high) / 2
