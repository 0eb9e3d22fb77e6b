"""Velocity command with a small random excitation, for identification of the robot's delay."""

from __future__ import annotations

from typing import final

from dmframe.block import (
    PERIOD,
    AbstractBlock,
    Access,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
)


@final
class VelocityProbe(AbstractBlock):
    r"""Adds to the reference velocity a small excitation with a random sign for each joint and sample.

        dq_c = dq_r + probe sign(toss) for the first `lasting` seconds, then dq_r

    Smooth motion is not sufficient to identify the delay, which cannot be distinguished from inertia. `dmframe delay`
    fits it from a run with this block.

    Parameters
    ----------
    probe : diagonal (n,), rad/s, > 0
        Amplitude: small compared with the motion, large compared with the velocity noise of the encoder.
    lasting : scalar, s, > 0
        Duration of the excitation.

    Notes
    -----
    Not for: a robot whose servo does not respond to a command of this size, for example due to stiction.

    References
    ----------
    [Ljung1999]_, on exciting signals.
    """

    inputs = (
        Input("dq_r", "n", "rad/s"),
        Input("toss", "n", drawn="uniform"),
        PERIOD,
    )
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)
    states = (State("since", "", "s", sampled=True),)

    probe: Diagonal = Positive("n", "rad/s", default=0.01)
    lasting: Scalar = Positive("", "s", default=3.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The reference velocity with the excitation for its duration."""
        added = (x.since < p.lasting) * p.probe * (2 * (u.toss > 0) - 1)
        return Equations(outputs={"dq_c": u.dq_r + added}, next={"since": x.since + u.T})
