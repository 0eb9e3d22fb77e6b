"""Joints and bodies of a chain as expressions, for recursive algorithms from the base to the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.robot.parameters import INERTIAL, Inertial
from dmframe.robot.rational import Matrix


@final
@dataclass(frozen=True, eq=False)
class Link:
    """One joint and its body at q.

    `rotation` carries the joint frame's coordinates to the parent's; `offset` is the joint frame's origin there.
    """

    revolute: bool
    axis: Any
    rotation: Any
    offset: Any


def skew(v: Any) -> Any:
    r"""Matrix :math:`[v]_\times` of the cross product with v."""
    return ca.skew(v)


@final
@dataclass(frozen=True, eq=False)
class Body:
    """Ten inertial parameters in a joint's frame: mass, first moment (3), inertia about the frame's origin (3, 3)."""

    mass: Any
    moment: Any
    inertia: Any

    def __add__(self, other: Body) -> Body:
        return Body(self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia)

    def wrench(self, acceleration: Any, dnu: Any, A: Any, B: Any) -> tuple[Any, Any]:
        r"""Force and moment about the origin for a motion, linear in the ten parameters.

        A point r of the body accelerates by :math:`\dot v + A r`, so with :math:`\Sigma = \int r r^\top dm` the force
        is :math:`m \dot v + A h`, the moment :math:`h \times \dot v + \mathrm{vee}(A \Sigma - \Sigma A^\top)`. Below,
        :math:`\Sigma` is written in the entries of I, in which the antisymmetric part of A gives :math:`I \dot\nu`.
        """
        J = self.inertia
        turning = [
            dnu[i] * J[i, i]
            + A[j, i] * J[k, i]
            - A[k, i] * J[j, i]
            + (B[j, j] - B[k, k]) * J[j, k]
            + B[j, k] * (J[k, k] - J[j, j])
            for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        ]
        force = self.mass * acceleration + A @ self.moment
        return force, ca.vertcat(*turning) + ca.cross(self.moment, acceleration)

    def momentum(self, link: Link) -> tuple[Any, Any]:
        """Linear momentum, and angular about the origin, of a unit velocity of the body's joint."""
        if link.revolute:
            return ca.cross(link.axis, self.moment), self.inertia @ link.axis
        return self.mass * link.axis, ca.cross(self.moment, link.axis)

    def in_parent(self, link: Link) -> Body:
        r"""Body in the parent's frame: :math:`I_p = R I R^\top - [p][R h] - [R h][p] - m [p][p]`."""
        R, p = link.rotation, link.offset
        h = R @ self.moment
        shift = skew(p)
        # -[p][h] - [h][p] - m [p]^2 = -[p][h + m p / 2] - its transpose: symmetric, one product.
        product = shift @ skew(h + self.mass * p * 0.5)
        turned = R @ self.inertia @ R.T
        return Body(self.mass, h + self.mass * p, _symmetric(turned - product - product.T))


def bodies_of(parameters: Any) -> list[Body]:
    """Bodies of the joints, from a column of ten parameters each."""
    bodies = []
    for b in (Inertial(*ca.vertsplit(row)) for row in ca.vertsplit(parameters, len(INERTIAL))):
        inertia = matrix([[b.I_xx, b.I_xy, b.I_xz], [b.I_xy, b.I_yy, b.I_yz], [b.I_xz, b.I_yz, b.I_zz]])
        bodies.append(Body(b.m, ca.vertcat(b.mc_x, b.mc_y, b.mc_z), inertia))
    return bodies


def acceleration_field(omega: Any, nu: Any, dnu: Any) -> tuple[Any, Any]:
    r"""Acceleration matrix A of a body, and its symmetric part B: point r accelerates, relative to the origin, by A r.

    :math:`A = [\dot\nu]_\times + B`,
    :math:`B r = \tfrac12(\omega \times (\nu \times r) + \nu \times (\omega \times r))`.
    """

    def product(i: int, j: int) -> Any:
        return omega[i] * nu[j] if nu is omega or i == j else (omega[i] * nu[j] + omega[j] * nu[i]) * 0.5

    (wx, wy, wz), (xy, xz, yz) = (product(i, i) for i in range(3)), (product(*ij) for ij in ((0, 1), (0, 2), (1, 2)))
    B = matrix([[-wy - wz, xy, xz], [xy, -wx - wz, yz], [xz, yz, -wx - wy]])
    return skew(dnu) + B, B


def carry(link: Link, force: Any, moment: Any) -> tuple[Any, Any]:
    """Wrench about a joint's origin, transformed to the parent's origin and frame."""
    carried = link.rotation @ force
    return carried, link.rotation @ moment + ca.cross(link.offset, carried)


def joint_torques(links: Sequence[Link], wrenches: Sequence[tuple[Any, Any]]) -> Any:
    """Joint torques from the wrench of each body: sum from the tool to the base, and project on each axis."""
    torques = []
    force = moment = ca.SX(3, 1)
    for link, (own_force, own_moment) in zip(reversed(links), reversed(wrenches), strict=True):
        force, moment = force + own_force, moment + own_moment
        torques.append(ca.dot(link.axis, moment if link.revolute else force))
        force, moment = carry(link, force, moment)
    return ca.vertcat(*reversed(torques))


def matrix(rows: Matrix | Sequence[Sequence[Any]]) -> Any:
    """Matrix from its rows."""
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def _symmetric(A: Any) -> Any:
    """Symmetric matrix from the lower triangle of A, so that equal entries are one expression."""
    return ca.tril(A) + ca.tril(A, False).T
