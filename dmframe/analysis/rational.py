"""Rational transfer functions of one joint, with exact structural zeros, and a test of positive realness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NOTHING: Final = 1e-10
"""Size of a Krylov direction's new component, relative to the matrix, below which it is zero."""
_AXIS: Final = 1e-9


@final
@dataclass(frozen=True)
class Rational:
    """Transfer function num(s) / den(s): coefficients from the highest power down, den monic."""

    num: Array
    den: Array

    def at(self, s: Any) -> Any:
        """Value at s."""
        return np.polyval(self.num, s) / np.polyval(self.den, s)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Roots of the denominator."""
        return np.asarray(np.roots(self.den), dtype=complex)

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Roots of the numerator."""
        return np.asarray(np.roots(self.num), dtype=complex)

    def scaled(self, factor: float) -> Rational:
        """Transfer function times a factor."""
        return Rational(self.num * factor, self.den)

    def system(self) -> Any:
        """Equivalent `control.TransferFunction`."""
        import control

        return control.TransferFunction(self.num, self.den)


def transfer(A: Array, b: Array, c: Array, d: float) -> Rational:
    r""":math:`c (sI - A)^{-1} b + d` of the minimal part, by the Leverrier-Faddeev recursion.

    Uncontrollable and unobservable modes, such as those of a servo under its exact inverse, are projected out first:
    cancelling their poles with zeros afterwards is ill-conditioned for close roots.
    """
    from scipy.linalg import matrix_balance

    if len(A):
        A, (scale, _) = matrix_balance(A, permute=False, separate=True)
        b, c = b / scale, c * scale
    for _ in range(2):  # first the controllable part, then, transposed, the observable one
        Q = _krylov(A, b)
        A, b, c = (Q.T @ A @ Q).T, Q.T @ c, Q.T @ b
    n = len(A)
    den, top, N = [1.0], [0.0], np.eye(n)
    for k in range(1, n + 1):
        top.append(float(c @ N @ b))
        den.append(-float(np.trace(A @ N)) / k)
        N = A @ N + den[-1] * np.eye(n)
    return Rational(_clean(np.array(top) + d * np.array(den), strip=True), _clean(np.array(den)))


def _krylov(A: Array, b: Array) -> Array:
    """Orthonormal basis, as columns, of the span of b, A b, A^2 b, ..."""
    Q = np.zeros((len(b), 0))
    new, size = b, float(np.linalg.norm(b))
    while Q.shape[1] < len(b):
        rest = new - Q @ (Q.T @ new)
        rest -= Q @ (Q.T @ rest)  # once more, against rounding
        length = float(np.linalg.norm(rest))
        if length <= _NOTHING * size:
            break
        Q = np.column_stack([Q, rest / length])
        new = A @ Q[:, -1]
        size = float(np.linalg.norm(A))
    return Q


def _clean(p: Array, *, strip: bool = False) -> Array:
    """Polynomial with rounding errors set to zero; `strip` removes leading zeros."""
    kept = np.where(np.abs(p) > 1e-12 * float(np.max(np.abs(p), initial=0.0)), p, 0.0)
    return np.trim_zeros(kept, "f") if strip and kept.any() else kept


@final
@dataclass(frozen=True)
class Passivity:
    """Positive realness (passivity) of a transfer function: least Re H(jw), and its frequency [rad/s]."""

    holds: bool
    least: float
    frequency: float


def passivity(H: Rational) -> Passivity:
    r"""Test positive realness: no poles right of the axis, simple ones with positive residue on it, and Re H(jw) >= 0.

    Re H(jw) is a rational function of w^2, so its minimum is among finitely many candidate frequencies.
    """
    top, bottom = _real_part(H)
    slope: Array = np.polysub(np.polymul(np.polyder(top), bottom), np.polymul(top, np.polyder(bottom)))
    roots = np.roots(slope)
    points = [float(r.real) for r in roots if abs(r.imag) < 1e-9 * (1 + abs(r)) and r.real > 0]
    limits = [(_low(top, bottom), 0.0), (_low(top[::-1], bottom[::-1]), np.inf)]
    inner = [(float(np.polyval(top, x) / np.polyval(bottom, x)), float(np.sqrt(x))) for x in points if x > 0]
    least, frequency = min([*limits, *inner])
    size = max(abs(value) for value, _ in [*limits, *inner] if np.isfinite(value)) if inner or limits else 0.0
    return Passivity(least >= -1e-9 * max(size, 1e-300) and _axis_poles_passive(H), least, frequency)


def _real_part(H: Rational) -> tuple[Array, Array]:
    """Numerator and denominator of Re H(jw) as polynomials of w^2 with equal lengths."""
    mirrored = _mirrored(H.den)
    top, bottom = _of_square(np.convolve(H.num, mirrored)), _of_square(np.convolve(H.den, mirrored))
    size = max(len(top), len(bottom))
    return np.pad(top, (size - len(top), 0)), np.pad(bottom, (size - len(bottom), 0))


def _mirrored(p: Array) -> Array:
    """p(-s)."""
    return np.asarray(p * (-1.0) ** np.arange(len(p) - 1, -1, -1))


def _of_square(p: Array) -> Array:
    """The even part of p at s = jw, as a polynomial of w^2."""
    even = p[::-1][::2]
    return np.asarray((even * (-1.0) ** np.arange(len(even)))[::-1])


def _low(top: Array, bottom: Array) -> float:
    """Limit of top / bottom at zero, where both may vanish."""
    t, b = list(top[::-1]), list(bottom[::-1])
    size_t, size_b = max(map(abs, t)), max(map(abs, b))
    while len(b) > 1 and abs(b[0]) <= 1e-14 * size_b:
        if t and abs(t[0]) > 1e-14 * size_t:
            return float(np.copysign(np.inf, t[0] * next(x for x in b if abs(x) > 1e-14 * size_b)))
        t, b = t[1:], b[1:]
    return float(t[0] / b[0]) if t else 0.0


def _axis_poles_passive(H: Rational) -> bool:
    poles = H.poles
    if len(H.num) > len(H.den) + 1:
        return False
    for pole in poles:
        scale = _AXIS ** (1 / 2) * (1 + abs(pole))
        if pole.real > scale:
            return False
        if abs(pole.real) <= scale:
            others = np.abs(poles - pole) <= scale
            residue = np.polyval(H.num, pole) / np.polyval(np.polyder(H.den), pole)
            if others.sum() > 1 or residue.real < 0 or abs(residue.imag) > 1e-6 * abs(residue):
                return False
    return True
