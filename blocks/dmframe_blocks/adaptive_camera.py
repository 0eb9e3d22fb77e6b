"""Image Jacobian of an uncalibrated camera, adapted online."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Adapted,
    AdaptingBlock,
    Certificate,
    Element,
    Equations,
    Gain,
    Input,
    Output,
    PositiveDefinite,
    Real,
    Signals,
    TrueValue,
    Vector,
    named,
)
from dmframe_blocks._image import image_regressor, pinhole


@final
class AdaptiveCamera(AdaptingBlock):
    r"""Estimates the nine parameters of a fixed camera from its image and computes the image Jacobian with them.

    .. math::

        J_{\chi} &= (\hat N - (\chi - \tfrac12 e_{\chi})\, \hat m^\top)\, \hat J     \tag{1} \\
        \dot{\hat a_c} &= \Gamma_c Y_c^\top e_{\chi}                                    \tag{2}

    with a_c = (right, down, ahead) of `camera`: N has the first two as rows, and m is the last. Y_c is the matrix with
    :math:`Y_c \hat a_c = J_{\chi} \dot q`. With :math:`\tilde a_c = \hat a_c - a_c` and
    :math:`\alpha = \mathrm{task\_weight}`,

    .. math::

        S &= \tfrac12 \alpha |\tilde a_c|^2_{\Gamma_c^{-1}}                            \tag{3} \\
        \dot S &= \alpha\, e_{\chi}^\top Y_c \tilde a_c                                 \tag{4}

    (1) is the Jacobian of the depth times the image, so it contains no division by the unknown depth. The law uses no
    image velocity; the robot's geometry has to be known. The common scale of the nine parameters corresponds to the
    depth only: a camera at twice the distance with twice the focal length gives almost the same image.

    Parameters
    ----------
    Gamma_c : (c, c), 1/m, positive definite, or its diagonal
        Adaptation gain. A larger gain adapts faster and passes more image noise.
    a_c_hat : (c,)
        Initial estimate: three elements each of right, down and ahead.
    a_c_hat_box : [lower, upper]
        Interval onto which the estimate is projected, so that the Jacobian keeps full rank.

    Notes
    -----
    Not for: a camera that moves; a robot with uncertain lengths, for which products of camera and robot parameters
    would have to be estimated.

    References
    ----------
    [Liu2006]_ for the Jacobian without the depth; [WangTAC2020]_ Theorem 1 for the structure.
    """

    inputs = (
        Input("dq", "n", "rad/s"),
        Input("J_hat", "3 n", "m/rad"),
        Input("chi", "2"),
        Input("e_chi", "2"),
    )
    outputs = (Output("J_chi", "2 n", "m/rad", full_rank=True),)
    estimates = (Adapted("a_c_hat", "c", gain="Gamma_c"),)
    driven_by: ClassVar[str] = "e_chi"
    truth = (Input("a_c", "c"), Input("task_weight"))

    Gamma_c: Gain = PositiveDefinite("c", "1/m")
    a_c_hat: Vector = Real("c", spread=False)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """c: three of each direction."""
        return {"c": [Element(f"{row} {axis}") for row in ("right", "down", "ahead") for axis in "xyz"]}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        N, m = pinhole(x.a_c_hat)
        N, m = named("N_hat", N), named("m_hat", m)
        return Equations(outputs={"J_chi": (N - (u.chi - u.e_chi / 2) @ m.T) @ u.J_hat})

    def direction(self, u: Signals, x: Signals, p: Signals, e_chi: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"a_c_hat": self._Y_c(u).T @ e_chi}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4)."""
        return Certificate(
            estimates={"a_c_hat": TrueValue(truth.a_c, truth.task_weight)},
            supply=truth.task_weight * ca.dot(u.e_chi, self._Y_c(u) @ (x.a_c_hat - truth.a_c)),
            task=True,
        )

    def _Y_c(self, u: Signals) -> SX:
        return named("Y_c", image_regressor(u.chi, u.e_chi, u.J_hat @ u.dq))
