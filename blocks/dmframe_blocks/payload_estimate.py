"""Estimated mass and centre of the load."""

from __future__ import annotations

from typing import Any, final

import casadi as ca

from dmframe.block import AbstractBlock, Certificate, Equations, Input, Output, Positive, Scalar, Signals, operation


@final
class PayloadEstimate(AbstractBlock):
    r"""Computes mass and centre of a load from its estimated parameters.

    The mass is the first estimate of a `payload_regressor`; the centre is the next three divided by the mass, minus the
    tool's offset. For masses below `least` the centre cannot be determined, and the output is zero. A run reports the
    means over its last eighth, and how well the estimates were excited.

    Parameters
    ----------
    least : scalar, kg, > 0
        Smallest mass that counts as a load.

    References
    ----------
    [Siciliano2009]_ Section 7.2.
    """

    uses_robot = True
    inputs = (Input("a_d_hat", "p"),)
    outputs = (
        Output("m_load_hat", "", "kg", shown="mass of the load"),
        Output("c_load_hat", "3", "m", shown="its centre from the tool, in the last joint's frame"),
    )

    least: Scalar = Positive("", "kg", default=0.2)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Mass and centre."""
        return Equations({"m_load_hat": mass(u.a_d_hat), "c_load_hat": center(u.a_d_hat, p.robot.a_k, p.least)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate()


@operation
def mass(a: Any) -> Any:
    """The mass, the first of a load's parameters."""
    return a[0]


@operation
def center(a: Any, a_k: Any, least: Any) -> Any:
    """First moments divided by the mass, relative to the tool; zero if the mass is too small."""
    return ca.if_else(a[0] > least, a[1:4] / ca.fmax(a[0], least) - a_k[-3:], ca.SX.zeros(3))
