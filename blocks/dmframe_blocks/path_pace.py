"""A path's own time: it goes on more slowly where commands near their limit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, final

import casadi as ca

from dmframe.block import (
    PERIOD,
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    named,
    operation,
)


@final
class PathPace(AbstractBlock):
    r"""Keeps the time at which a path is followed, so that the path waits for joints that can go no faster.

    A path reads it where its time is wired to it, `path.t: pace.t_path`. From one sample to the next it goes on by
    rates[0] T; with `near` the largest |dq_c|/(share u_max) of the joints and r the newest rate, the next one is

        r/near where near > 1,    else r + (T/recovery)(1 - r)

    A command is, near enough, in proportion to the rate, so that the first brings it back to its share of the limit in
    one sample. Of a controller whose commands act `delay` samples later, rates are decided as long before: t_path_1,
    t_path_2 and t_path_3, what t_path will be, then hold what it is told.

    Parameters
    ----------
    delay : 0, 1 or 2
        Whole samples from a command to its effect, as the task law has it.
    u_max : diagonal (n,), rad/s, > 0
        The largest command.
    share : scalar, > 0
        Of that limit: where the path begins to wait. Below one, or commands are cut off first.
    recovery : scalar, s, > 0
        In which 1 - 1/e of what the path is too slow is made up for.

    Notes
    -----
    It shapes the path in time alone: the way stays as it is. Not for: commands that near their limit for another cause
    than the path, such as an unstable loop, where waiting does not help; or laws in continuous time, for which t_path
    jumps.

    References
    ----------
    [Siciliano2009]_ Section 4.2, for a path apart from the timing law along it.
    """

    inputs = (Input("dq_c", "n", "rad/s"), PERIOD)
    outputs = (
        Output("t_path", "", "s"),
        Output("t_path_1", "", "s"),
        Output("t_path_2", "", "s"),
        Output("t_path_3", "", "s"),
        Output("pace"),
    )
    states = (
        State("path_time", "", "s", sampled=True),
        State("rates", "d", sampled=True),
    )

    delay: Literal[0, 1, 2] = 0
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    share: Scalar = Positive(default=0.9)
    recovery: Scalar = Positive("", "s", default=2.0)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """D rates are decided."""
        return {"d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """The path begins at its time 0, at its own speed."""
        return {"rates": ca.DM.ones(self.delay + 1)}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The time now and later, and the next rate."""
        rates, times = ca.vertsplit(x.rates), [x.path_time]
        for k in range(3):
            times.append(times[-1] + u.T * rates[min(k, self.delay)])
        newest = rates[-1]
        near = named("near", largest(ca.fabs(u.dq_c) / (p.share * p.u_max)))
        slower, faster = newest / ca.fmax(near, 1), newest + ca.fmin(1, u.T / p.recovery) * (1 - newest)
        return Equations(
            outputs={
                "t_path": times[0],
                "t_path_1": times[1],
                "t_path_2": times[2],
                "t_path_3": times[3],
                "pace": rates[0],
            },
            next={
                "path_time": times[1],
                "rates": ca.vertcat(*rates[1:], ca.if_else(near > 1, slower, faster)),
            },
        )


@operation
def largest(values: Any) -> Any:
    """The largest of some numbers."""
    return ca.mmax(values)
