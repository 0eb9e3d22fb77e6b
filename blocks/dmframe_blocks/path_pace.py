"""Path time that slows down when commands approach their limit (discrete time)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca
from pydantic import Field

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
from dmframe_blocks._identified_delay import MOST_DELAY


@final
class PathPace(AbstractBlock):
    r"""Computes the time along a path, which slows down when joint commands approach their limit.

    A path uses it as its time with the wire `path.t: pace.t_path`. Each sample increases the path time by rates[0] T.
    With `near` the largest |dq_c|/(share u_max) of the joints and r the newest rate, the next rate is

        r/near where near > 1,    else r + (T/recovery)(1 - r)

    A command is approximately proportional to the rate, so the first case returns it to its share of the limit in one
    sample. If commands act `delay` samples later, rates are fixed the same number of samples in advance, so that the
    outputs t_path_1, ..., t_path_9, the future values of t_path, are known up to the sample after the delay.

    Parameters
    ----------
    delay : 0, 1, ..., 8
        Whole samples from a command to its effect, as in the task law; for an identified delay its `delay_up_to`.
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
        *(Output(f"t_path_{k}", "", "s") for k in range(1, MOST_DELAY + 2)),
        Output("pace"),
    )
    states = (
        State("path_time", "", "s", sampled=True),
        State("rates", "d", sampled=True),
    )

    delay: int = Field(0, ge=0, le=MOST_DELAY)
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
        for k in range(MOST_DELAY + 1):
            times.append(times[-1] + u.T * rates[min(k, self.delay)])
        newest = rates[-1]
        near = named("near", largest(ca.fabs(u.dq_c) / (p.share * p.u_max)))
        slower, faster = newest / ca.fmax(near, 1), newest + ca.fmin(1, u.T / p.recovery) * (1 - newest)
        return Equations(
            outputs={
                "t_path": times[0],
                **{f"t_path_{k}": times[k] for k in range(1, MOST_DELAY + 2)},
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
