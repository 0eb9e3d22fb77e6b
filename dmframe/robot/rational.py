r"""Exactly orthogonal rational rotations that approximate the rounded ones of a robot file.

A URDF's rotations are orthogonal only up to rounding, so identities such as the skew symmetry of
:math:`\dot M - 2 C` fail exactly. Rotations of rational quaternions and axes from the rational
stereographic projection satisfy :math:`R^\top R = I` and :math:`a^\top a = 1` in exact arithmetic.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = tuple[Fraction, ...]
Matrix = tuple[Vector, ...]

# A quarter turn with ten digits counts as exact (the UR10's file is 4.9e-12 off); 1.5708 does not.
SNAP = 1e-10
# Half the width of the interval for the simplest fraction of a ratio: the rounding of a double near 1.
HALF_WIDTH = Fraction(1, 2 * 10**15)


def simplest_between(low: Fraction, high: Fraction) -> Fraction:
    """Fraction of least denominator in [low, high], by descent in the Stern-Brocot tree."""
    if low <= 0 <= high:
        return Fraction(0)
    if high < 0:
        return -simplest_between(-high, -low)
    whole = -(-low.numerator // low.denominator)
    if whole <= high:
        return Fraction(whole)
    floor = whole - 1
    return floor + 1 / simplest_between(1 / (high - floor), 1 / (low - floor))


def simplest_near(value: float) -> Fraction:
    """Simplest fraction within 5e-16 of `value`."""
    exact = Fraction(value)
    return simplest_between(exact - HALF_WIDTH, exact + HALF_WIDTH)


def rational_rotation(R: NDArray[Any]) -> Matrix:
    r"""Rotation of a rational quaternion close to `R`: :math:`R^\top R = I` and :math:`\det R = 1` exactly.

    With the quaternion :math:`(w, v)` divided by its largest component and each ratio made rational,

    .. math:: R = \frac{(w^2 - v^\top v) I + 2 v v^\top + 2 w [v]_\times}{w^2 + v^\top v}

    Parameters
    ----------
    R : (3, 3)
        A rotation up to rounding. Within 1e-10 of a signed permutation (quarter turns about the axes), that is
        returned.
    """
    nearest = np.rint(R)
    if np.max(np.abs(R - nearest)) < SNAP:
        return tuple(tuple(Fraction(int(entry)) for entry in row) for row in nearest)
    w, x, y, z = (simplest_near(ratio) for ratio in _quaternion(np.asarray(R, dtype=float)))
    norm = w * w + x * x + y * y + z * z
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return tuple(tuple(entry / norm for entry in row) for row in rows)


def _quaternion(R: NDArray[Any]) -> NDArray[Any]:
    """(w, x, y, z) of a rotation divided by its largest component, free of cancellation (Shepperd)."""
    w, x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], np.trace(R)
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    candidates = (
        np.array([1 + z, w, x, y]),
        np.array([w, 1 + 2 * R[0, 0] - z, xy, xz]),
        np.array([x, xy, 1 + 2 * R[1, 1] - z, yz]),
        np.array([y, xz, yz, 1 + 2 * R[2, 2] - z]),
    )
    largest = int(np.argmax([candidate[i] for i, candidate in enumerate(candidates)]))
    ratios: NDArray[Any] = candidates[largest] / candidates[largest][largest]
    return ratios


def rational_axis(a: NDArray[Any]) -> Vector:
    r"""Rational unit vector close to `a`.

    Stereographic projection from the pole opposite to the largest component, here the third:
    :math:`a = (2u, 2v, 1 - u^2 - v^2) / (1 + u^2 + v^2)` with rational :math:`u, v`.

    Parameters
    ----------
    a : (3,)
        A unit vector up to rounding. Within 1e-10 of a coordinate axis, that axis is returned.
    """
    nearest = np.rint(a)
    if np.max(np.abs(a - nearest)) < SNAP:
        return tuple(Fraction(int(entry)) for entry in nearest)
    unit = np.asarray(a, dtype=float) / np.linalg.norm(a)
    pole = int(np.argmax(np.abs(unit)))
    sign = 1 if unit[pole] > 0 else -1
    plane = [simplest_near(float(entry) / (1 + abs(unit[pole]))) for entry in unit]
    plane[pole] = Fraction(0)
    square = sum((entry * entry for entry in plane), Fraction(0))
    axis = [2 * entry / (1 + square) for entry in plane]
    axis[pole] = sign * (1 - square) / (1 + square)
    return tuple(axis)


def decimal(value: float) -> Fraction:
    """Rational number of the shortest decimal of `value`: 153/250 for 0.612; float() recovers `value`."""
    return Fraction(repr(float(value)))
