"""Blocks as a user might write them, together with the graph that uses them, each with a certificate."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Lemma, Square
from dmframe.block.parameter import Diagonal, Positive
from dmframe.block.port import Input, Output, State


@final
class FilteredDamping(AbstractBlock):
    r"""Damping through a first-order filter, a torque on top of the compensation.

    .. math::

        \dot y &= -k y + \sigma, \quad \tau_{task} = -\beta y   \tag{1} \\
        S &= \tfrac12 |y|^2_\beta, \quad \dot S = -|y|^2_{\beta k} - \sigma^\top \tau_{task}   \tag{2}

    Parameters
    ----------
    beta : diagonal (n,), N m/rad, > 0
        Stiffness.
    k : diagonal (n,), 1/s, > 0
        Corner of the filter.
    """

    inputs = (Input("sigma", "n", "rad/s"),)
    outputs = (Output("tau_task", "n", "N m"),)
    states = (State("y", "n", "rad"),)

    beta: Diagonal = Positive("n", "N m/rad")
    k: Diagonal = Positive("n", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_task": -p.beta * x.y}, rates={"y": -p.k * x.y + u.sigma})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2)."""
        return Certificate(
            storage=(Square(x.y, p.beta),),
            dissipation=(Square(x.y, p.beta * p.k),),
            supply=ca.dot(u.sigma, p.beta * x.y),
        )


@final
class SaturatedDamping(AbstractBlock):
    r"""Damping that never exceeds beta.

    .. math:: \tau_{task} = -\beta \tanh(\sigma / v), \quad 0 = -\sigma^\top \beta \tanh(\sigma / v) + supply   \tag{1}

    Parameters
    ----------
    beta : diagonal (n,), N m, > 0
        Its bound.
    v : diagonal (n,), rad/s, > 0
        Velocity at which it reaches three quarters of that.
    """

    inputs = (Input("sigma", "n", "rad/s"),)
    outputs = (Output("tau_task", "n", "N m"),)

    beta: Diagonal = Positive("n", "N m")
    v: Diagonal = Positive("n", "rad/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_task": -p.beta * ca.tanh(u.sigma / p.v)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(1): tanh never decreases."""
        still = ca.SX.zeros(u.sigma.shape)
        return Certificate(
            dissipation=(Lemma(p.beta, u.sigma, still, p.v),),
            supply=ca.dot(u.sigma, p.beta * ca.tanh(u.sigma / p.v)),
        )


@final
class OddDamping(AbstractBlock):
    """The same, written with tanh(-sigma): provable only with the fact that tanh is odd.

    Parameters
    ----------
    beta, v
        As above.
    """

    inputs = (Input("sigma", "n", "rad/s"),)
    outputs = (Output("tau_task", "n", "N m"),)

    beta: Diagonal = Positive("n", "N m")
    v: Diagonal = Positive("n", "rad/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """tau_task = beta tanh(-sigma / v)."""
        return Equations(outputs={"tau_task": p.beta * ca.tanh(-u.sigma / p.v)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """As above."""
        still = ca.SX.zeros(u.sigma.shape)
        return Certificate(
            dissipation=(Lemma(p.beta, u.sigma, still, p.v),),
            supply=ca.dot(u.sigma, p.beta * ca.tanh(u.sigma / p.v)),
        )
