"""Command of a torque-controlled robot."""

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
class TorqueCommand(AbstractBlock):
    r"""Adds damping of the sliding variable to the dynamic compensation (Slotine and Li).

    .. math::

        \dot q_{ref} = \dot q_r, \quad \sigma = \dot q - \dot q_{ref}, \quad
        \tau_c = \tau_{dc} - K_\sigma \sigma   \tag{1}

    There is no servo to invert, and no storage:

    .. math::

        S      &= 0   \tag{2} \\
        \dot S &= -\sigma^\top (K_\sigma + B) \sigma - \sigma^\top (K u - \tau_{dc} - B \sigma)   \tag{3}

    which holds if the torque is realised exactly, :math:`K u = \tau_c`.

    Parameters
    ----------
    K_sigma : diagonal (n,), N m s/rad, > 0
        Damping of the sliding variable. A larger gain reduces the error and passes more velocity noise.

    Notes
    -----
    Not for: a robot with a closed servo, which accepts no torques; see `pi_inverse` and `pid_inverse`.

    References
    ----------
    [SlotineLi1987]_; [SlotineLi1991]_ Section 9.2.
    """

    inputs = (
        Input("dq", "n", "rad/s"),
        Input("dq_r", "n", "rad/s"),
        Input("tau_dc", "n", "N m"),
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

    K_sigma: Diagonal = Positive("n", "N m s/rad")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        sigma = u.dq - u.dq_r
        return Equations(
            outputs={"tau_c": u.tau_dc - p.K_sigma * sigma, "dq_ref": u.dq_r, "sigma": sigma},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3)."""
        sigma = named("sigma", u.dq - u.dq_r)
        return Certificate(
            dissipation=(Square(sigma, p.K_sigma + truth.B),),
            dominates=(1,),
            supply=-ca.dot(sigma, truth.K * truth.u - u.tau_dc - truth.B * sigma),
        )
