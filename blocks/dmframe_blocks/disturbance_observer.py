"""Disturbance observer for a velocity servo: a baseline without a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, final

import casadi as ca

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
    Signals,
    State,
    clip,
    named,
)


@final
class DisturbanceObserver(AbstractBlock):
    r"""Adds to the command the velocity error of the joints over the previous sample (time delay control).

    .. math::

        \mathrm{lag} &= u_{applied} - (q - q_{before}) / T                  \tag{1} \\
        \dot q_c  &= \mathrm{clip}(\dot q_r + \mathrm{lag}, u_{max})               \tag{2} \\
        q_{start} &= q, \quad q_{before}^+ = q                           \tag{3}

    It is the regression of `sampled_inverse` with one column, the constant 1, and no memory: the difference between
    the command and the average joint velocity is treated as a disturbance that is constant over the next sample. It
    uses no model of servo or robot and estimates no parameters. :math:`u_{applied}`, the first element of `queue`, is
    the command that acted.

    A command acts `delay` samples later. The start of that sample is predicted from the commands until then with a
    constant disturbance: :math:`q_{start}` increases by :math:`T (u - \mathrm{lag})` for each of them.

    Parameters
    ----------
    delay : 0, 1 or 2
        Whole samples from a command to its effect. It must be correct: if it is 0 and the delay is one sample, the loop
        diverges.
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
    [YoucefToumiIto1990]_, time delay control, for commands of velocity.
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
        State("queue", "n d", "rad/s", sampled=True),
        State("t_before", "", "s", sampled=True, optional=True),
    )

    delay: Literal[0, 1, 2] = 0
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    supervised: bool = False
    echoed: bool = False
    time_stamps: bool = False

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
        """(1) to (3)."""
        T, waiting = u.t - x.t_before if self.time_stamps else u.T, x.queue[:, 1:]
        u_applied = named("u_applied", (u.q_echo - x.q_aim) / T if self.echoed else x.queue[:, 0])
        lag = u_applied - (u.q - x.q_before) / T
        dq_c = clip(u.dq_r + lag, p.u_max)
        q_start = u.q
        for k in range(self.delay):
            q_start = q_start + u.T * (waiting[:, k] - lag)
        after = {"q_before": u.q, "queue": ca.horzcat(waiting, u.dq_sent if self.supervised else dq_c)}
        if self.time_stamps:
            after["t_before"] = u.t
        if self.echoed:
            after["q_aim"] = u.q_echo
        return Equations(outputs={"dq_c": dq_c, "q_start": q_start, "lag": lag}, next=after)
