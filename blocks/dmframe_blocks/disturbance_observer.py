"""Disturbance observer for a velocity servo: a baseline without a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Self, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    PERIOD,
    SX,
    AbstractBlock,
    Access,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    clip,
    named,
)


@final
class DisturbanceObserver(AbstractBlock):
    r"""Adds to the command an estimate of the velocity error of the joints: a level, or a level and a trend.

    .. math::

        \mathrm{lag} &= u_{applied} - (q - q_{before}) / T                  \tag{1} \\
        e            &= \mathrm{lag} - (\mathrm{level} + \mathrm{trend})   \tag{2} \\
        \mathrm{level}^+ &= \mathrm{level} + \mathrm{trend} + \alpha e, \quad
        \mathrm{trend}^+ = \mathrm{trend} + \beta e                         \tag{3} \\
        q_{start} &= q, \quad q_{before}^+ = q                           \tag{4}

    The command is :math:`\dot q_r + \mathrm{level}^+ + (\mathrm{delay} + 1)\, \mathrm{trend}^+`, clipped to u_max.
    The difference between the command and the average joint velocity is treated as a disturbance. Without
    `alpha` the estimate is the lag of the last sample, as with :math:`\alpha = 1`, which is time delay control: the
    regression of `sampled_inverse` with one column, the constant 1, and no memory. A smaller :math:`\alpha` averages
    over :math:`1 / \alpha` samples; with `beta` a change per sample is estimated as well (an alpha-beta filter). With
    :math:`\alpha = 0` there is no observer, and the command is the reference velocity. The observer uses no model of
    servo or robot and estimates no parameters. :math:`u_{applied}`, the first element of `queue`, is the command that
    acted.

    A command acts `delay` samples later. The start of that sample is predicted from the commands u until then and the
    forecast of their disturbance: for the k-th of them :math:`q_{start}` increases by
    :math:`T (u - \mathrm{level}^+ - k\, \mathrm{trend}^+)`.

    Parameters
    ----------
    alpha : scalar, >= 0, <= 1
        Gain of the level; by default the lag of the last sample; 0 for no observer.
    beta : scalar, > 0
        Gain of the trend; by default there is none. The filter (2), (3) is stable if :math:`\beta` is below
        :math:`4 - 2 \alpha`.
    delay : 0, 1 or 2
        Whole samples from a command to its effect. It must be correct: if it is 0 and the delay is one sample, the loop
        diverges with :math:`\alpha = 1`.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.
    supervised : true or false
        Another block, such as `sampled_supervisor`, determines the command that is sent, `dq_sent`, which is then used
        as the applied command.
    echoed : true or false
        The robot reports the target of its servo: wire `q_echo` to it. :math:`u_{applied}` is then the change of the
        target over :math:`T`.
    time_stamps : true or false
        The measurement times of the positions are known; their difference replaces :math:`T` in (1).

    Notes
    -----
    Not for: an unknown delay, or a robot whose accelerations change much within a sample.

    References
    ----------
    [YoucefToumiIto1990]_, time delay control, for commands of velocity; [Holt2004]_, the level and the trend.
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_sent", "n", "rad/s", optional=True),
        Input("q_echo", "n", "rad", optional=True),
        Input("t", "", "s", optional=True),
        PERIOD,
    )
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("lag", "n", "rad/s"),
    )
    states = (
        State("q_before", "n", "rad", sampled=True),
        State("q_aim", "n", "rad", sampled=True, optional=True),
        State("level", "n", "rad/s", sampled=True, optional=True),
        State("trend", "n", "rad/s", sampled=True, optional=True),
        State("queue", "n d", "rad/s", sampled=True),
        State("t_before", "", "s", sampled=True, optional=True),
    )

    alpha: Scalar | None = NonNegative(default=None)
    beta: Scalar | None = Positive(default=None)
    delay: Literal[0, 1, 2] = 0
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    supervised: bool = False
    echoed: bool = False
    time_stamps: bool = False

    @model_validator(mode="after")
    def _stable(self) -> Self:
        if self.alpha is None:
            if self.beta is not None:
                raise ValueError("expected alpha, the gain of the level, with beta, that of the trend; give both")
        elif self.alpha > 1:
            raise ValueError(f"expected alpha of 1 at most, with which the level is the last lag, found {self.alpha}")
        elif self.beta is not None and self.beta >= 4 - 2 * self.alpha:
            raise ValueError(f"expected beta below 4 - 2 alpha = {4 - 2 * self.alpha:.4g}, found {self.beta}")
        return self

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """D: the number of commands in the queue."""
        return {"d": self.delay + 1}

    def needs(self, port: str) -> bool:
        """The sent command if another block determines it; the target if the robot reports it."""
        return {"dq_sent": self.supervised, "q_echo": self.echoed}.get(port, False)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest."""
        begins = {"q_before": u.q} | ({"t_before": u.t - u.T} if self.time_stamps else {})
        return begins | ({"q_aim": u.q_echo} if self.echoed else {})

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (4), and the command."""
        T, waiting = u.t - x.t_before if self.time_stamps else u.T, x.queue[:, 1:]
        u_applied = named("u_applied", (u.q_echo - x.q_aim) / T if self.echoed else x.queue[:, 0])
        lag = named("lag", u_applied - (u.q - x.q_before) / T)
        level, trend, after = self._observed(x, p, lag)
        dq_c = clip(u.dq_r + level + (self.delay + 1) * trend, p.u_max)
        q_start = u.q
        for k in range(self.delay):
            q_start = q_start + u.T * (waiting[:, k] - level - (k + 1) * trend)
        after |= {"q_before": u.q, "queue": ca.horzcat(waiting, u.dq_sent if self.supervised else dq_c)}
        if self.time_stamps:
            after["t_before"] = u.t
        if self.echoed:
            after["q_aim"] = u.q_echo
        return Equations(outputs={"dq_c": dq_c, "q_start": q_start, "lag": lag}, next=after)

    def _observed(self, x: Signals, p: Signals, lag: SX) -> tuple[SX, SX, dict[str, SX]]:
        """(2) and (3): level, trend, and those of them that are states."""
        if "alpha" not in p:
            return lag, 0 * lag, {}
        before = x.level + x.trend if "beta" in p else x.level
        level = named("level_new", before + p.alpha * (lag - before))
        if "beta" not in p:
            return level, 0 * lag, {"level": level}
        trend = named("trend_new", x.trend + p.beta * (lag - before))
        return level, trend, {"level": level, "trend": trend}
