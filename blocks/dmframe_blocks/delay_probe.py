"""Identification of the delay from a command to the motion, by a short excitation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, final

import casadi as ca
from pydantic import Field, model_validator

from dmframe.block import (
    ANY,
    PERIOD,
    SX,
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    inverse_spd,
    named,
    operation,
)
from dmframe_blocks._excitation import check_seed, following, seeded, sign
from dmframe_blocks._identified_delay import DELAY_HAT, IDENTIFIED, MOST_DELAY

PERIODS: Final = 25
"""Number of samples over which the period is averaged."""
UNLIKE: Final = 2.5
"""Factor between two periods at which models of a sample no longer apply."""


@final
class DelayProbe(AbstractBlock):
    r"""Excites the joints for some seconds, and identifies the delay from a command to the motion in samples.

    Until the delay is identified, a velocity with a pseudo-random sign s for each joint and sample is added:

        dq_probe = dq_r + probe s
        s = 1 if draw > m/2, else -1,    draw(next) = 48271 draw mod m,    m = 2^31 - 1

    The change of the average velocity v over a sample is regressed on the changes of the last `taps` commands u that
    were sent, with coefficients b common to all joints:

        v(k) - v(k-1) = b_0 (u(k-1) - u(k-2)) + ... + b_(taps-1) (u(k-taps) - u(k-taps-1))

    Smooth motion does not distinguish a delay from inertia; the excitation does. The sums b_0 + ... + b_j are the
    response of the velocity to a step of the command. A sum has reached the `threshold` if it exceeds it by
    `confidence` standard deviations, those of least squares with white residuals. The delay is the number of sums that
    have not, at most `delay_up_to`: an effective delay, which contains a part of the lag of the servo. In doubt it is
    the longer one, since with a delay that is too short the loop can diverge. It is identified once, after `lasting`,
    if the last sum has reached the threshold. Otherwise the excitation goes on.

    Blocks with `delay_up_to` use the outputs delay_hat and identified.

    *Trip.* With `tripping` the probe watches the error, as the task law predicts it for the next command: x_err of the
    tool, or q_err of the joints with watched: joints. Its mean square over about `dwell` at the end of the excitation,
    when nothing that needs the delay acts, is the scale. After that

        mean = mean + T/dwell (|x_err|^2 - mean),    tripped if mean > trip^2 scale

    Then the delay counts as unknown: identified returns to 0, and the excitation and the regression go on for
    `lasting`. The new delay is longer by at least one sample, and the scale does not become smaller. With a delay that
    would be longer than `delay_up_to`, or a last sum that does not reach the threshold, it remains unknown; in the
    first case the excitation ends too. So a loop that diverges with the delay is left, at most delay_up_to + 1 times.
    The mean is held during the first `blanking` after the identification: a trial of `expert_aggregation` moves the
    tool.

    It trips as well if the mean of the period over about 25 samples becomes more than 2.5 times as long or as short as
    when the delay was identified, for example since the operator slows the robot down: the servo then responds in other
    numbers of samples, and models of it are wrong. The delay need not be longer after that.

    Parameters
    ----------
    delay_up_to : 1, 2, ..., 8
        Largest delay that can be identified, as in the other blocks.
    taps : number, > 1
        Commands in the regression: they should cover the delay and most of the response, about 0.1 s.
    probe : diagonal (n,), rad/s, > 0
        Amplitude. Behind a ramp that limits accelerations to a_max it should be below a_max T / 2.
    lasting : scalar, s, > 0
        Duration of the excitation.
    settling : scalar, s, >= 0
        Time at the beginning that the regression leaves out: the robot starts to follow its path, and the change of its
        command is then far larger than the excitation.
    threshold : scalar, > 0
        Share of a step of the command that counts as its effect.
    confidence : scalar, >= 0
        Standard deviations by which a sum has to exceed the threshold.
    nu : scalar, rad^2/s^2, > 0
        Regularisation of the least squares problem.
    seed : number, > 0
        Whole number that determines the signs of the excitation.
    tripping : true or false
        With the trip.
    watched : tool or joints
        Whose error the trip watches.
    trip : scalar, > 0
        Largest error, relative to that at the end of the excitation.
    dwell : scalar, s, > 0
        Time over which the error is averaged, with the trip.
    blanking : scalar, s, >= 0
        Time after the identification in which the trip ignores the error: at least that of the trial, if there is one.

    Notes
    -----
    Not for: a robot whose servo does not respond to a command of this size, for example due to stiction, or a delay
    that varies.

    References
    ----------
    [Ljung1999]_, on exciting signals and on finite impulse responses; [ParkMiller1988]_, on the generator of the signs.
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_sent", "n", "rad/s"),
        Input("x_err", "m", "m", optional=True),
        Input("q_err", "n", "rad", optional=True),
        PERIOD,
    )
    outputs = (
        Output("dq_probe", "n", "rad/s"),
        Output(DELAY_HAT.name),
        Output(IDENTIFIED.name),
        Output("tripped", optional=True, notice="the error exceeded its limit, and the delay was identified again"),
    )
    states = (
        State("since", "", "s", sampled=True),
        State("draw", "n", sampled=True, recorded=False),
        State("q_before", "n", "rad", sampled=True),
        State("v_before", "n", "rad/s", sampled=True),
        State("u_before", "n", "rad/s", sampled=True),
        State("changes", "n r", "rad/s", sampled=True, recorded=False),
        State("gathered", "r r", "rad^2/s^2", sampled=True, recorded=False),
        State("correlated", "r", "rad^2/s^2", sampled=True, recorded=False),
        State("varied", "", "rad^2/s^2", sampled=True, recorded=False),
        State(DELAY_HAT.name, sampled=True),
        State(IDENTIFIED.name, sampled=True),
        State("delay_least", sampled=True, optional=True),
        State("error_mean", "", ANY, sampled=True, optional=True),
        State("error_scale", "", ANY, sampled=True, optional=True),
        State("period_mean", "", "s", sampled=True, optional=True),
        State("period_scale", "", "s", sampled=True, optional=True),
    )

    delay_up_to: int = Field(3, ge=1, le=MOST_DELAY)
    taps: int = Field(8, ge=2)
    probe: Diagonal = Positive("n", "rad/s", default=0.03)
    lasting: Scalar = Positive("", "s", default=4.0)
    settling: Scalar = NonNegative("", "s", default=1.0)
    threshold: Scalar = Positive(default=0.35)
    confidence: Scalar = NonNegative(default=1.0)
    nu: Scalar = Positive("", "rad^2/s^2", default=1e-9)
    seed: Scalar = Positive(default=1.0)
    tripping: bool = False
    watched: Literal["tool", "joints"] = "tool"
    trip: Scalar = Positive(default=3.0)
    dwell: Scalar = Positive("", "s", default=1.0)
    blanking: Scalar = NonNegative("", "s", default=0.0)

    @model_validator(mode="after")
    def _fits(self) -> DelayProbe:
        check_seed(self.seed)
        return self

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """R: number of taps."""
        return {**super().sizes(robot), "r": self.taps}

    def needs(self, port: str) -> bool:
        """The watched error, with the trip."""
        return self.tripping and port == {"tool": "x_err", "joints": "q_err"}[self.watched]

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, and the first values of the generators."""
        begins = {"q_before": u.q, "draw": seeded(p.seed, u.q.shape[0])}
        return begins | ({"period_mean": u.T} if self.tripping else {})

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The excitation, the regression, and the delay when the excitation ends."""
        v = named("v", (u.q - x.q_before) / u.T)
        counts = named("counts", (x.since >= p.settling) * (x.identified < 0.5))
        gathered = named("G", x.gathered + counts * (x.changes.T @ x.changes))
        change = counts * (v - x.v_before)
        correlated = named("g_v", x.correlated + x.changes.T @ change)
        varied = named("varied_new", x.varied + ca.sumsqr(change))
        P = named("P", inverse_spd(gathered + p.nu * ca.DM.eye(self.taps)))
        b, freedom = named("b", P @ correlated), ((x.since - p.settling) / u.T + 1) * u.q.shape[0] - self.taps
        variance = named("variance", ca.fmax(0, varied - ca.dot(b, correlated)) / ca.fmax(1, freedom))
        spread = named("spread", p.confidence * ca.sqrt(variance) * deviations(P))
        below = named("below", under(b, spread, p.threshold))
        longer = ca.fmax(below, x.delay_least) if self.tripping else below
        goes_on = x.delay_least <= self.delay_up_to if self.tripping else 1
        ends = named("ends", (x.since >= p.lasting) * (below <= self.taps - 1) * goes_on)
        found = ends * (1 - x.identified)
        tripped, watched = self._watched(u, x, p, counts, ends)
        excitation = (1 - x.identified) * goes_on * p.probe * sign(x.draw)
        return Equations(
            outputs={
                "dq_probe": u.dq_r + excitation,
                DELAY_HAT.name: x.delay_hat,
                IDENTIFIED.name: x.identified,
                **({"tripped": tripped} if watched else {}),
            },
            next={
                DELAY_HAT.name: ca.if_else(x.identified > 0.5, x.delay_hat, ends * ca.fmin(longer, self.delay_up_to)),
                IDENTIFIED.name: ca.fmax(x.identified, ends) * (1 - tripped),
                "since": (1 - tripped) * (1 - found) * (x.since + u.T),
                "draw": following(x.draw),
                "q_before": u.q,
                "v_before": v,
                "u_before": u.dq_sent,
                "changes": ca.horzcat(u.dq_sent - x.u_before, x.changes[:, :-1]),
                "gathered": gathered,
                "correlated": correlated,
                "varied": varied,
                **watched,
            },
        )

    def _watched(self, u: Signals, x: Signals, p: Signals, counts: SX, ends: SX) -> tuple[SX | int, Mapping[str, SX]]:
        """Whether the trip acts, and its states."""
        if not self.tripping:
            return 0, {}
        share = ca.fmax(counts, x.identified * (x.since >= p.blanking)) * ca.fmin(1, u.T / p.dwell)
        error = u.x_err if self.watched == "tool" else u.q_err
        mean = named("mean_new", x.error_mean + share * (ca.sumsqr(error) - x.error_mean))
        period = named("period_new", x.period_mean + (u.T - x.period_mean) / PERIODS)
        ratio = named("ratio", period / ca.fmax(x.period_scale, u.T / UNLIKE**2))
        unlike = named("unlike", ca.fmax(ratio > UNLIKE, ratio < 1 / UNLIKE))
        astray = named("astray", mean > p.trip * p.trip * x.error_scale)
        tripped = named("tripped", x.identified * ca.fmax(astray, unlike))
        known = x.identified > 0.5
        return tripped, {
            "delay_least": ca.if_else(x.identified * astray, x.delay_hat + 1, x.delay_least),
            "error_mean": (1 - tripped) * mean,
            "error_scale": ca.if_else(known, x.error_scale, ca.fmax(x.error_scale, ends * mean)),
            "period_mean": period,
            "period_scale": ca.if_else(known, x.period_scale, ends * period),
        }


@operation
def deviations(P: Any) -> Any:
    """Standard deviations of the sums of the first elements, with the covariance P of the elements."""
    return ca.vertcat(*(ca.sqrt(ca.fmax(0, ca.sum1(ca.sum2(P[:k, :k])))) for k in range(1, P.shape[0] + 1)))


@operation
def under(b: Any, spread: Any, threshold: Any) -> Any:
    """How many of the sums of the first elements do not exceed the threshold by their spread."""
    total, found = 0, 0
    for k in range(b.shape[0]):
        total = total + b[k]
        found = found + (total - spread[k] < threshold)
    return found
