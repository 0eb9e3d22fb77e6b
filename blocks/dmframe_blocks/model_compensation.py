"""Manufacturer's feed-forward of a model of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Real,
    Scalar,
    Side,
    Signals,
    State,
    named,
    operation,
)
from dmframe.robot.parameters import INERTIAL


@final
class ModelCompensation(AbstractBlock):
    r"""Adds a fraction of the inverse dynamics of the manufacturer's model to the servo's voltage.

    The manufacturer interpolates the velocity command by a low-pass filter, and computes the torque along it:

    .. math::

        \ddot q_t &= (\dot q_c - \dot q_t) / \mathrm{smoothing}   \tag{1} \\
        \tau_{model} &= M(q, a_{model}) \ddot q_t + C(q, \dot q, a_{model}) \dot q_t
                         + g_{full}(q, a_{model})   \tag{2} \\
        u_{comp} &= u + K^{-1}\, \mathrm{share}\, (\tau_{model} - \tau_0)   \tag{3}

    The inertial parameters :math:`a_{model}` of link i are those of the robot times :math:`1 + \mathrm{off}_i`. The
    outer loop has no information about the compensation.

    :math:`\tau_0 = g_{full}(q(0), a_{model})` is constant. The servo's integrator starts with all of the gravity
    torque; subtracting :math:`\mathrm{share}\, \tau_0` is the same as an integrator that starts with the rest of it.

    Parameters
    ----------
    share : scalar, >= 0
        Fraction of the model's torque that is added; 1 is all of it.
    off : vector (n,)
        Relative error of the inertial parameters of each link: with -0.2 the link is a fifth too light in the model.
    smoothing : scalar, s, > 0
        Time constant of the interpolation: about a cycle of the manufacturer's controller.

    Notes
    -----
    The model contains neither a payload nor friction: see `friction_compensation`. For a fraction of gravity alone,
    with a proof, use `maker_gravity` of `manipulator`. Not for: a positional interface whose steps are not in the
    velocity command.

    References
    ----------
    [Siciliano2009]_ Section 8.5.1, feed-forward compensation of the computed torque.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("u", "n", "V"),
        Input("K", "n", "N m/V"),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_c", "n", "rad/s"),
    )
    outputs = (Output("u_comp", "n", "V", instead_of="u"), Output("tau_model", "n", "N m"))
    states = (State("dq_t", "n", "rad/s"), State("tau_0", "n", "N m"))
    unproved: ClassVar[str] = "no theorem covers a servo with a model of the robot"

    share: Scalar = NonNegative()
    off: Diagonal = Real("n", default=0.0)
    smoothing: Scalar = Positive("", "s", default=0.008)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (3)."""
        ddq_t = (u.dq_c - x.dq_t) / p.smoothing
        tau_model = p.robot.inverse_dynamics(u.q, u.dq, x.dq_t, ddq_t, self._model(p))
        return Equations(
            outputs={"u_comp": u.u + p.share * (tau_model - x.tau_0) / u.K, "tau_model": tau_model},
            rates={"dq_t": ddq_t, "tau_0": 0 * x.tau_0},
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the model's gravity torque."""
        return {"dq_t": 0 * u.dq, "tau_0": p.robot.gravity_torque(u.q, self._model(p))}

    def _model(self, p: Signals) -> SX:
        """The inertial parameters of the manufacturer's model."""
        return named("a_model", links_off(p.robot.inertia, p.off))


@operation
def links_off(inertia: Any, off: Any) -> Any:
    """The inertial parameters, those of link i times 1 + off_i."""
    return ca.vec(ca.repmat((1 + off).T, len(INERTIAL), 1)) * inertia
