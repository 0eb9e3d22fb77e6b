"""Reference for image-based regulation with an uncalibrated camera."""

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
    r"""Joint reference from the filtered image error, with a passive feedback as a torque.

    .. math::

        e_{\chi} &= \chi - \chi_d                                                     \tag{1} \\
        \dot y &= K_1 (J_{\chi}^\top e_{\chi} - y)                                      \tag{2} \\
        \dot q_r &= -K_2 y                                                          \tag{3} \\
        \tau_{task} &= -\alpha J_{\chi}^\top e_{\chi}                                 \tag{4}

    The goal is constant. The storage function is weighted with the depth, which is not measured:

    .. math::

        S &= \tfrac12 \alpha\, \mathrm{depth}\, |e_{\chi}|^2 + \tfrac12 \alpha |y|^2_{K_2/K_1}            \tag{5} \\
        \dot S &= -\alpha\, y^\top K_2 y + \alpha\, y^\top K_2 J_{\chi}^\top e_{\chi}
                  + \alpha\, e_{\chi}^\top Y_c a_c    \tag{6}

    The image velocity is :math:`(N - \chi\, \mathrm{ahead}^\top) \dot x` over the depth, and the rate of the depth is
    :math:`\mathrm{ahead}^\top \dot x`. The rate of half of :math:`\mathrm{depth}\, |e_{\chi}|^2` is therefore
    :math:`e_{\chi}^\top Y_c a_c`, where Y_c times a_c is
    :math:`(N - (\chi - \tfrac12 e_{\chi})\, \mathrm{ahead}^\top) \dot x`. The proof assumes that the depth stays
    positive; S would not be positive for a tool behind the camera.

    Neither (1) to (4) nor their derivatives contain the depth or the image velocity.

    Parameters
    ----------
    K_1 : diagonal (n,), 1/s, > 0
        Bandwidth of the filter. A larger bandwidth follows the error more closely and passes more noise.
    K_2 : diagonal (n,), rad^2/(m s), > 0
        Gain from the filtered error to the reference velocity.
    alpha : scalar, N, > 0
        Stiffness of the feedback, which acts as a torque through the servo.

    Notes
    -----
    Not for: a moving goal. Use it with ``tie: position`` of `pid_inverse`: its energy balance requires
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
