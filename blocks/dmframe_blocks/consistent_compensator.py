"""Adaptive dynamic compensation with physically consistent inertial parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    TrueValue,
)
from dmframe_blocks._bodies import moved, natural, storage, weight


@final
class ConsistentCompensator(AbstractBlock):
    r"""Adaptive dynamic compensation that keeps the estimates of all links physically consistent.

    .. math::

        \tau_{dc} &= Y_d \hat a_d + \tau_{task}          \tag{1}

    The ten estimates of a link form its pseudo-inertia :math:`\hat P`, which is positive definite if and only if a
    mass distribution with these parameters exists. With :math:`g = Y_d^\top \sigma` and the symmetric Q for which
    :math:`\mathrm{tr}(Q P(a)) = g^\top a` for all a, its rate is :math:`-c \hat P Q \hat P`. The rate of friction and
    all other parameters is :math:`-\Gamma g`. The storage function is the divergence from the true body; its rate
    equals that of the quadratic storage of a gradient law:

    .. math::

        \dot S = -\sigma^\top Y_d (\hat a_d - a_d)   \tag{2}

    The law can therefore replace the gradient law in every proof. V does not increase, so :math:`\hat P` stays in a
    compact set of positive definite matrices: the masses are positive and the estimated mass matrix is invertible. On
    a clock with period T, :math:`\hat P` becomes :math:`A \hat P A^\top`,
    :math:`A = 1 - \tfrac12 c T \hat P Q`: no eigenvalue becomes negative, for any T.

    With `floor` the metric is that of the nominal body :math:`P_0`: the rate of :math:`\hat P` is :math:`-c P_0 Q P_0`,
    a gradient law with constant gain, and :math:`\hat P` is projected onto :math:`\hat P \ge \mathrm{floor}\, P_0`. The
    storage is half of :math:`\mathrm{tr}(P_0^{-1} (\hat P - P) P_0^{-1} (\hat P - P)) / c`, with the same rate. In
    that metric the projection has a closed form. It does not increase the storage if the true body is in the set.

    Parameters
    ----------
    c : scalar, 1/J, > 0
        Adaptation gain of the inertial parameters, relative to their size: estimates of heavy links change more.
    Gamma : scalar, > 0
        Adaptation gain of friction and of all other parameters that are not inertial.
    floor : scalar, > 0
        Lower bound of an estimated pseudo-inertia as a fraction of the nominal one, at most 1; a projection enforces
        it. Without it the adaptation law itself keeps the estimates consistent.

    Notes
    -----
    Not for: a regressor with separate parameters of `gravity`, which would be adapted as non-inertial ones; a robot
    without a nominal model. Near the boundary of the set the estimates change slowly, so that a gradient law, which
    may leave the set, can converge faster. With `floor` they change at the same rate near the boundary and along it.

    References
    ----------
    [LeeKwonPark2018]_; [Wensing2018]_ for the pseudo-inertia.
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("sigma", "n", "rad/s"),
        Input("tau_task", "n", "N m", optional=True),
        Input("a_d_nominal", "p", ""),
    )
    outputs = (Output("tau_dc", "n", "N m"), Output("a_d_hat", "p", ""))
    states = (State("a_d_hat", "p", "", bodies="floor", nominal="a_d_nominal"),)
    truth = (Input("a_d", "p", ""),)

    c: Scalar = Positive("", "1/J")
    Gamma: Scalar = Positive(default=1.0, several=True)
    floor: Scalar | None = Positive(default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), and the law of the text."""
        g, n, outputs = u.Y_d.T @ u.sigma, u.sigma.shape[0], {"tau_dc": u.Y_d @ x.a_d_hat + u.tau_task}
        outputs["a_d_hat"] = x.a_d_hat
        if "floor" in p:
            return Equations(outputs, {"a_d_hat": natural(g, u.a_d_nominal, n, p.c, p.Gamma)})
        rate, second = moved(x.a_d_hat, g, n, p.c, p.Gamma)
        return Equations(outputs, {"a_d_hat": rate}, second={"a_d_hat": second})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """The inertial parameters of the nominal model."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2)."""
        n, supply = u.sigma.shape[0], -ca.dot(u.sigma, u.Y_d @ (x.a_d_hat - truth.a_d))
        if "floor" in p:
            metric = weight(u.a_d_nominal, n, p.c, p.Gamma)
            return Certificate(estimates={"a_d_hat": TrueValue(truth.a_d, metric)}, supply=supply)
        return Certificate(storage=storage(x.a_d_hat, truth.a_d, n, p.c, p.Gamma), supply=supply)
