"""Which of three predictors of a position servo commands it: the one that has predicted best."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, final

import casadi as ca
from pydantic import Field

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.naming import named, operation
from dmframe.parameter import Diagonal, Positive, Scalar
from dmframe.port import PERIOD, Access, Port, State
from dmframe.terms import clip


@final
class SampledSupervisor(AbstractBlock):
    r"""Sends the command of one of three predictors: none, the column of ones alone, or all columns.

    Each predicts what the joints fall short of a command over a sample, lag = u - v: none predicts zero, so that it
    commands dq_r itself; `disturbance_observer` the last sample's; `sampled_inverse` what it has learnt. Their errors
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

    Notes
    -----
    Not for: a robot that the kinematic command does not hold. That the error of the one in command is small is not
    proved.

    References
    ----------
    [Morse1996]_, with dwell and hysteresis.
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq_r", "n", "rad/s"),
        Port("dq_column", "n", "rad/s"),
        Port("dq_full", "n", "rad/s"),
        Port("q_column", "n", "rad"),
        Port("q_full", "n", "rad"),
        Port("lag", "n", "rad/s"),
        Port("epsilon", "n", "rad/s"),
        PERIOD,
    )
    outputs: ClassVar[tuple[Port, ...]] = (
        Port("dq_sent", "n", "rad/s", Access.COMMANDED),
        Port("q_start", "n", "rad"),
        Port("predictor"),
        Port("epsilon_used", "n", "rad/s"),
        Port("tripped"),
    )
    states: ClassVar[tuple[State, ...]] = (
        State("chosen", sampled=True),
        State("errors", "3 N", "rad^2/s^2", sampled=True, recorded=False),
        State("lag_before", "n", "rad/s", sampled=True),
        State("scale", "", "rad^2/s^2", sampled=True),
        State("rest", "", "s", sampled=True),
        State("next_rest", "", "s", sampled=True),
        State("trips", sampled=True),
        State("sent", "n d", "rad/s", sampled=True),
    )

    delay: Literal[0, 1, 2] = 0
    compared: int = Field(10, ge=2)
    hysteresis: Scalar = Positive(default=0.7)
    trip: Scalar = Positive(default=2.0)
    quiet: Scalar = Positive("", "rad/s", default=0.01)
    dwell: Scalar = Positive("", "s", default=2.0)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """N samples are compared; d commands act now or wait."""
        return {"N": self.compared, "d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """At rest, none in command."""
        return {"rest": p.dwell, "next_rest": 2 * p.dwell, "scale": p.quiet * p.quiet}

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

        q_none = u.q + u.T * ca.sum2(x.sent[:, 1:])
        dq_sent = _of(chosen, clip(u.dq_r, p.u_max), u.dq_column, u.dq_full)
        return Equations(
            outputs={
                "dq_sent": dq_sent,
                "q_start": _of(chosen, q_none, u.q_column, u.q_full),
                "predictor": chosen,
                "epsilon_used": _of(x.chosen, *ca.horzsplit(epsilons)),
                "tripped": tripped,
            },
            next={
                "chosen": chosen,
                "errors": errors,
                "lag_before": u.lag,
                "scale": ca.if_else(chosen > 0, x.scale, ca.fmax(E[0], p.quiet * p.quiet)),
                "rest": rest,
                "next_rest": ca.if_else(tripped, 2 * x.next_rest, x.next_rest),
                "trips": x.trips + tripped,
                "sent": ca.horzcat(x.sent[:, 1:], dq_sent),
            },
        )


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
