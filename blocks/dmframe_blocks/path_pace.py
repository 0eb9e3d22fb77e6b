"""Path time that slows down when commands approach their limit (discrete time)."""

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
    r"""Computes the time along a path, which slows down when joint commands approach their limit.

    A path uses it as its time with the wire `path.t: pace.t_path`. Each sample increases the path time by rates[0] T.
    With `near` the largest |dq_c|/(share u_max) of the joints and r the newest rate, the next rate is

        r/near where near > 1,    else r + (T/recovery)(1 - r)

    A command is approximately proportional to the rate, so the first case returns it to its share of the limit in one
    sample. If commands act `delay` samples later, rates are fixed the same number of samples in advance, so that the
    outputs t_path_1, t_path_2 and t_path_3, the future values of t_path, are known.

    Parameters
    ----------
    delay : 0, 1 or 2
        Whole samples from a command to its effect, as in the task law.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.
    share : scalar, > 0
        Fraction of the limit at which the path begins to slow down. It should be below one, so that commands do not
        saturate first.
    recovery : scalar, s, > 0
        Time constant with which the rate returns to 1.

    Notes
    -----
    It changes the timing of the path only, not its geometry. Not for: commands that are large for another reason than
    the path, such as an unstable loop; or continuous-time laws, for which t_path is discontinuous.

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
        """D: the number of rates fixed in advance."""
        return {"d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """Path time 0 and rate 1."""
        return {"rates": ca.DM.ones(self.delay + 1)}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The present and future path times, and the next rate."""
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
    """The largest of several numbers."""
    return ca.mmax(values)
