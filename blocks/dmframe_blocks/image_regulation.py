"""Reference for bringing the tool to a point of a camera's image, by a camera that nobody has calibrated."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    State,
    named,
)
from dmframe_blocks._image import image_regressor


@final
class ImageRegulation(AbstractBlock):
    r"""Joint reference from the filtered error in the image, with a passive feedback as a torque.

    .. math::

        e_{\chi} &= \chi - \chi_d                                                     \tag{1} \\
        \dot y &= K_1 (J_{\chi}^\top e_{\chi} - y)                                      \tag{2} \\
        \dot q_r &= -K_2 y                                                          \tag{3} \\
        \tau_{task} &= -\alpha J_{\chi}^\top e_{\chi}                                 \tag{4}

    The goal stands still. What is stored is weighed with the depth, which nobody measures:

    .. math::

        S &= \tfrac12 \alpha\, \mathrm{depth}\, |e_{\chi}|^2 + \tfrac12 \alpha |y|^2_{K_2/K_1}            \tag{5} \\
        \dot S &= -\alpha\, y^\top K_2 y + \alpha\, y^\top K_2 J_{\chi}^\top e_{\chi}
                  + \alpha\, e_{\chi}^\top Y_c a_c    \tag{6}

    The image moves with :math:`(N - \chi\, \mathrm{ahead}^\top) \dot x` over the depth, and the depth with
    :math:`\mathrm{ahead}^\top \dot x`, so that half of :math:`\mathrm{depth}\, |e_{\chi}|^2` grows by
    :math:`e_{\chi}^\top Y_c a_c`, with Y_c times a_c being
    :math:`(N - (\chi - \tfrac12 e_{\chi})\, \mathrm{ahead}^\top) \dot x`. That the depth stays above zero is
    assumed: of a tool behind the camera S would not be positive.

    Neither the depth nor a velocity of the image stands in (1) to (4), nor in what is derived of them.

    Parameters
    ----------
    K_1 : diagonal (n,), 1/s, > 0
        Bandwidth of the filter. Larger follows the error more closely and passes more noise.
    K_2 : diagonal (n,), rad^2/(m s), > 0
        Gain from the filtered error to the reference velocity.
    alpha : scalar, N, > 0
        Stiffness of the feedback that goes through the servo as a torque.

    Notes
    -----
    Not for: a goal that moves. A `pid_inverse` behind it ties the position, not the velocity: its energy balance needs
    :math:`\dot q_{ref} = -K_2 y`.

    `task_weight` is the weight of the task level in V.

    References
    ----------
    [Liu2006]_ for the depth as a weight; [WangTAC2020]_ Theorem 1 for the structure.
    """

    inputs = (Input("chi", "2"), Input("chi_d", "2"), Input("J_chi", "2 n", "m/rad"))
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("tau_task", "n", "N m"),
        Output("e_chi", "2"),
    )
    states = (State("y", "n", "m/rad"),)
    truth = (Input("depth", "", "m"), Input("a_c", "9"), Input("dx", "3", "m/s"))

    K_1: Diagonal = Positive("n", "1/s")
    K_2: Diagonal = Positive("n", "rad^2/(m s)")
    alpha: Scalar = Positive("", "N")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (4)."""
        e_chi = u.chi - u.chi_d
        pull = u.J_chi.T @ e_chi
        return Equations(
            outputs={"dq_r": -p.K_2 * x.y, "tau_task": -p.alpha * pull, "e_chi": e_chi},
            rates={"y": p.K_1 * (pull - x.y)},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(5) and (6)."""
        e_chi = u.chi - u.chi_d
        Y_c = named("Y_c", image_regressor(u.chi, e_chi, truth.dx))
        return Certificate(
            storage=(
                Square(e_chi, p.alpha * truth.depth, positive="the tool stays in front of the camera"),
                Square(x.y, p.alpha * p.K_2 / p.K_1),
            ),
            dissipation=(Square(x.y, p.alpha * p.K_2),),
            supply=p.alpha * (ca.dot(x.y, p.K_2 * (u.J_chi.T @ e_chi)) + ca.dot(e_chi, Y_c @ truth.a_c)),
            task=True,
            truth={"task_weight": p.alpha},
        )
