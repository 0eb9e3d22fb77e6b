"""PD feedback for a torque-controlled robot."""

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
    r"""PD feedback: a spring and a damper between the joints and their path.

    .. math::

        \dot q_{ref} = \dot q_d, \quad \sigma = \dot q - \dot q_{ref}, \quad
        \tau_c = \tau_{dc} - K_e (q - q_d) - K_\sigma \sigma   \tag{1}

    The storage function is the energy of the spring:

    .. math::

        S      &= \tfrac12 |q - q_d|^2_{K_e}   \tag{2} \\
        \dot S &= -\sigma^\top (K_\sigma + B) \sigma - \sigma^\top (K u - \tau_{dc} - B \sigma)   \tag{3}

    Without a compensation :math:`\tau_{dc}` the torque along the reference is missing. It is zero for a constant goal
    without gravity: `verify` proves PD feedback in this case. Otherwise the supply rates do not cancel, and `verify`
    refutes the graph. V dissipates the velocity error only. For a constant goal the position error converges to zero
    too, by LaSalle's principle, which `verify` does not apply. On a moving path with adaptive compensation it need not
    converge.

    Parameters
    ----------
    K_e : diagonal (n,), N m/rad, > 0
        Stiffness of the spring.
    K_sigma : diagonal (n,), N m s/rad, > 0
        Damping.

    Notes
    -----
    Not for: exact tracking; the spring torque is non-zero only with a position error.

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
