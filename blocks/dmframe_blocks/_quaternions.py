r"""Orientations as quaternions of arbitrary length, whose rotation matrices are rational and identically orthogonal.

A quaternion is a column :math:`p = (p_0, v)` of four numbers, not all zero. It represents the rotation of its unit
multiple: p, -p and 2 p are the same orientation, so no normalisation is needed.
"""

from __future__ import annotations

from typing import Any, Final

import casadi as ca

from dmframe.block import SX, Assumption, Written, operation, sentence

LESS_THAN_HALF_A_TURN: Final = Assumption(
    sentence(
        "the tool stays less than half a turn from its orientation, {apart} < 8: {V(0)} < {most} is sufficient; half a "
        "turn away {e_R} is zero too, at an unstable equilibrium",
        apart=Written("|R - R_d|^2", "|R − R_d|²", "|R - R_d|^2"),
        most=Written("4 lever^2", "4 lever²", r"4\,\mathrm{lever}^2"),
    ),
    sentence(
        "{e_R} goes to zero, and {size}",
        size=Written(
            "|e_R|^2 = |R - R_d|^2 (8 - |R - R_d|^2)/4",
            "|e_R|² = |R − R_d|² (8 − |R − R_d|²)/4",
            r"|e_R|^2 = |R - R_d|^2\, (8 - |R - R_d|^2)/4",
        ),
    ),
)


@operation
def left(p: SX) -> SX:
    """The 3 x 4 matrix (-v, p_0 I + [v]) of a quaternion p = (p_0, v), [v] being the matrix of the cross product."""
    return ca.horzcat(-p[1:], p[0] * ca.DM.eye(3) + ca.skew(p[1:]))


@operation
def right(p: SX) -> SX:
    """The 3 x 4 matrix (-v, p_0 I - [v]) of a quaternion p = (p_0, v), [v] being the matrix of the cross product."""
    return ca.horzcat(-p[1:], p[0] * ca.DM.eye(3) - ca.skew(p[1:]))


@operation
def turned(p: SX, by: SX) -> SX:
    """The product of two quaternions: the orientation p, rotated by the other one about body-fixed axes."""
    return ca.vertcat(p[0] * by[0] - ca.dot(p[1:], by[1:]), p[0] * by[1:] + by[0] * p[1:] + ca.cross(p[1:], by[1:]))


@operation
def about(axis: SX, angle: SX) -> SX:
    """The quaternion of a turn by an angle about an axis of any length but zero."""
    return ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) * axis / ca.sqrt(ca.sumsqr(axis)))


NOWHERE = 1e-150
"""Lower bound of the length of a rotation vector, so that one of length zero has an axis [rad]."""


@operation
def quaternion(v: SX) -> SX:
    """The unit quaternion of a rotation vector: axis times angle, as teach pendants display orientations."""
    angle = ca.fmax(ca.sqrt(ca.sumsqr(v)), NOWHERE)
    return ca.vertcat(ca.cos(angle / 2), ca.sin(angle / 2) / angle * v)


@operation
def partly(a: SX, b: SX, share: SX) -> SX:
    """Rotation by a fraction of the shortest rotation from the unit quaternion a to b."""
    whole = turned(ca.vertcat(a[0], -a[1:]), b)
    size = ca.fmax(ca.sqrt(ca.sumsqr(whole[1:])), NOWHERE)
    half = ca.atan2(size, ca.fabs(whole[0]))
    toward = ca.if_else(whole[0] < 0, -1, 1)
    return ca.vertcat(ca.cos(share * half), ca.sin(share * half) / size * toward * whole[1:])


def apart(R: Any, R_d: Any) -> Any:
    """The sum of the squares of all elements of R - R_d: 8 sin(angle/2)^2, which is zero only for R = R_d."""
    return ca.sumsqr(ca.vec(R - R_d))


@operation
def turn_from(R: Any, R_d: Any) -> Any:
    r"""The axis of the rotation from R_d to R, times twice the sine of its angle: the vector of R R_d' - R_d R'."""
    A = R @ R_d.T
    return ca.vertcat(A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1])
