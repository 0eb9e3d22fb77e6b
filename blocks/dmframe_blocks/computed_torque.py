"""Reference acceleration of computed torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Assumption,
    Certificate,
    Condition,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    Square,
    StableLinear,
    named,
    sentence,
)


@final
class ComputedTorque(AbstractBlock):
    r"""Reference acceleration for which the joint error decays; an inverse-dynamics torque realises it.

    .. math::

        \ddot q_{ref} &= \ddot q_d - 2 \bar\alpha\, (\dot q - \dot q_d) - \bar\alpha^2 \Delta q   \tag{1} \\
        s^\star       &= \dot q - \dot q_d + \bar\alpha\, \Delta q                           \tag{2}

    with :math:`\Delta q = q - q_d`, and :math:`\dot q_{ref} = \dot q` for the regressor:

    .. math::

        S &= \tfrac12 |s^\star|^2                                                                       \tag{3} \\
        \dot S &= -\bar\alpha |s^\star|^2 + {s^\star}^\top (\ddot q - \ddot q_{ref})                     \tag{4}

    Parameters
    ----------
    alpha_bar : scalar, 1/s, > 0
        Decay rate of the error with correct estimates. A larger value requires more torque.

    References
    ----------
    [WangTAC2020]_ eqs. (59), (60).
    """

    renamed: ClassVar[Mapping[str, str]] = {"alpha": "alpha_bar"}
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_d", "n", "rad"),
        Input("dq_d", "n", "rad/s", derivative_of="q_d"),
        Input("ddq_d", "n", "rad/s^2", derivative_of="dq_d"),
    )
    outputs = (
        Output("dq_ref", "n", "rad/s"),
        Output("ddq_ref", "n", "rad/s^2"),
        Output("s_star", "n", "rad/s"),
    )
    truth = (Input("ddq", "n", "rad/s^2"), Input("direct"))

    alpha_bar: Scalar = Positive("", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        q_err, dq_err = u.q - u.q_d, u.dq - u.dq_d
        return Equations(
            outputs={
                "dq_ref": u.dq,
                "ddq_ref": u.ddq_d - 2 * p.alpha_bar * dq_err - p.alpha_bar * p.alpha_bar * q_err,
                "s_star": dq_err + p.alpha_bar * q_err,
            }
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(3) and (4) for direct adaptation; no storage for indirect adaptation."""
        outputs, q_err = self.equations(u, x, p).outputs, u.q - u.q_d
        s_star = named("s_star", outputs["s_star"])
        driven = (StableLinear((q_err,), ((-p.alpha_bar,),), (q_err,)),)
        if truth.direct.is_zero():
            return Certificate(linear=driven)
        return Certificate(
            storage=(Square(s_star),),
            dissipation=(Square(s_star, p.alpha_bar),),
            supply=ca.dot(s_star, truth.ddq - outputs["ddq_ref"]),
            linear=driven,
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """With indirect adaptation only the prediction error is shown to vanish, so an assumption is needed."""
        if truth.direct.is_zero():
            text = sentence(
                "{M_hat} stays uniformly positive definite, so that where the prediction error vanishes the tracking "
                "error satisfies its stable linear equation"
            )
            return (Assumption(text, "eqs. (54), (58)"),)
        return ()
