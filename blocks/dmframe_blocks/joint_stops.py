"""Mechanical end stops of the joints."""

from __future__ import annotations

from typing import final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Real,
    Side,
    Signals,
)


@final
class JointStops(AbstractBlock):
    r"""Reports if a joint is beyond its range and, with a stiffness, pushes it back.

    .. math::

        \mathrm{beyond} = \max(q - q_{max}, 0) - \max(q_{min} - q, 0)   \tag{1}

    and, with a stiffness,

    .. math::

        u_{stop} = u - K^{-1} (\mathrm{stiffness}\, \mathrm{beyond}
            + \mathrm{damping}\, \max(\mathrm{beyond}, -\mathrm{beyond})\, \dot q)   \tag{2}

    The range is that of the robot's URDF, unless `lower` and `upper` are given. The damping is proportional to the
    depth, so that the force is continuous at contact. Without a stiffness the stop exerts no force: a run only
    reports the violation.

    Parameters
    ----------
    lower, upper : list (n,), rad
        The range; by default that of the robot's URDF, if it has one.
    stiffness : diagonal (n,), N m/rad, > 0
        Stiffness of the stop. A stiff stop requires short integration steps: 1e4 N m/rad on a light link oscillates at
        1 kHz.
    damping : diagonal (n,), N m s/rad^2, >= 0
        Damping of the stop per depth.

    Notes
    -----
    Not for: a robot that stops before it reaches its range.

    References
    ----------
    [HuntCrossley1975]_
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("u", "n", "V"),
        Input("K", "n", "N m/V"),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
    )
    outputs = (
        Output("u_stop", "n", "V", optional=True, instead_of="u"),
        Output("beyond", "n", "rad", notice="a joint is beyond its range"),
    )

    lower: Diagonal | None = Real("n", "rad", default=None)
    upper: Diagonal | None = Real("n", "rad", default=None)
    stiffness: Diagonal | None = Positive("n", "N m/rad", default=None)
    damping: Diagonal = NonNegative("n", "N m s/rad^2", default=0.0)

    @model_validator(mode="after")
    def _both(self) -> JointStops:
        if (self.lower is None) != (self.upper is None):
            raise ValueError("expected both lower and upper, or neither, found one")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        lower, upper = (p.lower, p.upper) if "lower" in p else (p.robot.lower_limits, p.robot.upper_limits)
        beyond = ca.fmax(u.q - upper, 0) - ca.fmax(lower - u.q, 0)
        if "stiffness" not in p:
            return Equations({"beyond": beyond})
        push = p.stiffness * beyond + p.damping * ca.fmax(beyond, -beyond) * u.dq
        return Equations({"beyond": beyond, "u_stop": u.u - push / u.K})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """No storage without a stiffness; no certificate with one."""
        return None if "stiffness" in p else Certificate()
