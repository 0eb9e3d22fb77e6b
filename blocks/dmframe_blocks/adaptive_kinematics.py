"""Task Jacobian of uncertain kinematics, adapted online."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final, Literal, final

import casadi as ca

from dmframe.block import (
    SX,
    Adapted,
    AdaptingBlock,
    Certificate,
    Diagonal,
    Element,
    Equations,
    Gain,
    Input,
    Output,
    Positive,
    PositiveDefinite,
    Real,
    Scalar,
    Signals,
    TrueValue,
    operation,
)
from dmframe.block.adaptation import Fit


@final
class AdaptiveKinematics(AdaptingBlock):
    r"""Estimates link and tool offsets from the tool's measured position and computes the Jacobian with them.

    .. math::

        \hat J &= J(q, \hat a_k)                                             \tag{1} \\
        \dot{\hat a}_k &= \Gamma_k Y_k(q, \dot q)^\top e_k                   \tag{2}

    with :math:`J(q) \psi = Y_k(q, \psi) a_k`, so that :math:`\hat J \dot q - \dot x = Y_k(q, \dot q)\, \tilde a_k` with
    :math:`\tilde a_k = \hat a_k - a_k`. The error :math:`e_k` comes from the reference generator, and so does the
    weight :math:`\alpha = \mathrm{task\_weight}` of the task in the Lyapunov function:

    .. math::

        S &= \tfrac12 \alpha |\tilde a_k|^2_{\Gamma_k^{-1}}                  \tag{3} \\
        \dot S &= \alpha\, e_k^\top (\hat J \dot q - \dot x)                 \tag{4}

    The position itself is linear in the translations: :math:`e_x = f(q, \hat a_k) - x` is :math:`W_k(q)\, \tilde a_k`,
    without any derivative. With R this prediction error drives the estimate too (composite adaptation); with
    forgetting it is least squares over about the last :math:`1/\mathrm{forgetting}` seconds. With
    :math:`G = \tfrac12 (G_k + G_k^\top)`, which equals :math:`G_k`:

    .. math::

        \dot{\hat a}_k &= P (Y_k(q, \dot q)^\top e_k - W_k(q)^\top R\, e_x), \quad
                           P = (\operatorname{diag}(1/\Gamma_k) + G)^{-1}                            \tag{5} \\
        \dot G_k &= -\mathrm{forgetting}\, G + W_k(q)^\top R\, W_k(q)                              \tag{6} \\
        S &= \tfrac12 \alpha |\tilde a_k|^2_{\Gamma_k^{-1}} + \tfrac12 \alpha |\tilde a_k|^2_G       \tag{7} \\
        \dot S &= \alpha\, e_k^\top (\hat J \dot q - \dot x)
                  - \tfrac12 \alpha |e_x|^2_R - \tfrac12 \alpha\, \mathrm{forgetting}\, |\tilde a_k|^2_G \tag{8}

    With R alone :math:`P = \Gamma_k`, and (8) dissipates :math:`\alpha |e_x|^2_R`.

    Parameters
    ----------
    Gamma_k : (h, h), positive definite, or its diagonal
        Adaptation gain. A larger gain adapts faster and passes more noise of the measured position.
    adapt : all, links or tool
        The translations that are adapted: those between joints, that of the tool, or both. The others are known.
    start_error : (h,), m
        Initial error of the estimate.
    a_k_hat_box : [lower, upper]
        Interval onto which the estimate is projected, so that the Jacobian keeps full rank.
    R : diagonal (m,), 1/s, > 0
        Composite adaptation, off by default: weight of the position's prediction error. A larger weight adapts faster.
        With the sampling period :math:`T`, :math:`\Gamma_k R T` times the number of adapted translations has to be well
        below 2.
    forgetting : scalar, 1/s, > 0
        Forgetting rate of least squares, off by default; requires `R`. :math:`\Gamma_k` is then the upper bound of the
        gain.

    Notes
    -----
    Not for: a robot without an external measurement of the tool position x. With R, x must be measured in the base
    frame of the robot; without R only changes of x are used.

    References
    ----------
    [WangTAC2020]_ eqs. (4), (13), (22); [SlotineLi1991]_ section 8.7 for the fit.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("e_k", "m", "m"),
        Input("x", "m", "m"),
    )
    outputs = (Output("J_hat", "m n", "m/rad", full_rank=True),)
    estimates = (Adapted("a_k_hat", "h", "m", gain="Gamma_k", ball=True, memory="G_k"),)
    driven_by: ClassVar[str] = "e_k"
    truth = (Input("dx", "m", "m/s"), Input("task_weight"))

    Gamma_k: Gain = PositiveDefinite("h")
    adapt: Literal["all", "links", "tool"] = "all"
    start_error: Diagonal = Real("h", "m", default=0.0)
    R: Diagonal | None = Positive("m", "1/s", default=None)
    forgetting: Scalar | None = Positive("", "1/s", default=None)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """h: three elements per translation."""
        links = robot.joint_names
        places = {"all": (*links, "tool"), "links": links, "tool": ("tool",)}[self.adapt]
        return {"h": [Element(f"{place} {axis}", "m") for place in places for axis in "xyz"]}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"J_hat": p.robot.jacobian(u.q, self._with(p.robot, x.a_k_hat))})

    def direction(self, u: Signals, x: Signals, p: Signals, e_k: SX) -> Mapping[str, SX]:
        """(2), but for the gain."""
        return {"a_k_hat": self._columns(p.robot.kinematic_regressor(u.q, u.dq)).T @ e_k}

    def fits(self, u: Signals, x: Signals, p: Signals) -> Mapping[str, Fit]:
        """(5) and (6): the position's prediction error, which is linear in the estimate."""
        x_hat = p.robot.position(u.q, self._with(p.robot, x.a_k_hat))
        return {"a_k_hat": Fit(x_hat - u.x, self._columns(p.robot.position_regressor(u.q)), p.R)}

    def nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
        """The true translations plus `start_error`."""
        return {"a_k_hat": self._adapted(p.robot.a_k) + p.start_error}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4); with a fit (7) and (8)."""
        dx_err = self.equations(u, x, p).outputs["J_hat"] @ u.dq - truth.dx
        return Certificate(
            estimates={"a_k_hat": TrueValue(self._adapted(p.robot.a_k), truth.task_weight)},
            supply=truth.task_weight * ca.dot(u.e_k, dx_err),
            task=True,
        )

    def _columns(self, regressor: SX) -> SX:
        """The columns of the adapted parameters."""
        return regressor if self.adapt == "all" else _PARTS[self.adapt](regressor)

    def _adapted(self, a_k: SX) -> SX:
        """The adapted ones of all kinematic parameters."""
        return a_k if self.adapt == "all" else _PARTS[self.adapt](a_k)

    def _with(self, robot: Any, estimate: SX) -> SX:
        """All kinematic parameters, the adapted ones replaced by their estimates."""
        known = robot.a_k
        if self.adapt == "all":
            return estimate
        return ca.vertcat(*([estimate, tool(known)] if self.adapt == "links" else [links(known), estimate]))


@operation
def links(a: SX) -> SX:
    """The translations between joints, or their columns: all but the last three."""
    return a[:-3] if a.is_column() else a[:, :-3]


@operation
def tool(a: SX) -> SX:
    """The translation to the tool, or its columns: the last three."""
    return a[-3:] if a.is_column() else a[:, -3:]


_PARTS: Final = {"links": links, "tool": tool}
