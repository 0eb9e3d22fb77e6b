"""Adaptation by the tracking error whose estimated bodies stay physical ones."""

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
    r"""Adapts by the tracking error, and no link's estimate ever leaves the set of bodies that there can be.

    .. math::

        \epsilon = \hat M^{-1} s^\star                       \tag{1}

    The estimates move as those of `consistent_compensator`, by :math:`g = Y_d^\top \epsilon`. With the divergence of
    the estimated bodies from the true ones as what is stored,

    .. math::

        \dot S = -\epsilon^\top Y_d (\hat a_d - a_d)   \tag{2}

    The mass matrix of bodies is positive definite at every pose. So that :math:`\hat M` has an inverse, which the
    gradient's law takes for granted, follows.

    Parameters
    ----------
    c : scalar, > 0
        Adaptation gain of the bodies: in proportion to what they are, heavy ones move more.
    Gamma : scalar, > 0
        Adaptation gain of friction, and of all else that is no body's.
    floor : scalar, > 0
        The least share of its nominal body that an estimated one may be, 1 at most, of the projection that
        `consistent_compensator` describes. Left out, there is none.

    Notes
    -----
    Not for: a regressor whose `gravity` stands apart, of which the weights would move as no body's; a robot without a
    nominal model.

    `direct` says that the tracking error drives the adaptation: 1.

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
        """The nominal model's bodies."""
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
