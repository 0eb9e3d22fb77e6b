"""The Jacobian of an image by a camera that is learnt while the robot moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.block import AdaptingBlock, Equations, Signals
from dmframe.certificate import SX, Certificate, TrueValue
from dmframe.naming import named
from dmframe.parameter import Gain, PositiveDefinite, Real, Vector
from dmframe.port import Adapted, Element, Port
from dmframe_blocks._image import image_regressor, pinhole


@final
class AdaptiveCamera(AdaptingBlock):
    r"""Estimates the nine numbers of a fixed camera from its image, and gives the image's Jacobian with them.

    .. math::

        J_{\eta} &= (\hat N - (\eta - \tfrac12 e_{\eta})\, \hat m^\top)\, \hat J     \tag{1} \\
        \dot{\hat c} &= \Gamma_c Y_c^\top e_{\eta}                                    \tag{2}

    with c = (right, down, ahead) of `camera`, of which N has the first two as rows, m is the last, and Y_c is what the
    motion of the image is linear by: :math:`Y_c \hat c = J_{\eta} \dot q`. With :math:`\tilde c = \hat c - c` and
    :math:`\alpha = \mathrm{task\_weight}`,

    .. math::

        S &= \tfrac12 \alpha |\tilde c|^2_{\Gamma_c^{-1}}                            \tag{3} \\
        \dot S &= \alpha\, e_{\eta}^\top Y_c \tilde c                                 \tag{4}

    It is the Jacobian of the depth times the image, not of the image, and so holds no division by a depth that nobody
    knows. Without the velocity of the image, with the robot's own geometry known. The scale of all nine numbers
    together is only that of the depth: a camera twice as far away, of twice the focal length, differs little.

    Parameters
    ----------
    Gamma_c : (c, c), 1/m, positive definite, or its diagonal
        Adaptation gain. Larger learns the camera faster and passes more noise of the image.
    c_hat : (c,)
        The estimate at the start: three numbers each of right, down and ahead.
    c_hat_box : [lower, upper]
        Interval onto which the estimate is projected, to keep the Jacobian's rank.

    Notes
    -----
    Not for: a camera that moves; a robot whose lengths are uncertain, as the products of both would have to be
    learnt.

    References
    ----------
    [Cheah2006]_ for the depth's linear form; [WangTAC2020]_ Theorem 1 for the structure.
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("dq", "n", "rad/s"),
        Port("J_hat", "3 n", "m/rad"),
        Port("eta", "2"),
        Port("e_eta", "2"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("J_eta", "2 n", "m/rad", full_rank=True),)
    estimates: ClassVar[tuple[Adapted, ...]] = (Adapted("c_hat", "c", gain="Gamma_c"),)
    driven_by: ClassVar[str] = "e_eta"
    truth: ClassVar[tuple[Port, ...]] = (Port("c", "c"), Port("task_weight"))

    Gamma_c: Gain = PositiveDefinite("c", "1/m")
    c_hat: Vector = Real("c", spread=False)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """c: three of each direction."""
        return {"c": [Element(f"{row} {axis}") for row in ("right", "down", "ahead") for axis in "xyz"]}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        N, m = pinhole(x.c_hat)
        N, m = named("N_hat", N), named("m_hat", m)
        return Equations(outputs={"J_eta": (N - (u.eta - u.e_eta / 2) @ m.T) @ u.J_hat})

    def direction(self, u: Signals, x: Signals, p: Signals, e_eta: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"c_hat": self._Y_c(u).T @ e_eta}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        return Certificate(
            estimates={"c_hat": TrueValue(truth.c, truth.task_weight)},
            supply=truth.task_weight * ca.dot(u.e_eta, self._Y_c(u) @ (x.c_hat - truth.c)),
            task=True,
        )

    def _Y_c(self, u: Signals) -> SX:
        return named("Y_c", image_regressor(u.eta, u.e_eta, u.J_hat @ u.dq))
