"""Adaptive compensation whose estimated bodies stay physical ones."""

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
    r"""Compensates the dynamics, and no link's estimate ever leaves the set of bodies that there can be.

    .. math::

        \tau_{dc} &= Y_d \hat a_d + \tau_{task}          \tag{1}

    The ten estimates of a link make up its pseudo-inertia :math:`\hat P`, which is positive definite if and only if
    some distribution of mass has them. With :math:`g = Y_d^\top \sigma` and the symmetric Q for which
    :math:`\mathrm{tr}(Q P(a)) = g^\top a` for all a, it moves by :math:`-c \hat P Q \hat P`; friction and all else that
    is no body's moves by :math:`-\Gamma g`. What is stored is the divergence from the true body, whose rate is that of
    the plain gradient's square:

    .. math::

        \dot S = -\sigma^\top Y_d (\hat a_d - a_d)   \tag{2}

    So it takes the gradient's place in every proof. As V does not grow, :math:`\hat P` stays in a compact set of
    positive definite matrices: masses above zero, centres of mass inside, and an estimated mass matrix that can be
    inverted. On a clock of T, :math:`\hat P` becomes :math:`A \hat P A^\top`,
    :math:`A = 1 - \tfrac12 c T \hat P Q`: however long the step, no eigenvalue falls below zero.

    With `floor` the metric stays that of the nominal body :math:`P_0`: :math:`\hat P` moves by :math:`-c P_0 Q P_0`, a
    gradient's law of a constant gain, and is projected onto :math:`\hat P \ge \mathrm{floor}\, P_0`. What is stored is
    half of :math:`\mathrm{tr}(P_0^{-1} (\hat P - P) P_0^{-1} (\hat P - P)) / c`, of the same rate. In that metric the
    nearest body has a closed form, to which a sample returns; it raises nothing where the true body is in the set.

    Parameters
    ----------
    c : scalar, 1/J, > 0
        Adaptation gain of the bodies: in proportion to what they are, heavy ones move more.
    Gamma : scalar, > 0
        Adaptation gain of friction, and of all else that is no body's.
    floor : scalar, > 0
        The least share of its nominal body that an estimated one may be, 1 at most: then a projection keeps it a body.
        Left out, the law does so by itself.

    Notes
    -----
    Not for: a regressor whose `gravity` stands apart, of which the weights would move as no body's; a robot without a
    nominal model. Near the edge of the set estimates move slowly, where the gradient would pass it: a fit by bodies
    that there cannot be may be the faster one. With a `floor` they move as fast there as anywhere, and along the edge.

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
        """The nominal model's bodies."""
        return {"a_d_hat": u.a_d_nominal}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2)."""
        n, supply = u.sigma.shape[0], -ca.dot(u.sigma, u.Y_d @ (x.a_d_hat - truth.a_d))
        if "floor" in p:
            metric = weight(u.a_d_nominal, n, p.c, p.Gamma)
            return Certificate(estimates={"a_d_hat": TrueValue(truth.a_d, metric)}, supply=supply)
        return Certificate(storage=storage(x.a_d_hat, truth.a_d, n, p.c, p.Gamma), supply=supply)
