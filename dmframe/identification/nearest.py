r"""The fit whose robot can be built: of all base parameters of physical bodies, those nearest to the fitted ones.

The motion of a stiff servo with large rotors hardly shows the links. The fitted base parameters :math:`\beta` may then
lie outside of the convex set :math:`\{G x : P_l(x) \succeq 0, x_r \ge 0\}` of all bodies, with the pseudo-inertia
:math:`P_l` of link l (Wensing, Kim, Slotine 2018) and rotors :math:`x_r`. With the covariance C of the fit, whose scale
of all torques is held,

.. math:: \min_x \; (G x - \beta)^T C_{\beta\beta}^{-1} (G x - \beta), \qquad
          \theta' = \theta + C_{\theta\beta} C_{\beta\beta}^{-1} (G x - \beta)

is the constrained maximum of the likelihood, approximated to second order. The constraint is kept by
:math:`P_l = L_l L_l^T + \epsilon I, x_r = s^2`.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Final

import numpy as np

from dmframe.identification.model import Array
from dmframe.identification.pseudo_inertia import pseudo_inertia
from dmframe.identification.unknowns import Unknowns

LEAST: Final = (1e-4, 1e-6)
"""Least eigenvalue of a pseudo-inertia, relative to the largest one of the robot's file: of the nearest bodies, and of
bodies with their base parameters, which are then inside of the set."""
WEAK: Final = 1e-2
"""Weight of the deviation from the robot's file, in its prior deviations, which determines what the motion does not."""
EXACT: Final = 1e3
"""Weight of the base parameters, in their prior deviations, if there are physical bodies with them."""
ROUNDS: Final = 300
"""Most steps of the least squares."""


def nearest(unknowns: Unknowns, covariance: Array, theta: Array) -> tuple[Array, float]:
    """Theta of the nearest robot with physical bodies, and the distance in standard deviations of a covariance."""
    place = unknowns.places["beta"]
    values, vectors = np.linalg.eigh(covariance[place, place])
    white = (vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
    x = bodies_near(unknowns, theta[place], white)
    change = np.linalg.solve(unknowns.bodies, unknowns.model.grouping @ x - unknowns.center) - theta[place]
    shift = covariance[:, place] @ (white.T @ (white @ change))
    shift[place] = change
    return theta + shift, float(np.linalg.norm(white @ change))


def bodies_near(unknowns: Unknowns, z: Array, white: Array | None = None) -> Array:
    """All inertial parameters, (p,), of physical bodies whose base parameters are near those of `z`, the beta of theta.

    Deviations of z are multiplied by the matrix `white`; by `EXACT`, if there is none.
    """
    from scipy.optimize import least_squares

    parameters = unknowns.model.base.parameters
    file = np.array([0.0 if value is None else float(value) for value in parameters.values])
    links, rotors = np.arange(len(file))[parameters.inertial].reshape(-1, 10), parameters.places("rotor")
    file[rotors] = unknowns.rotors
    own = np.array([pseudo_inertia(row) for row in file[links]])
    least = LEAST[white is None] * max(float(np.linalg.eigvalsh(P)[-1]) for P in own)
    corner, eye = np.tril_indices(4), np.eye(4)
    back = np.linalg.pinv(np.array([pseudo_inertia(row).ravel() for row in np.eye(10)]).T)
    scale = np.maximum(np.sqrt(np.sum(unknowns.full**2, axis=1)), 1e-6)
    white = EXACT * np.eye(len(z)) if white is None else white
    to = white @ np.linalg.solve(unknowns.bodies, unknowns.model.grouping)
    offset = white @ (np.linalg.solve(unknowns.bodies, unknowns.center) + z)
    M, shift = np.vstack([to, WEAK * np.diag(1 / scale)]), np.concatenate([offset, WEAK * file / scale])

    def parts(y: Array) -> tuple[Array, Array]:
        L = np.zeros((len(links), 4, 4))
        L[:, corner[0], corner[1]] = y[: -len(unknowns.rotors)].reshape(len(links), -1)
        return L, y[-len(unknowns.rotors) :]

    def bodies(y: Array) -> Array:
        L, s = parts(y)
        x = np.empty_like(file)
        x[links] = (np.einsum("lij,lkj->lik", L, L) + least * eye).reshape(len(links), -1) @ back.T
        x[rotors] = s**2
        return x

    def slope(y: Array) -> Array:
        L, s = parts(y)
        D = np.zeros((len(file), len(y)))
        for k, link in enumerate(links):
            for c, (i, j) in enumerate(zip(*corner, strict=True)):
                dP = np.zeros((4, 4))
                dP[i] += L[k][:, j]
                dP[:, i] += L[k][:, j]
                D[link, k * len(corner[0]) + c] = back @ dP.ravel()
        D[rotors, -len(s) :] = np.diag(2 * s)
        return np.asarray(M @ D)

    sizes, axes = np.linalg.eigh(own - least * eye)
    L = np.linalg.cholesky(np.einsum("lij,lj,lkj->lik", axes, np.maximum(sizes, least), axes))
    start = np.concatenate([L[:, corner[0], corner[1]].ravel(), np.sqrt(file[rotors])])
    best, lowest = start, np.inf

    def residual(y: Array) -> Array:
        nonlocal best, lowest
        r = M @ bodies(y) - shift
        if r @ r < lowest:
            best, lowest = y.copy(), float(r @ r)
        return np.asarray(r)

    with suppress(np.linalg.LinAlgError):  # near the end, the SVD of a nearly singular factor may not converge
        least_squares(residual, start, jac=slope, method="trf", max_nfev=ROUNDS)
    return bodies(best)
