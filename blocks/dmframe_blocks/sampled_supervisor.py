"""Which of three predictors of a position servo commands it: the one that has predicted best."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, final

import casadi as ca
from pydantic import Field

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
    clip,
    named,
    operation,
)


@final
class SampledSupervisor(AbstractBlock):
    r"""Sends the command of one of three predictors: none, the column of ones alone, or all columns.

    Each predicts what the joints fall short of a command over a sample, lag = u - v: none predicts zero, so that it
    commands dq_r itself; `disturbance_observer` the last sample's; `sampled_inverse` what it has learnt. Where the
    robot is when a command acts, none takes from its motion alone, q + delay T v: it stands in for predictors whose
    delay may be wrong, so it asks nothing of the commands on their way. Their errors
    in the sample that is over are

        epsilon_0 = lag,    epsilon_1 = lag - lag_before,    epsilon_2 = epsilon

    and E_i is the largest of their squared norms over the last `compared` samples. The best has the least E. It takes
    over from the one in command, c, where

        E_best < hysteresis E_c

    *Trip.* While none is in command, scale = max(E_0, quiet^2) is kept; it stays as it is under another. Where the
    squared norm of the error of the one in command has

        |epsilon_c|^2 > trip^2 scale

    none takes over at once and stays for `dwell`, and then twice, four times, ... as long: a predictor that is wrong
    only when it is in command, such as one with a wrong delay, errs ever more rarely. It begins so, too: none commands
    for the first `dwell`.

    *Demand.* A joint that does not move as it is told, such as one whose drive is at its limit, is left behind by the
    servo's target, and the servo winds up. Over its velocity gain, it asks the drive in the mean of a sample for

        demand = lag + k_P lead + k_I total

    lead being the sum of T lag, by which the target is ahead, and total the sum of T lead, both in the middle of the
    sample. With `demand_max` a command is cut off where demand would pass that if the joint went on as fast as it does;
    `withheld` is what was cut off. The sums are forgotten, within `forget`, while the one in command foresees the joint
    to within `quiet` and nothing is cut off: it then moves as it is told.

    All three learn from what is sent. What an estimate's error does from sample to sample does not ask how the command
    came about, so that switching leaves the proof of `sampled_inverse` as it is. The task's error obeys the same bound
    with the error of the one in command, which the trip keeps below `trip` times the square root of scale but for the
    sample that trips.

    Parameters
    ----------
    delay : 0, 1 or 2
        Whole samples from a command to its effect, as the predictors have it.
    compared : number, > 1
        Samples over which errors are compared.
    hysteresis : scalar, > 0
        Below one: by how much the best must be better.
    trip : scalar, > 0
        How often as large as the lag an error may be.
    quiet : scalar, rad/s, > 0
        An error smaller than `trip` times this does not trip, also where the robot has only stood still.
    dwell : scalar, s, > 0
        How long none is in command at first; longer than those samples, so that what has tripped is not judged by its
        fall.
    u_max : diagonal (n,), rad/s, > 0
        The largest command.
    demand_max : diagonal (n,), rad/s, > 0
        Some ten times the torque limit of the drive, over K K_D; a fifth of that and twice as much did as well. Without
        it nothing is cut off.
    k_P, k_I : (n,), 1/s, 1/s^2, > 0
        Guesses of K_P/K_D and K_I/K_D, as in `sampled_inverse`.
    forget : scalar, s, > 0
        Some twenty samples.

    Notes
    -----
    Not for: a robot that the kinematic command does not hold. That the error of the one in command is small is not
    proved. A demand is counted from where the sums were last forgotten, and gravity that the servo held before is not
    in it: so it stops a winding up, and does not keep a drive within its limit.

    References
    ----------
    [Morse1996]_, with dwell and hysteresis.
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_column", "n", "rad/s"),
        Input("dq_full", "n", "rad/s"),
        Input("q_column", "n", "rad"),
        Input("q_full", "n", "rad"),
        Input("lag", "n", "rad/s"),
        Input("epsilon", "n", "rad/s"),
        PERIOD,
    )
    outputs = (
        Output("dq_sent", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("predictor"),
        Output("epsilon_used", "n", "rad/s"),
        Output("tripped"),
        Output(
            "withheld",
            "n",
            "rad/s",
            optional=True,
            notice="a joint does not move as it is told, and its command is cut off",
        ),
    )
    states = (
        State("chosen", sampled=True),
        State("errors", "3 N", "rad^2/s^2", sampled=True, recorded=False),
        State("lag_before", "n", "rad/s", sampled=True),
        State("scale", "", "rad^2/s^2", sampled=True),
        State("rest", "", "s", sampled=True),
        State("next_rest", "", "s", sampled=True),
        State("trips", sampled=True),
        State("sent", "n d", "rad/s", sampled=True),
        State("q_before", "n", "rad", sampled=True),
        State("lead", "n", "rad", sampled=True, optional=True),
        State("total", "n", "rad s", sampled=True, optional=True),
        State("cut", "n", sampled=True, optional=True),
    )

    delay: Literal[0, 1, 2] = 0
    compared: int = Field(10, ge=2)
    hysteresis: Scalar = Positive(default=0.7)
    trip: Scalar = Positive(default=2.0)
    quiet: Scalar = Positive("", "rad/s", default=0.01)
    dwell: Scalar = Positive("", "s", default=2.0)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    demand_max: Diagonal | None = Positive("n", "rad/s", default=None)
    k_P: Diagonal = Positive("n", "1/s", default=1.8)
    k_I: Diagonal = Positive("n", "1/s^2", default=1.2)
    forget: Scalar = Positive("", "s", default=2.0)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """N samples are compared; d commands act now or wait."""
        return {"N": self.compared, "d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """At rest, none in command."""
        return {"q_before": u.q, "rest": p.dwell, "next_rest": 2 * p.dwell, "scale": p.quiet * p.quiet}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The errors, who is in command, and what is sent."""
        epsilons = ca.horzcat(u.lag, u.lag - x.lag_before, u.epsilon)
        squares = named("squares", ca.sum1(epsilons * epsilons).T)
        errors = named("errors_new", pushed(x.errors, squares))
        most = named("E", largest(errors))
        E = [most[i] for i in range(3)]

        tripped = named("tripped", (x.chosen > 0) * (_of(x.chosen, *ca.vertsplit(squares)) > p.trip * p.trip * x.scale))
        rest = named("rest_new", ca.if_else(tripped, x.next_rest, ca.fmax(0, x.rest - u.T)))
        best = named("best", ca.if_else(E[2] < ca.fmin(E[0], E[1]), 2, ca.if_else(E[1] < E[0], 1, 0)))
        better = _of(best, *E) < p.hysteresis * _of(x.chosen, *E)
        chosen = named("chosen_new", ca.if_else(rest > 0, 0, ca.if_else(better, best, x.chosen)))

        v = named("v", (u.q - x.q_before) / u.T)
        q_start = _of(chosen, u.q + self.delay * u.T * v, u.q_column, u.q_full)
        dq_sent = _of(chosen, clip(u.dq_r, p.u_max), u.dq_column, u.dq_full)
        used = named("epsilon_used", _of(x.chosen, *ca.horzsplit(epsilons)))
        outputs, after = dict[str, SX](), dict[str, SX]()
        if "demand_max" in p:
            wished = named("dq_wished", dq_sent)
            dq_sent, after = self._within(u, x, p, v, wished, used)
            outputs["withheld"] = wished - dq_sent
            after["cut"] = dq_sent != wished
        return Equations(
            outputs={
                "dq_sent": dq_sent,
                "q_start": q_start,
                "predictor": chosen,
                "epsilon_used": used,
                "tripped": tripped,
                **outputs,
            },
            next={
                "chosen": chosen,
                "errors": errors,
                "lag_before": u.lag,
                "scale": ca.if_else(chosen > 0, x.scale, ca.fmax(E[0], p.quiet * p.quiet)),
                "rest": rest,
                "next_rest": ca.if_else(tripped, 2 * x.next_rest, x.next_rest),
                "trips": x.trips + tripped,
                "q_before": u.q,
                "sent": ca.horzcat(x.sent[:, 1:], dq_sent),
                **after,
            },
        )

    def _within(self, u: Signals, x: Signals, p: Signals, v: SX, wished: SX, used: SX) -> tuple[SX, dict[str, SX]]:
        """The command with which demand stays within bounds, if the joints go on at v; and the sums."""
        foreseen = ca.logic_and(ca.fabs(used) <= p.quiet, x.cut < 1)
        keep = named("keep", ca.if_else(foreseen, ca.fmax(0, 1 - u.T / p.forget), 1))
        lead, total = keep * (x.lead + u.T * u.lag), keep * (x.total + u.T * (x.lead + u.T * u.lag / 2))
        after = {"lead": named("lead_new", lead), "total": named("total_new", total)}
        lead, total = after["lead"], after["total"]
        for k in range(1, self.delay + 1):  # of the commands that act before this one
            lag = x.sent[:, k] - v
            lead, total = lead + u.T * lag, total + u.T * (lead + u.T * lag / 2)
        asked = named("asked", p.k_P * lead + p.k_I * (total + u.T * lead / 2))
        per_lag = 1 + p.k_P * u.T / 2 + p.k_I * u.T * u.T / 4
        low, high = v - (p.demand_max + asked) / per_lag, v + (p.demand_max - asked) / per_lag
        return clip(ca.fmin(ca.fmax(wished, low), high), p.u_max), after


def _of(choice: Any, none: Any, column: Any, full: Any) -> Any:
    """What belongs to the predictor of that number."""
    return ca.if_else(choice > 1, full, ca.if_else(choice > 0, column, none))


@operation
def pushed(errors: Any, newest: Any) -> Any:
    """The errors with the newest before them, and without the oldest."""
    return ca.horzcat(newest, errors[:, :-1])


@operation
def largest(errors: Any) -> Any:
    """The largest error of each predictor."""
    return ca.vertcat(*(ca.mmax(row) for row in ca.vertsplit(errors)))
