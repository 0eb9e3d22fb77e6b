"""Supervisory switching between three predictors of a servo by their prediction errors."""

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
    r"""Sends the command of the best of three predictors: none, a constant disturbance, or the identified servo.

    Each predicts the velocity error over a sample, lag = u - v. "None" predicts zero, so that its command is dq_r
    itself; `disturbance_observer` predicts the lag of the last sample; `sampled_inverse` uses its estimates. "None"
    predicts the pose at which a command acts from the motion only, q + delay T v, without the queued commands, since
    it replaces predictors with a possibly wrong delay. The errors in the previous sample are

        epsilon_0 = lag,    epsilon_1 = lag - lag_before,    epsilon_2 = epsilon

    and E_i is the largest of their squared norms over the last `compared` samples. The best predictor has the smallest
    E. It replaces the active one, c, if

        E_best < hysteresis E_c

    *Trip.* While "none" is active, scale = max(E_0, quiet^2) is updated; otherwise it is constant. If the squared norm
    of the error of the active predictor satisfies

        |epsilon_c|^2 > trip^2 scale

    "none" becomes active at once and remains so for `dwell`, after the next trips for two, four, ... times as long. A
    predictor that is wrong only when it is active, such as one with a wrong delay, is therefore active ever more
    rarely. "None" is also active for the first `dwell`.

    *Demand.* If a joint does not follow its command, for example because its drive is at its limit, the servo's target
    moves ahead of it, and the servo winds up. The mean torque over a sample, divided by the velocity gain, is

        demand = lag + k_P lead + k_I total

    where lead, the sum of T lag, is the lead of the target, and total is the sum of T lead, both at the middle of the
    sample. With `demand_max` a command is limited so that demand stays below it for a constant joint velocity;
    `withheld` is the removed part. The sums decay with the time constant `forget` while the active predictor predicts
    the joint to within `quiet` and no command is limited, that is while the joint follows its command.

    All three predictors are updated with the command that is sent. The bound on the estimation error holds for any
    command, so switching does not affect the proof of `sampled_inverse`. The task error satisfies the same bound with
    the error of the active predictor, which the trip keeps below `trip` times the square root of scale, except for the
    sample that trips.

    Parameters
    ----------
    delay : 0, 1 or 2
        Whole samples from a command to its effect, as in the predictors.
    compared : number, > 1
        Number of samples over which errors are compared.
    hysteresis : scalar, > 0
        Factor below one by which the best error must be smaller than that of the active predictor.
    trip : scalar, > 0
        Largest error of the active predictor relative to the lag.
    quiet : scalar, rad/s, > 0
        An error smaller than `trip` times this does not trip, also if the robot has been at rest before.
    dwell : scalar, s, > 0
        Time for which "none" is active at first. It should be longer than the compared samples, so that the errors of
        the trip itself are not compared.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.
    demand_max : diagonal (n,), rad/s, > 0
        About ten times the torque limit of the drive, divided by :math:`K K_D`; a fifth of that and twice as much gave
        similar results. By default commands are not limited.
    k_P, k_I : (n,), 1/s, 1/s^2, > 0
        Approximate values of :math:`K_P/K_D` and :math:`K_I/K_D`, as in `sampled_inverse`.
    forget : scalar, s, > 0
        Decay time of the sums; about twenty samples.

    Notes
    -----
    Not for: a robot that is unstable with the kinematic command. There is no proof that the error of the active
    predictor is small. The demand is relative to the time at which the sums were last zero, and does not contain
    the gravity torque of the servo before. It therefore prevents wind-up, but does not keep a drive within its limit.

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
            notice="a joint does not follow its command, which is limited",
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
        """N: number of compared samples; d: length of the queue of commands."""
        return {"N": self.compared, "d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """At rest, with "none" active."""
        return {"q_before": u.q, "rest": p.dwell, "next_rest": 2 * p.dwell, "scale": p.quiet * p.quiet}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The errors, the active predictor, and the command that is sent."""
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
        """The command with which demand stays within bounds for constant joint velocities v; and the sums."""
        foreseen = ca.logic_and(ca.fabs(used) <= p.quiet, x.cut < 1)
        keep = named("keep", ca.if_else(foreseen, ca.fmax(0, 1 - u.T / p.forget), 1))
        lead, total = keep * (x.lead + u.T * u.lag), keep * (x.total + u.T * (x.lead + u.T * u.lag / 2))
        after = {"lead": named("lead_new", lead), "total": named("total_new", total)}
        lead, total = after["lead"], after["total"]
        for k in range(1, self.delay + 1):  # for the commands that act before this one
            lag = x.sent[:, k] - v
            lead, total = lead + u.T * lag, total + u.T * (lead + u.T * lag / 2)
        restoring = named("restoring", p.k_P * lead + p.k_I * (total + u.T * lead / 2))
        per_lag = 1 + p.k_P * u.T / 2 + p.k_I * u.T * u.T / 4
        low, high = v - (p.demand_max + restoring) / per_lag, v + (p.demand_max - restoring) / per_lag
        return clip(ca.fmin(ca.fmax(wished, low), high), p.u_max), after


def _of(choice: Any, none: Any, column: Any, full: Any) -> Any:
    """The value of the predictor with that number."""
    return ca.if_else(choice > 1, full, ca.if_else(choice > 0, column, none))


@operation
def pushed(errors: Any, newest: Any) -> Any:
    """The errors with the newest first, without the oldest."""
    return ca.horzcat(newest, errors[:, :-1])


@operation
def largest(errors: Any) -> Any:
    """The largest error of each predictor."""
    return ca.vertcat(*(ca.mmax(row) for row in ca.vertsplit(errors)))
