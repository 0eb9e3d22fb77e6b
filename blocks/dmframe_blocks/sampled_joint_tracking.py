"""Discrete-time reference for tracking a path of the joints."""

from __future__ import annotations

from typing import Self, final

from pydantic import Field, model_validator

from dmframe.block import (
    PERIOD,
    AbstractBlock,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    named,
)
from dmframe_blocks._identified_delay import (
    DELAY_HAT,
    IDENTIFIED,
    MOST_DELAY,
    longest,
    needs_delay,
)
from dmframe_blocks._margins import check_gain, ends_of_sample, gain_at_limit, remark_of


@final
class SampledJointTracking(AbstractBlock):
    r"""Average joint velocity over a sample that moves the joints to the next point of their path.

    The commanded sample starts at the pose :math:`q_{start}`, at which the path is at :math:`q_d`, and at
    :math:`q_{d,1}` when it ends. With the error :math:`\Delta q = q_{start} - q_d`, the output q_err,

    .. math::

        \dot q_r = (q_{d,1} - q_d - T \Lambda \Delta q) / T   \tag{1}

    If the joints move with this average velocity, the error decreases from sample to sample by the factor
    :math:`1 - T \Lambda`. The motion of the path causes no error.

    *Gain from margins.* If the joints move by the command, multiplied by a constant gain g that is unknown, and m
    samples later than predicted, then :math:`\Delta q_{k+1} = \Delta q_k - T \Lambda g \Delta q_{k-m}`, which is stable
    if and only if :math:`0 < T \Lambda g < 2 \sin(\pi / (4 m + 2))`. With `gain_margin` in place of Lambda

        T Lambda = 2 sin(pi/(4 delay_margin + 2))/gain_margin

    so that this loop is stable with any g below `gain_margin` and any m up to `delay_margin`.

    The output dq_path is the velocity along the path without feedback, :math:`(q_{d,1} - q_d)/T`.

    A command that acts `delay` samples later is computed for the sample that starts then: set the same `delay` in the
    block that predicts q_start. With `delay_up_to` the input delay_hat is this delay, and the margin of the gain is
    taken for delay_margin + delay_hat samples, so that it does not rely on the prediction; until the delay is
    identified it is taken for delay_margin + delay_up_to.

    Parameters
    ----------
    Lambda : scalar, 1/s, > 0
        Gain of the feedback. :math:`T \Lambda` must be below 2.
    gain_margin : scalar, >= 1
        Margin of the gain from a command to the motion, instead of Lambda: see above.
    delay_margin : 0, 1, 2, ...
        Margin of the delay from a command to the motion, in samples. The lag of the servo counts.
    delay : 0, 1, ..., 8
        Whole samples from a command to its effect.
    delay_up_to : 1, 2, ..., 8
        Instead of `delay`: the input delay_hat of a `delay_probe` is the delay, up to this number of samples.

    Notes
    -----
    Not for: a signal q_d whose future is unknown.

    References
    ----------
    [LevinMay1976]_ for the bound of the gain.
    """

    inputs = (
        Input("q_start", "n", "rad"),
        Input("q_d", "n", "rad"),
        *(Input(f"q_d_{k}", "n", "rad", ahead_of="q_d", ahead=k, optional=k > 1) for k in range(1, MOST_DELAY + 2)),
        DELAY_HAT,
        IDENTIFIED,
        PERIOD,
    )
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("q_err", "n", "rad", optional=True),
        Output("dq_path", "n", "rad/s", optional=True),
    )

    Lambda: Scalar | None = Positive("", "1/s", default=None)
    gain_margin: Scalar | None = Positive(default=None)
    delay_margin: int = Field(1, ge=0)
    delay: int = Field(0, ge=0, le=MOST_DELAY)
    delay_up_to: int | None = Field(None, ge=1, le=MOST_DELAY)

    @model_validator(mode="after")
    def _has_one_gain(self) -> Self:
        check_gain(self, ("Lambda", "gain_margin"), "Lambda and gain_margin")
        return self

    def remark(self) -> str:
        """That the gain follows from margins."""
        return remark_of(self)

    def needs(self, port: str) -> bool:
        """The delay, if it is identified; and the path as far ahead as the longest delay."""
        return needs_delay(self, port) or port in [f"q_d_{k}" for k in range(2, longest(self) + 2)]

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        path = [getattr(u, name) for name in ("q_d", *(f"q_d_{k}" for k in range(1, longest(self) + 2)))]
        now, goal = ends_of_sample(self, u, path, names=("q_at", "q_to"))
        step = u.T * p.Lambda if "Lambda" in p else gain_at_limit(self, u) / p.gain_margin
        q_err = named("q_err", u.q_start - now)
        along = (goal - now) / u.T
        return Equations(outputs={"dq_r": (goal - now - step * q_err) / u.T, "q_err": q_err, "dq_path": along})
