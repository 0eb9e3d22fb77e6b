"""Velocity command with a small random part: what the delay of a robot is fitted from."""

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
    r"""Adds to the reference velocity a small one whose sign is tossed for each joint at each sample.

        dq_c = dq_r + probe sign(toss) for the first `lasting` seconds, then dq_r

    Smooth motion alone does not show how late the robot answers, since a delay looks like inertia. `dmframe delay` fits
    it from a run with this block.

    Parameters
    ----------
    probe : diagonal (n,), rad/s, > 0
        Small against the motion, large against what the encoder's noise makes of velocities.
    lasting : scalar, s, > 0
        How long it goes on.

    Notes
    -----
    Not for: a robot whose servo does not take a command of this size, such as one that stands in stiction.

    References
    ----------
    [Ljung1999]_, on signals that excite.
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
        """The reference velocity with the small one, while it lasts."""
        added = (x.since < p.lasting) * p.probe * (2 * (u.toss > 0) - 1)
        return Equations(outputs={"dq_c": u.dq_r + added}, next={"since": x.since + u.T})
