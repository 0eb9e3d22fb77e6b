"""Aggregation of experts that forecast the motion of a closed servo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, Self, final

import casadi as ca
from pydantic import Field, model_validator

from dmframe.block import (
    PERIOD,
    SX,
    AbstractBlock,
    Access,
    Acted,
    Certificate,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    NormalisedSteps,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    clip,
    named,
    operation,
)
from dmframe_blocks import _followed_ramp
from dmframe_blocks._identified_delay import (
    DELAY_HAT,
    IDENTIFIED,
    MOST_DELAY,
    acting,
    check_delay,
    chosen,
    longest,
    needs_delay,
)
from dmframe_blocks._residual_observers import PERIODIC, SIMPLE, Forecasts, Observer, Waves, size_of, split


@final
class ExpertAggregation(AbstractBlock):
    r"""Sends the weighted mean of the commands of several experts, each weighted by its past forecasts of the motion.

    An expert forecasts the error by which the motion over a sample misses the command. The first is silent: it
    forecasts zero, so that its command is dq_r. Others observe the lag of the joints, the difference between command
    and average velocity: a level, a level with a trend, and with `periodic` Fourier series of the phase of the motion.
    The same observers of `epsilon`, the residual of an identified servo model (`sampled_inverse`), correct the model;
    one expert is the model alone.

    *Forecasts.* A command acts `delay` samples later. Expert i predicts the pose :math:`q_i` at which it acts, the
    command :math:`u_i` for the velocity :math:`\dot q_r`, and the change of velocity per unit of command,
    :math:`G_i`, which is 1 without a model. With the command u that is sent it forecasts the next pose

        q_hat_i = q_i + T (dq_r + G_i (u - u_i))

    and with the pose q measured `delay` + 1 samples later :math:`e_i = (\hat q_i - q) / T`.

    *Weights, exponential.* Of each joint, with the memory of M = `memory` / T samples,

        L_i = (1 - 1/M) L_i + e_i^2 + (roughness b_i)^2,    w_i proportional to L_i^(-M/2)

    smoothed with the gain `weight_gain`. Without `roughness` this is the exponentially weighted average of the
    normalised likelihoods of errors with unknown variance. :math:`b_i` is the second difference of the correction
    :math:`u_i - \dot q_r` over the last three samples: an expert can forecast well an oscillation that its own
    corrections cause in the closed loop, and forecast errors alone then keep its weight. No claim covers these weights.

    *Weights, projection.* Of each joint, with the rows :math:`h_i = (\hat q_i - \hat q_0) / T` and the output
    :math:`y = (q - \hat q_0) / T`, expert 0 the silent one,

        w = clip(w + Gamma h (y - h'w)/(nu + Gamma h'h), 0, 1),    w_0 = 1 - sum_i w_i

    *Certificate of the projection.* Let :math:`n = \nu + \Gamma h^\top h`, :math:`\varepsilon` the forecast error with
    w, and :math:`\eta` that with any constant weights :math:`w^\ast` in the box, such as those of one expert alone.
    Then

        |w_new - w*|^2/Gamma <= |w - w*|^2/Gamma + (eta^2 - (nu/n) epsilon^2)/n

    so that the sum of :math:`\nu \varepsilon^2 / n^2` exceeds that of :math:`\eta^2 / n` by at most the initial
    :math:`|w - w^\ast|^2 / \Gamma`, on the motion that happened. Where :math:`\Gamma h^\top h \ll \nu` the errors
    are then, in the sum of squares, at most those of the best expert but for a constant; with larger steps up to four
    times as much. That the loop is stable does not follow. That h and y are forecast errors of the experts is how they
    are computed, and not a part of what is proved.

    *Rate.* With `a_max` the change of a command lies between

        min(-a_max T, D - B)  and  max(a_max T, D + B)

    with the change D of dq_path, the velocity along the path without feedback. D counts as zero in the first two
    samples, while the delay is unknown, and if a ramp limits the robot; B is zero unless the robot is known to follow
    faster changes, then max(a_max T/2, |D|). The motion shows which is true: with the output r of a ramp of slope a_max
    behind the command u, and filters :math:`F_\tau = 1 / (1 + \tau s)` for the unknown lag of the servo, the evidence
    is, summed over the joints,

        E = min_tau (integral of |v - F_tau r|^2) - min_tau (integral of |v - F_tau u|^2)

    for tau = 0 and 1, 2, 4, 8 and 16 times `lag_time`. With the mean s^2 of the smaller integral over time, at least
    over `evidence_time`, and N the sum of the integrals of |v - u|^2, a ramp is shown by
    E < -(doubt + evidence_time s^2 + N/9), and that the robot follows by E > doubt/10 + evidence_time s^2.

    *Trial.* On a slow path r = u in each sample, and nothing is shown. With `trial`, a square wave with the amplitude
    a_max T/2 + trial is added to the commands of all joints as soon as the delay is identified. Its sign changes when r
    has caught up with u. It ends when it is shown that the robot follows, if E < -doubt/50, and after evidence_time/8
    at the latest. That the robot follows then remains shown until a ramp is, and the change of a command lies between
    min(-a_max T, D) - B and max(a_max T, D) + B, B = 2 a_max T. With a delay that is identified too short the loop may
    oscillate within these limits.

    Parameters
    ----------
    rate : scalar, rad/s, > 0
        Angular frequency with which the motion repeats, with `periodic`.
    periodic : true or false
        Also observe with Fourier series of 4 and of 20 multiples of the rate, each fast and slow.
    delay : 0, 1, ..., 8
        Whole samples from a command to its effect, as in the blocks that compute dq_r and dq_model.
    delay_up_to : 1, 2, ..., 8
        Instead of `delay`: the input delay_hat of a `delay_probe` is the delay, up to this number of samples. Until it
        is identified the silent expert alone has weight, and nothing is observed.
    weighting : exponential or projection
        See above.
    memory : scalar, s, > 0
        Time over which errors are compared by exponential weights.
    weight_gain : scalar, > 0
        Share by which exponential weights approach those that the losses give in a sample.
    quiet : scalar, rad/s, > 0
        Errors far below this are compared as equal: its square is added to :math:`L_i`.
    roughness : scalar, >= 0
        Share of the second difference of an expert's correction that counts as a forecast error. With too much of it
        the slow observers always win.
    Gamma, nu : scalar, , rad^2/s^2, > 0
        Gain and normalisation of the projection.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.
    a_max : diagonal (n,), rad/s^2, > 0
        Largest change of a command per second, where the path does not need more; by default it is not limited. It
        should be the acceleration to which the robot limits commands, or just below it.
    doubt : scalar, rad^2/s, > 0
        Least evidence for a ramp.
    evidence_time : scalar, s, > 0
        Time over which errors of the size that neither hypothesis explains count as chance.
    lag_time : scalar, s, > 0
        Shortest time constant of the filters for the lag of the servo, with `a_max`; the longest one is 16 times it.
    trial : diagonal (n,), rad/s, > 0
        With it a trial shows whether the robot follows faster changes than `a_max`. By how much the square wave exceeds
        what a ramp allows in a sample.

    Notes
    -----
    Not for: an unknown delay. The forecasts compare experts on the motion that the aggregation caused; an expert that
    would destabilise the loop can have small errors as long as its weight is small.

    References
    ----------
    [CesaBianchiLugosi2006]_, prediction with expert advice; [GoodwinSin1984]_ Section 3.3, the projection algorithm.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_path", "n", "rad/s", optional=True),
        Input("dq_model", "n", "rad/s"),
        Input("q_model", "n", "rad"),
        Input("epsilon", "n", "rad/s"),
        Input("slope", "n"),
        DELAY_HAT,
        IDENTIFIED,
        PERIOD,
    )
    truth = (Input("dq_s", "n", "rad/s"), Input("q", "n", "rad"))
    outputs = (
        Output("dq_sent", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("model_share", "n"),
    )
    states = (
        State("observed", "n H", "rad/s", sampled=True, recorded=False),
        State("phase", "", "rad", sampled=True, optional=True),
        State("losses", "n E", "rad^2/s^2", sampled=True, recorded=False, optional=True),
        State("corrections", "n C", "rad/s", sampled=True, recorded=False, optional=True),
        State("weights", "w", sampled=True, recorded=False),
        State("forecasts", "n F", "rad", sampled=True, recorded=False),
        State("q_before", "n", "rad", sampled=True),
        State("queue", "n d", "rad/s", sampled=True),
        State("count", sampled=True),
        *_followed_ramp.STATES,
    )

    rate: Scalar | None = Positive("", "rad/s", default=None)
    periodic: bool = False
    delay: int = Field(0, ge=0, le=MOST_DELAY)
    delay_up_to: int | None = Field(None, ge=1, le=MOST_DELAY)
    weighting: Literal["exponential", "projection"] = "exponential"
    memory: Scalar = Positive("", "s", default=6.0)
    weight_gain: Scalar = Positive(default=0.2)
    quiet: Scalar = Positive("", "rad/s", default=1e-8)
    roughness: Scalar = NonNegative(default=0.0)
    Gamma: Scalar = Positive(default=1.0)
    nu: Scalar = Positive("", "rad^2/s^2", default=1e-6)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    a_max: Diagonal | None = Positive("n", "rad/s^2", default=None)
    doubt: Scalar = Positive("", "rad^2/s", default=_followed_ramp.DOUBT)
    evidence_time: Scalar = Positive("", "s", default=_followed_ramp.EVIDENCE_TIME)
    lag_time: Scalar = Positive("", "s", default=_followed_ramp.LAG)
    trial: Diagonal | None = Positive("n", "rad/s", default=None)

    @model_validator(mode="after")
    def _has_a_rate(self) -> Self:
        if self.periodic != (self.rate is not None):
            raise ValueError("expected periodic: true together with the rate of the motion; give both or neither")
        check_delay(self)
        return self

    def needs(self, port: str) -> bool:
        """The delay, if it is identified."""
        return needs_delay(self, port)

    @property
    def _observers(self) -> tuple[Observer, ...]:
        """Those of one signal."""
        return (*SIMPLE, *(PERIODIC if self.periodic else ()))

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """E: experts; w: weights without the first; H: numbers of observers; F: stored forecasts; C: corrections."""
        observers = self._observers
        E = 2 * (1 + len(observers))
        own = {"E": E, "H": 2 * size_of(observers), "F": E * (longest(self) + 1), "d": longest(self) + 1}
        return {**super().sizes(robot), **own, **_followed_ramp.SIZES, "w": robot.n * (E - 1), "C": 3 * E}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the silent expert alone."""
        return {"q_before": u.q, "forecasts": ca.repmat(u.q, 1, 2 * (1 + len(self._observers)) * (longest(self) + 1))}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The observers, the weights, the command, and the forecasts of what it does."""
        queue = named("acting", acting(self, u, x.queue))
        lag = named("lag_now", queue[:, 0] - (u.q - x.q_before) / u.T)
        waves = Waves(x.phase, p.rate * u.T) if self.periodic else Waves(0 * u.T, 0 * u.T)
        observers = 2 * self._observers
        seen = [signal for signal in (lag, u.epsilon) for _ in self._observers]
        before = split(observers, x.observed)
        updated = [each.updated(old, new, waves) for each, old, new in zip(observers, before, seen, strict=True)]
        held = [named(f"o_{k}", new) for k, new in enumerate(updated, start=1)]
        phase = {"phase": x.phase + p.rate * u.T} if self.periodic else {}

        def ahead(k: int) -> SX:
            found = [each.forecast(item, k, waves) for each, item in zip(observers, held, strict=True)]
            half = len(found) // 2
            return named(f"missed_{k}", ca.horzcat(0 * lag, *found[:half], 0 * lag, *found[half:]))

        experts = self._forecasts(u, queue, ahead)
        weights, kept = self._weighed(u, x, p)
        trusted = weights if self.delay_up_to is None else named("w_used", u.identified * weights)
        w = named("w_all", with_first(trusted, lag))
        q_start = named("q_mean", along(w, experts.q_start))
        wished = clip(named("dq_mean", along(w, experts.command)), p.u_max)
        limited = _followed_ramp.limited(self, u, x, p, wished, queue[:, 0])
        dq_sent = named("dq_now", x.queue[:, -1] + limited.change if "a_max" in p else wished)
        by_command = elementwise(experts.slope, halves(dq_sent, dq_sent, experts.command) - experts.command)
        ends = experts.q_start + u.T * (halves(u.dq_r, u.dq_r, experts.command) + by_command)
        E = experts.command.shape[1]
        if self.weighting == "exponential":
            correction = named("correction", experts.command - halves(u.dq_r, u.dq_r, experts.command))
            kept = {**kept, **self._begun(u, {"corrections": ca.horzcat(x.corrections[:, E:], correction)})}
        return Equations(
            outputs={"dq_sent": dq_sent, "q_start": q_start, "model_share": ca.sum2(w[:, E // 2 :])},
            next={
                **self._begun(u, {"observed": ca.horzcat(*held), "count": x.count + 1, **limited.begun}),
                **kept,
                **phase,
                "forecasts": ca.horzcat(x.forecasts[:, E:], ends),
                "q_before": u.q,
                **limited.kept,
                "queue": ca.horzcat(x.queue[:, 1:], dq_sent),
            },
        )

    def _begun(self, u: Signals, moved: Mapping[str, SX]) -> Mapping[str, SX]:
        """What begins when the delay is identified."""
        return moved if self.delay_up_to is None else {name: u.identified * new for name, new in moved.items()}

    def _forecasts(self, u: Signals, queue: SX, ahead: Callable[[int], SX]) -> Forecasts:
        """Of the experts without a model, then of those with it."""
        missed = [ahead(k) for k in range(1, longest(self) + 2)]
        coming = missed[-1] if self.delay_up_to is None else named("missed", chosen(missed, u.delay_hat))
        slopes = named("G", halves(0 * u.slope + 1, u.slope, coming))
        starts = halves(u.q, u.q_model, coming)
        for k in range(1, longest(self) + 1):
            known = halves(queue[:, k], 0 * u.q, coming)  # q_model holds the known commands
            moved = u.T * (known - elementwise(slopes, missed[k - 1]))
            starts = starts + (moved if self.delay_up_to is None else ca.if_else(u.delay_hat < k, 0 * moved, moved))
        command = named("u_i", halves(u.dq_r, u.dq_model, coming) + coming)
        return Forecasts(named("q_i", starts), command, slopes)

    def _row(self, u: Signals, x: Signals) -> tuple[SX, SX, SX]:
        """Rows h and outputs y of the projection, zero before the first forecast ends; and all errors."""
        D = longest(self)
        E, delay = x.forecasts.shape[1] // (D + 1), D if self.delay_up_to is None else u.delay_hat
        made = [x.forecasts[:, k * E : (k + 1) * E] for k in range(D, -1, -1)]  # the last one first
        arrived = made[D] if self.delay_up_to is None else named("arrived", chosen(made, delay))
        errors = named("e", (x.count > delay + 1) * (arrived - halves(u.q, u.q, arrived)) / u.T)
        return named("h_w", differences(errors)), named("y_w", -errors[:, 0]), errors

    def _weighed(self, u: Signals, x: Signals, p: Signals) -> tuple[SX, Mapping[str, SX]]:
        """The weights of all experts but the first, by losses or by projection; and the states for the next ones.

        Exponential weights begin when the delay is identified. Those of the projection stay, as its steps prescribe.
        """
        h, y, errors = self._row(u, x)
        if self.weighting == "projection":
            weights = named("w_new", projected(x.weights, h, y, p.Gamma, p.nu))
            return weights, {"weights": weights}
        delay = self.delay if self.delay_up_to is None else u.delay_hat
        before, last, newest = ca.horzsplit(x.corrections, errors.shape[1])
        rough = named("rough", (x.count > 2) * p.roughness * (newest - 2 * last + before))
        lost = elementwise(errors, errors) + elementwise(rough, rough)
        losses = named("L", ca.fmax(0, 1 - u.T / p.memory) * x.losses + lost)
        wanted = named("w_wanted", in_power(losses / (p.quiet * p.quiet) + 1, p.memory / (2 * u.T)))
        known = x.count > delay + 1  # before, all losses are zero
        weights = named("w_new", x.weights + known * p.weight_gain * (wanted - x.weights))
        return weights, self._begun(u, {"weights": weights, "losses": losses})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """Normalised steps of the weights towards any constant ones; nothing for exponential weights."""
        if self.weighting == "exponential":
            return None
        h, y, errors = self._row(u, x)
        n, E = errors.shape
        true = type(x.weights).sym("w_true", n * (E - 1))
        ones = ca.DM.ones(n * (E - 1))
        steps = NormalisedSteps(
            "weights", x.weights, true, p.Gamma * ones, (E - 1,) * n, p.nu, ((h, y),), (0 * ones, ones)
        )
        configured = self.delay_up_to is None and "dq_s" in truth and "q" in truth
        acted = (Acted(x.queue[:, 0], truth.dq_s, u.q, truth.q),) if configured else ()
        return Certificate(steps=(steps,), acted=acted, unknown={"w_true": true})


@operation
def halves(first: Any, second: Any, like: Any) -> Any:
    """A matrix of that size whose columns are the first column in its first half, and the second one in the rest."""
    half = like.shape[1] // 2
    return ca.horzcat(ca.repmat(first, 1, half), ca.repmat(second, 1, half))


@operation
def elementwise(a: Any, b: Any) -> Any:
    """The product of each element of two matrices."""
    return a * b


@operation
def differences(errors: Any) -> Any:
    """The errors of the experts without that of the first one, by joint in one column."""
    return ca.vec((errors[:, 1:] - ca.repmat(errors[:, 0], 1, errors.shape[1] - 1)).T)


@operation
def projected(w: Any, h: Any, y: Any, Gamma: Any, nu: Any) -> Any:
    """The weights after the step of each joint."""
    n = y.shape[0]
    rows, old = ca.reshape(h, -1, n), ca.reshape(w, -1, n)
    gain = Gamma * (y.T - ca.sum1(rows * old)) / (nu + Gamma * ca.sum1(rows * rows))
    return ca.vec(ca.fmin(ca.fmax(old + rows * ca.repmat(gain, rows.shape[0], 1), 0), 1))


@operation
def with_first(weights: Any, like: Any) -> Any:
    """All weights of each joint in a row, the first one so that their sum is 1."""
    rest = ca.reshape(weights, -1, like.shape[0]).T
    return ca.horzcat(1 - ca.sum2(rest), rest)


@operation
def along(w: Any, values: Any) -> Any:
    """The weighted mean of each row."""
    return ca.sum2(w * values)


@operation
def in_power(losses: Any, power: Any) -> Any:
    """Weights of all but the first expert, in proportion to its loss to minus that power, by joint in one column.

    The losses are divided by the least one first: its share is 1, so that the sum is not zero with any power.
    """
    E, least = losses.shape[1], losses[:, 0]
    for k in range(1, E):
        least = ca.fmin(least, losses[:, k])
    shares = ca.exp(-power * ca.log(losses / ca.repmat(least, 1, E)))
    return ca.vec((shares / ca.repmat(ca.sum2(shares), 1, E))[:, 1:].T)
