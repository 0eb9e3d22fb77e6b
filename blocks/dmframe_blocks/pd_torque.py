"""Proportional and derivative feedback on a robot whose joints take torques."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Access,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Signals,
    Square,
    named,
)


@final
class PdTorque(AbstractBlock):
    r"""A spring and a damper between the joints and their path.

    .. math::

        \dot q_{ref} = \dot q_d, \quad \sigma = \dot q - \dot q_{ref}, \quad
        \tau_c = \tau_{dc} - K_e (q - q_d) - K_\sigma \sigma   \tag{1}

    What it stores is the energy of the spring:

    .. math::

        S      &= \tfrac12 |q - q_d|^2_{K_e}   \tag{2} \\
        \dot S &= -\sigma^\top (K_\sigma + B) \sigma - \sigma^\top (K u - \tau_{dc} - B \sigma)   \tag{3}

    Without a compensation :math:`\tau_{dc}` nothing supplies the torque that the motion needs along the reference. None
    is needed at a goal that rests where gravity does not reach: there a spring and a damper are proved. Elsewhere the
    supplies do not cancel, and `verify` refutes. V dissipates the velocity error alone: at a goal that rests the
    position error goes to zero too, by LaSalle's principle, which `verify` does not carry out; on a moving path, with
    a compensation that adapts, it need not.

    Parameters
    ----------
    K_e : diagonal (n,), N m/rad, > 0
        Stiffness of the spring.
    K_sigma : diagonal (n,), N m s/rad, > 0
        Damping.

    Notes
    -----
    Not for: exact tracking; the spring gives a torque only where there is an error.

    References
    ----------
    [TakegakiArimoto1981]_.
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_d", "n", "rad"),
        Input("dq_d", "n", "rad/s", derivative_of="q_d"),
        Input("tau_dc", "n", "N m", optional=True),
    )
    outputs = (
        Output("tau_c", "n", "N m", Access.COMMANDED),
        Output("dq_ref", "n", "rad/s"),
        Output("sigma", "n", "rad/s"),
    )
    truth = (
        Input("K", "n", "N m/V"),
        Input("B", "n", "N m s/rad"),
        Input("u", "n", "V"),
    )

    K_e: Diagonal = Positive("n", "N m/rad")
    K_sigma: Diagonal = Positive("n", "N m s/rad")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        sigma = u.dq - u.dq_d
        return Equations(
            outputs={
                "tau_c": u.tau_dc - p.K_e * (u.q - u.q_d) - p.K_sigma * sigma,
                "dq_ref": u.dq_d,
                "sigma": sigma,
            }
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        sigma = named("sigma", u.dq - u.dq_d)
        return Certificate(
            storage=(Square(u.q - u.q_d, p.K_e),),
            dissipation=(Square(sigma, p.K_sigma + truth.B),),
            supply=-ca.dot(sigma, truth.K * truth.u - u.tau_dc - truth.B * sigma),
        )
