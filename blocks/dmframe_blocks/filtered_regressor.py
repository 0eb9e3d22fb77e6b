"""Prediction error of a filtered dynamic model, without accelerations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Certificate,
    Diagonal,
    Element,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    StableLinear,
    State,
    TrueValue,
    derivative,
    named,
)
from dmframe.common.errors import ValueFault
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters, Friction, Part


@final
class FilteredRegressor(AbstractBlock):
    r"""Compares the filtered command of a PI servo with the command predicted by the estimates for the same motion.

    Both sides of the dynamics, divided by the servo's velocity gain, pass a first-order filter with the rate
    :math:`\mathrm{bandwidth}`. The acceleration is removed by parts: with :math:`Y_m a_d = M \dot q`, and
    :math:`C^\top \dot q = \partial(\tfrac12 \dot q^\top M \dot q)/\partial q`, the motion requires the torque
    :math:`\tfrac{d}{dt}(Y_m a_d) - C^\top \dot q + B \dot q + D \phi(\dot q) + g = \tfrac{d}{dt}(Y_m a_d) + Y_r a_d`.
    Filtered, its regressor is :math:`Y_f = \mathrm{bandwidth}\, Y_m + Y_z` with
    :math:`\dot Y_z = \mathrm{bandwidth} (Y_r - Y_f)`, and with :math:`W = \mathrm{weight}`:

    .. math::

        \dot v_f &= \mathrm{bandwidth} (\dot q_c - \dot q - v_f), \quad
        \dot q_f = \mathrm{bandwidth} (q - q_c - q_f)                                       \tag{1} \\
        e &= w\, Y_f \hat a_d + w_I q_f + \hat b - v_f, \quad e_f = W e                  \tag{2} \\
        \dot{\hat b} &= -\Gamma_b e_f                                                       \tag{3}

    products element by element. No torque is measured, and there is no division by an estimate: with
    :math:`K_\star = K K_P`, the constant offset of the servo's integrator :math:`b = K_I (i - q + q_c) / K_P`, and the
    errors :math:`\tilde a_d = \hat a_d - a_d`, :math:`\tilde w = w - 1/K_\star`, :math:`\tilde w_I = w_I - K_I/K_P` and
    :math:`\tilde b = \hat b - b`,

    .. math::

        K_\star e &= Y_f \tilde a_d + K_\star (\tilde w Y_f \hat a_d + \tilde w_I q_f + \tilde b) + h \tag{4} \\
        h &= Y_f a_d + K K_I q_f - K_\star v_f + K_\star b                                                  \tag{5}

    h, with :math:`\dot h = -\mathrm{bandwidth}\, h`, is the decaying effect of the filters' initial state; it is zero
    if they start at rest, as here. With a_d_hat, w and w_I adapted by e_f and the regressors of (4):

    .. math::

        S &= \tfrac12 |h|^2_{W/(\mathrm{bandwidth}\, K_\star)} + \tfrac12 |\tilde b|^2_{K_\star/\Gamma_b} \tag{6} \\
        \dot S &= -\tfrac12 |e|^2_{W K_\star} - \tfrac12 |e - h/K_\star|^2_{W K_\star}
                  - \tfrac12 |h|^2_{W/K_\star}
                  + e_f^\top (K_\star e - K_\star \tilde b - h)                       \tag{7}

    Parameters
    ----------
    bandwidth : scalar, 1/s, > 0
        A larger bandwidth forgets faster and passes more noise.
    weight : diagonal (n,), > 0
        Weight of the prediction error relative to the tracking error in composite adaptation.
    friction : list of viscous, coulomb
        Same as in the `regressor` with which it shares :math:`a_d`.
    bias : true or false
        Same as in that regressor: :math:`a_d` includes the offset of the servo's integrator.
    Gamma_b : diagonal (n,), 1/s, > 0
        Without `bias`, the gain with which the offset is estimated here.

    Notes
    -----
    Not for: a PID servo, whose command has one more gain ratio.

    References
    ----------
    [SlotineLi1991]_ section 9.2 for the filter by parts; [WangTAC2020]_ eqs. (49)-(58) for the unfiltered law.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_c", "n", "rad"),
        Input("dq_c", "n", "rad/s"),
        Input("a_d_hat", "p", ""),
        Input("w", "n", "rad/(N m s)"),
        Input("w_I", "n", "1/s"),
    )
    outputs = (
        Output("Y_f", "n p", "N m"),
        Output("e_f", "n", "rad/s"),
        Output("tau_f", "n", "N m"),
        Output("q_f", "n", "rad"),
    )
    states = (
        State("Y_z", "n p", "N m"),
        State("v_f", "n", "rad/s"),
        State("q_f", "n", "rad"),
        State("b_hat", "n", "rad/s", optional=True),
    )
    truth = (
        Input("a_d", "p", ""),
        Input("K", "n", "N m/V"),
        Input("K_P", "n", "V s/rad"),
        Input("K_I", "n", "V/rad"),
        Input("i", "n", "rad"),
    )

    bandwidth: Scalar = Positive("", "1/s")
    weight: Diagonal = Positive("n", default=1.0)
    friction: tuple[Friction, ...] = ("viscous",)
    bias: bool = False
    Gamma_b: Diagonal | None = Positive("n", "1/s", default=None)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """p: as in the regressor."""
        return {"p": self._parameters(robot).elements}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (3)."""
        if self.bias == ("Gamma_b" in p):
            raise ValueFault(
                "filtered_regressor: expected either bias: true or a Gamma_b, to estimate the offset of the servo's "
                f"integrator; found {'both' if self.bias else 'neither'}"
            )
        Y_f = self._filtered(u, x, p)
        e_f = p.weight * self._error(Y_f, u, x)
        return Equations(
            outputs={"Y_f": Y_f, "e_f": e_f, "tau_f": Y_f @ u.a_d_hat, "q_f": x.q_f},
            rates={
                "Y_z": p.bandwidth * (self._rest(u, p) - Y_f),
                "v_f": p.bandwidth * (u.dq_c - u.dq - x.v_f),
                "q_f": p.bandwidth * (u.q - u.q_c - x.q_f),
                **({} if self.bias else {"b_hat": -p.Gamma_b * e_f}),
            },
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """Filters at zero."""
        return {"Y_z": -p.bandwidth * self._momentum(u, p)}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(6) and (7)."""
        K_star, Y_f = named("K_star", truth.K * truth.K_P), self._filtered(u, x, p)
        error = self._error(Y_f, u, x)
        offset = truth.K * truth.K_I * (truth.i - u.q + u.q_c)
        h = Y_f @ truth.a_d + truth.K * truth.K_I * x.q_f - K_star * x.v_f
        explained, learned = K_star * error, dict[str, TrueValue]()
        if not self.bias:
            h, explained = h + offset, explained - K_star * (x.b_hat - offset / K_star)
            learned["b_hat"] = TrueValue(offset / K_star, K_star / p.Gamma_b)
        return Certificate(
            storage=(Square(h, p.weight / (p.bandwidth * K_star)),),
            estimates=learned,
            dissipation=(
                Square(error, p.weight * K_star / 2),
                Square(error - h / K_star, p.weight * K_star / 2),
                Square(h, p.weight / (2 * K_star)),
            ),
            supply=ca.dot(p.weight * error, explained - h),
            linear=tuple(StableLinear((ca.vec(f),), ((-p.bandwidth,),), (ca.vec(f),)) for f in (x.v_f, x.q_f, x.Y_z)),
        )

    def _filtered(self, u: Signals, x: Signals, p: Signals) -> SX:
        """Y_f."""
        return p.bandwidth * self._momentum(u, p) + x.Y_z

    def _error(self, Y_f: SX, u: Signals, x: Signals) -> SX:
        error = u.w * (Y_f @ u.a_d_hat) + u.w_I * x.q_f - x.v_f
        return error if self.bias else error + x.b_hat

    def _momentum(self, u: Signals, p: Signals) -> SX:
        """Y_m of Y_m a_d = M dq."""
        a_d = self._parameters(p.robot.chain)
        others = ca.DM.zeros(p.robot.n, a_d.size - a_d.inertial.stop)
        return named("Y_m", ca.horzcat(self._inertial(u, p), others) if others.numel() else self._inertial(u, p))

    def _inertial(self, u: Signals, p: Signals) -> SX:
        """The columns of Y_m for the inertial parameters."""
        return named("Y_p", ca.densify(p.robot.momentum_regressor(u.q, u.dq)))

    def _rest(self, u: Signals, p: Signals) -> SX:
        """Y_r of Y_r a_d = -C' dq + B dq + D phi(dq) + g, and the bias."""
        robot, zero = p.robot, ca.DM.zeros(p.robot.n)
        energy = self._inertial(u, p).T @ u.dq / 2
        columns: dict[Part, SX] = {
            "inertial": robot.regressor(u.q, zero, zero, zero) - derivative(energy, u.q).T,
            "viscous": ca.diag(u.dq),
            "coulomb": ca.diag(robot.coulomb(u.dq)),
            "bias": ca.DM.eye(robot.n),
        }
        return named("Y_r", ca.densify(ca.horzcat(*self._parameters(robot.chain).in_order(columns))))

    def _parameters(self, chain: SerialChain) -> DynamicParameters:
        return DynamicParameters(chain, self.friction, bias=self.bias)
