"""Velocity command with a small random excitation, for identification of the robot's delay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from pydantic import model_validator

from dmframe.block import (
    PERIOD,
    SX,
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
from dmframe_blocks._excitation import check_seed, following, seeded, sign


@final
class VelocityProbe(AbstractBlock):
    r"""Adds to the reference velocity a small excitation with a random sign for each joint and sample.

        dq_c = dq_r + probe s for the first `lasting` seconds, then dq_r
        s = 1 if draw > m/2, else -1,    draw(next) = 48271 draw mod m,    m = 2^31 - 1

    The signs s are those of a linear congruential generator: the block computes them on a robot as in a simulation.

    Smooth motion is not sufficient to identify the delay, which cannot be distinguished from inertia. `dmframe delay`
    fits it from a run with this block.

    Parameters
    ----------
    probe : diagonal (n,), rad/s, > 0
        Amplitude: small compared with the motion, large compared with the velocity noise of the encoder.
    lasting : scalar, s, > 0
        Duration of the excitation.
    seed : number, > 0
        Whole number that determines the signs.

    Notes
    -----
    Not for: a robot whose servo does not respond to a command of this size, for example due to stiction.

    References
    ----------
    [Ljung1999]_, on exciting signals; [ParkMiller1988]_, on the generator.
    """

    inputs = (
        Input("dq_r", "n", "rad/s"),
        PERIOD,
    )
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)
    states = (State("since", "", "s", sampled=True), State("draw", "n", sampled=True, recorded=False))

    probe: Diagonal = Positive("n", "rad/s", default=0.01)
    lasting: Scalar = Positive("", "s", default=3.0)
    seed: Scalar = Positive(default=1.0)

    @model_validator(mode="after")
    def _fits(self) -> VelocityProbe:
        check_seed(self.seed)
        return self

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The first values of the generators."""
        return {"draw": seeded(p.seed, u.dq_r.shape[0])}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The reference velocity with the excitation for its duration."""
        added = (x.since < p.lasting) * p.probe * sign(x.draw)
        return Equations(outputs={"dq_c": u.dq_r + added}, next={"since": x.since + u.T, "draw": following(x.draw)})
