"""An elastic wall that pushes the tool back."""

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
    r"""A flat wall with a spring and a damper in it; it pushes, and never pulls.

    .. math::

        \mathrm{depth} &= \max(n^\top (p - f(q)), 0)   \tag{1} \\
        f_{ext} &= n\, \mathrm{depth} \max(k - d\, n^\top J(q) \dot q, 0), \quad
            \tau_{ext} = J(q)^\top f_{ext}   \tag{2}

    with :math:`p = \mathrm{point}`, :math:`n = \mathrm{normal} / |\mathrm{normal}|`, :math:`k = \mathrm{stiffness}` and
    :math:`d = \mathrm{damping}`. A damping that grows with the depth makes a contact begin and end without a jump. The
    wall returns no more energy than its spring holds: along any motion, the power that it gives the tool is at most
    minus the rate of half of k times the square of the depth.

    The force on the tool is handed out, as by a perfect sensor at the wrist; `force_sensor` makes a real one of it.

    Parameters
    ----------
    point : (m,), m
        Any point of the wall's face.
    normal : (m,)
        A direction out of the face, towards the robot, of any length.
    stiffness : scalar, N/m, > 0
        A stiff wall asks for short steps of the simulation, and for more damping of the controller.
    damping : scalar, N s/m^2, >= 0
        Damping a metre of depth.

    Notes
    -----
    There is no friction along the face. Not for: edges, or links other than the tool that touch it.

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
        """What its spring holds does not stand in V: a controller that measures the force cancels it."""
        return Certificate()


@operation
def positive(value: SX) -> SX:
    """What is above zero of a number."""
    return ca.fmax(value, 0)
