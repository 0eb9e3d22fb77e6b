r"""Pseudo-inertia of a body, and the natural adaptation gain that follows from it."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from dmframe.robot.parameters import Inertial

Rows = list[list[Fraction]]

# phi = tr(A P) for each parameter: entries of A; those off the diagonal are split into two equal halves.
_ENTRIES = Inertial(
    m={(3, 3): 1},
    mc_x={(0, 3): 1}, mc_y={(1, 3): 1}, mc_z={(2, 3): 1},
    I_xx={(1, 1): 1, (2, 2): 1}, I_yy={(0, 0): 1, (2, 2): 1}, I_zz={(0, 0): 1, (1, 1): 1},
    I_xy={(0, 1): -1}, I_xz={(0, 2): -1}, I_yz={(1, 2): -1},
)  # fmt: skip


def pseudo_inertia(row: Sequence[Any]) -> list[list[Any]]:
    r"""[[tr(I)/2 1 - I, h], [h', m]] of ten inertial parameters [Wensing2018]_, numbers or expressions."""
    b = Inertial(*row)
    half, h = (b.I_xx + b.I_yy + b.I_zz) / 2, [b.mc_x, b.mc_y, b.mc_z]
    return [
        [half - b.I_xx, -b.I_xy, -b.I_xz, h[0]],
        [-b.I_xy, half - b.I_yy, -b.I_yz, h[1]],
        [-b.I_xz, -b.I_yz, half - b.I_zz, h[2]],
        [*h, b.m],
    ]


def parameters_of(P: Sequence[Sequence[Any]]) -> Inertial:
    """Ten inertial parameters of a pseudo-inertia, numbers or expressions."""
    return Inertial(*(sum(value * P[i][j] for (i, j), value in entries.items()) for entries in _ENTRIES))


def dual(row: Sequence[Any]) -> list[list[Any]]:
    r"""Symmetric Q with :math:`\mathrm{tr}(Q\, P(a)) = g^\top a` for the pseudo-inertia P(a) of any parameters a.

    Parameters
    ----------
    row : 10 numbers or expressions
        g.
    """
    Q: list[list[Any]] = [[0 for _ in range(4)] for _ in range(4)]
    for value, entries in zip(row, _ENTRIES, strict=True):
        for (i, j), entry in entries.items():
            Q[i][j] = Q[i][j] + entry * value / 2
            Q[j][i] = Q[j][i] + entry * value / 2
    return Q


def natural_gain(row: Sequence[Fraction]) -> Rows:
    r"""Natural adaptation gain: inverse of :math:`\mathrm{tr}(P^{-1} \dot P P^{-1} \dot P)` at a pseudo-inertia P.

    With each parameter :math:`\phi_i = \mathrm{tr}(A_i P)` it has a closed form, in field operations:

    .. math:: \Gamma_{ij} = \mathrm{tr}(P A_i P A_j)

    The metric is, up to a constant factor, that of [LeeKwonPark2018]_, held constant at P; with this factor
    :math:`\Gamma_{mm} = m^2`. The metric is independent of units and frames, and the error of 100 % of all parameters
    has the value 4 for every body. The gain is positive definite iff P is.

    Parameters
    ----------
    row : 10 numbers
        A row of `SerialChain.inertia`.

    Returns
    -------
    (10, 10)
    """
    P = pseudo_inertia(row)
    moved = [_product(P, _matrix(entries)) for entries in _ENTRIES]
    return [[sum((a[i][k] * b[k][i] for i in range(4) for k in range(4)), Fraction(0)) for b in moved] for a in moved]


def _matrix(entries: dict[tuple[int, int], int]) -> Rows:
    A = [[Fraction(0)] * 4 for _ in range(4)]
    for (i, j), value in entries.items():
        A[i][j] += Fraction(value, 2)
        A[j][i] += Fraction(value, 2)
    return A


def _product(A: Rows, B: Rows) -> Rows:
    return [[sum((A[i][k] * B[k][j] for k in range(4)), Fraction(0)) for j in range(4)] for i in range(4)]
