"""Direct adaptation of physically consistent inertial parameters."""

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
    solve_spd,
)
from dmframe_blocks._bodies import moved, natural, storage, weight


@final
class ConsistentAdaptation(AbstractBlock):
    r"""Direct adaptation by the tracking error that keeps the estimates of all links physically consistent.

    .. math::

        \epsilon = \hat M^{-1} s^\star                       \tag{1}

    The adaptation law is that of `consistent_compensator`, with :math:`g = Y_d^\top \epsilon`. The storage function is
    the divergence of the estimated bodies from the true ones, with

    .. math::

        \dot S = -\epsilon^\top Y_d (\hat a_d - a_d)   \tag{2}

    The mass matrix of physically consistent parameters is positive definite in every pose. The inverse of
    :math:`\hat M`, which a gradient law has to assume, therefore exists.

    Parameters
    ----------
    c : scalar, > 0
        Adaptation gain of the inertial parameters, relative to their size: estimates of heavy links change more.
    Gamma : scalar, > 0
        Adaptation gain of friction and of all other parameters that are not inertial.
    floor : scalar, > 0
        Lower bound of an estimated pseudo-inertia as a fraction of the nominal one, at most 1, for the projection
        described in `consistent_compensator`. Without it there is no projection.

    Notes
    -----
    Not for: a regressor with separate parameters of `gravity`, which would be adapted as non-inertial ones; a robot
    without a nominal model.

    The output `direct` is 1: the tracking error drives the adaptation.

    References
    ----------
    [LeeKwonPark2018]_; [WangTAC2020]_ for the law by the tracking error.
    """

    inputs = (
        Input("Y_d", "n p", "N m"),
        Input("M_hat", "n n", "N m s^2/rad"),
        Input("s_star", "n", "rad/s"),
        Input("a_d_nominal", "p", ""),
    )
    outputs = (Output("a_d_hat", "p", ""), Output("epsilon", "n", "rad^2/(N m s^3)"))
    states = (State("a_d_hat", "p", "", bodies="floor", nominal="a_d_nominal"),)
    truth = (Input("a_d", "p", ""),)

    c: Scalar = Positive("", "s^2/rad^2")
    Gamma: Scalar = Positive(default=1.0, several=True)
    floor: Scalar | None = Positive(default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), and the law of the text."""
        epsilon = solve_spd(u.M_hat, u.s_star)
        g, n, outputs = u.Y_d.T @ epsilon, epsilon.shape[0], {"a_d_hat": x.a_d_hat, "epsilon": epsilon}
        if "floor" in p:
            return Equations(outputs, {"a_d_hat": natural(g, u.a_d_nominal, n, p.c, p.Gamma)})
        rate, second = moved(x.a_d_hat, g, n, p.c, p.Gamma)
        return Equations(outputs, {"a_d_hat": rate}, second={"a_d_hat": second})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """The inertial parameters of the nominal model."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2)."""
        epsilon = solve_spd(u.M_hat, u.s_star)
        n, supply = epsilon.shape[0], -ca.dot(epsilon, u.Y_d @ (x.a_d_hat - truth.a_d))
        if "floor" in p:
            metric = weight(u.a_d_nominal, n, p.c, p.Gamma)
            estimates = {"a_d_hat": TrueValue(truth.a_d, metric)}
            return Certificate(estimates=estimates, supply=supply, truth={"direct": 1})
        return Certificate(storage=storage(x.a_d_hat, truth.a_d, n, p.c, p.Gamma), supply=supply, truth={"direct": 1})
