"""Contact of the tool with an elastic wall."""

from __future__ import annotations

from typing import final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    SX,
    AbstractBlock,
    Access,
    Certificate,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Real,
    Scalar,
    Side,
    Signals,
    Vector,
    named,
    norm,
    operation,
)
from dmframe_blocks._directions import check_direction


@final
class Wall(AbstractBlock):
    r"""Flat wall with spring and damper; its force is never adhesive.

    .. math::

        \mathrm{depth} &= \max(n^\top (p - f(q)), 0)   \tag{1} \\
        f_{ext} &= n\, \mathrm{depth} \max(k - d\, n^\top J(q) \dot q, 0), \quad
            \tau_{ext} = J(q)^\top f_{ext}   \tag{2}

    with :math:`p = \mathrm{point}`, :math:`n = \mathrm{normal} / |\mathrm{normal}|`, :math:`k = \mathrm{stiffness}` and
    :math:`d = \mathrm{damping}`. The damping is proportional to the depth, so that the force is continuous at contact.
    The wall is passive: along any motion, its power on the tool is at most minus the rate of half of k times the square
    of the depth.

    The force on the tool is an output, like that of an ideal sensor at the wrist; `force_sensor` adds noise and offset.

    Parameters
    ----------
    point : (m,), m
        Any point of the surface.
    normal : (m,)
        Outward normal, towards the robot, of any length.
    stiffness : scalar, N/m, > 0
        Stiffness. A stiff wall requires short integration steps, and more damping in the controller.
    damping : scalar, N s/m^2, >= 0
        Damping per metre of depth.

    Notes
    -----
    There is no friction along the surface. Not for: edges, or contact of links other than the tool.

    References
    ----------
    [HuntCrossley1975]_ for the damping.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
    )
    outputs = (
        Output("tau_ext", "n", "N m"),
        Output("f_ext", "m", "N", Access.MEASURED),
        Output("depth", "", "m"),
    )

    point: Vector = Real("m", "m", spread=False)
    normal: Vector = Real("m", spread=False)
    stiffness: Scalar = Positive("", "N/m")
    damping: Scalar = NonNegative("", "N s/m^2", default=0.0)

    @model_validator(mode="after")
    def _some_direction(self) -> Wall:
        check_direction("normal", self.normal)
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        J, n = p.robot.jacobian(u.q), named("n", p.normal / norm(p.normal))
        depth = positive(ca.dot(n, p.point - p.robot.position(u.q)))
        f = n * depth * positive(p.stiffness - p.damping * ca.dot(n, J @ u.dq))
        return Equations({"tau_ext": J.T @ f, "f_ext": f, "depth": depth})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage: V does not contain the energy of the spring, since controllers cancel the measured force."""
        return Certificate()


@operation
def positive(value: SX) -> SX:
    """The positive part of a number."""
    return ca.fmax(value, 0)
