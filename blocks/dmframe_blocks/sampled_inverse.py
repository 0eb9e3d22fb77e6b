"""Adaptive inverse of a closed servo in discrete time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, final

import casadi as ca
from pydantic import Field, model_validator

from dmframe.block import (
    ANY,
    PERIOD,
    SX,
    AbstractBlock,
    Access,
    Acted,
    Box,
    Certificate,
    Condition,
    Diagonal,
    Element,
    Equations,
    Input,
    Interval,
    NonNegative,
    Output,
    PlantIdentity,
    Positive,
    Scalar,
    Signals,
    State,
    clip,
    named,
)
from dmframe.robot.parameters import Friction
from dmframe_blocks._averaged_servo import AveragedServo, Start, averaged_servo
from dmframe_blocks._friction import columns_for
from dmframe_blocks._identified_delay import (
    DELAY_HAT,
    IDENTIFIED,
    MOST_DELAY,
    Aimed,
    acting,
    check_delay,
    longest,
    needs_delay,
)
from dmframe_blocks._last_sample import LastSample, last_sample
from dmframe_blocks._row_means import RowMeans
from dmframe_blocks._sample_estimators import Adaptation, Estimator, Projection, least_squares, triangle
from dmframe_blocks._sample_response import Ahead, Response
from dmframe_blocks._servo_truth import SERVO_TRUTH, true_servo


@final
class SampledInverse(AbstractBlock):
    r"""Identifies the discrete-time response of a closed servo and computes the command for a reference velocity.

    Averaged over a sample from kT to (k+1)T with constant command u, servo and robot satisfy an equation that is linear
    in constant parameters of each joint and uses measured positions only. With v = (q(k+1) - q(k))/T, the middle pose
    m = q + T v/2, the servo's target target, e = m - target - T u/2 and z the sum of T e over the earlier samples:

        y = u - v = psi' theta,    psi = (e, z + T e/2, 1, [Y_p(m, v) - Y_p before]/T - Y_c(m, v) + Y_g(m), v, phi(v))

    theta = (K_P/K_D, K_I/K_D, offset, w a, w B, w D), w = 1/(K K_D). It is the inverse of `pid_inverse` as an identity
    of measured data, so theta follows by regression from any motion; the adaptation does not depend on a feedback
    through the plant. For a PI servo the row is (e, 1, ...), theta is (K_I/K_P, offset, ...), and w = 1/(K K_P).
    For a P-PI servo with the share f of feed-forward, K_v, k_p and k_i = K_i/K_v, the row has u and target + T u/2
    after the 1, and theta is (k_p + k_i, k_p k_i, offset, 1 - f, k_i (1 - f), w a, ...), with w = 1/(K K_v).

    *Rows.* With `filtered`, both sides are high-pass filtered with the time constant tau, except for the 1:
    h = psi - L psi and g = y - L y, L y(k+1) = (1 - T/tau) L y(k) + T/tau y(k). The target then needs to be known up to
    a constant only, and z may drift.

    *Estimate by projections.* For the new row, the stored rows from new to old, and the new row again,

        theta = theta + Gamma h (g - h' theta)/(nu + h' Gamma h)

    then each element is clipped to its box. If the true theta is in the box, the sum of the squared estimation errors,
    weighted with the inverse of Gamma, increases by at most eta^2/(nu + h' Gamma h) per step, for any command, period
    and gain. eta is the difference between averages of functions and functions of averages.

    *Estimate by least squares.* Alternatively, recursive least squares over all rows, with a matrix G for each joint:

        theta = theta + P h (g - h' theta)/(nu + h' P h),    P = (1/Gamma + G)^-1,    G = retention (G + h h'/nu)

    The squared estimation errors, weighted with 1/Gamma + G, increase by at most eta^2/nu per sample. P is at most
    Gamma, so directions without data have the same gain as with projections, and directions with much data change
    little. The estimate is projected onto a violated face of the box in the norm of P^-1; if the result violates
    another face, G of that joint is reset to zero.

    *Command.* u makes the predicted residual of the coming sample zero for the average velocity dq_r:

        u = (dq_r + psi(dq_r, u = 0)' theta + L (y - psi' theta))/(1 + k_P T/2 + k_I T^2/4)

    with the change of momentum from the last planned velocity to this one. The change of momentum is omitted unless the
    symmetric part of 1 + w M/T - (1/2 + margin) is positive definite and |w M/T| is at most 4.

    *Delay.* A command acts `delay` samples later. The samples until then, whose commands are known, are predicted in
    sequence with the same equation; q_start is the predicted pose.

    The estimate of a joint whose command was clipped at u_max is not updated with that sample. With `echoed`, u and
    target are computed from the target that the robot reports.

    Parameters
    ----------
    servo : pid, pi or p_pi
        Kind of the manufacturer's servo: PID for positions, PI for velocities, or a P-PI cascade with an unknown share
        of velocity feed-forward, as `p_pi_servo`. The rows of `p_pi` fit a PID servo as well, with zeros.
    dynamics : robot or joints
        Inertial columns: those of the robot's regressors, or for each joint one, the change of its velocity. With
        joints, the parameters of the rows are not those of a rigid robot: the certificate is about any constant ones.
    friction : list of viscous, coulomb
        Friction with a column for each joint.
    delay : 0, 1, ..., 8
        Whole samples from a command to its effect. It must be correct.
    delay_up_to : 1, 2, ..., 8
        Instead of `delay`: the input delay_hat of a `delay_probe` is the delay, up to this number of samples. Until it
        is identified the estimate keeps its initial value, and no sample is stored.
    estimator : projection or least_squares
        Estimator of :math:`\theta`. With a quantising encoder least squares needs `average` 2 or more, otherwise it
        drifts; it is then less noisy than projections. After a change of load its errors are larger for some seconds.
    retention : scalar, > 0, <= 1
        Least squares only: the fraction of :math:`G` retained per sample. With 0.98 about 50 samples have weight.
    replay : number, > 0
        Number of stored samples that are used again at each sample; least squares stores none.
    average : number, > 0
        Number of consecutive samples whose mean is one row: about 70 ms with a quantising encoder.
    stride : number, > 0
        Store every stride-th sample: stored samples should be about 90 ms apart. Projections only.
    filtered : true or false
        High-pass filter both sides with :math:`\tau`. Without it even a constant error of the target grows in
        :math:`z`.
    tau : scalar, s, > 0
        Time constant of the high-pass filter: slower changes are treated as disturbances and not identified.
    nu : scalar, rad^2/s^2, > 0
        Normalisation: a row with :math:`h^\top \Gamma h` well below :math:`\nu` has little effect. A larger :math:`\nu`
        is less noisy and slower.
    w_0 : diagonal (n,), rad/(N m s), > 0
        Approximate value of :math:`1/(K K_D)`, within a factor of ten; it scales the elements of :math:`\theta`.
    k_P, k_I : (n,), 1/s, 1/s^2, > 0
        Initial values of these two elements; all others start at zero. For a PI servo :math:`k_I` is :math:`K_I/K_P`,
        in 1/s.
    k_P_size, k_I_size, k_u_size, k_q_size : scalar, 1/s, 1/s^2, , 1/s, > 0
        Expected deviations of these elements from their initial values: :math:`\Gamma` contains the squares.
    offset_size, inertia_size, friction_size : scalar, N m, kg m^2, N m s/rad, > 0
        The same for the offset, for :math:`w a`, and for :math:`w B` and :math:`w D`, divided by :math:`w_0`.
    k_P_box, k_I_box, offset_box, k_u_box, k_q_box : interval, 1/s, 1/s^2, rad/s, , 1/s
        Known intervals of these elements.
    inertia_box, friction_box : interval, kg m^2, N m s/rad
        The same for :math:`w a` and for :math:`w B`, :math:`w D`, divided by :math:`w_0`.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.
    margin : scalar, >= 0
        Margin of the slope above 1/2 in the condition on :math:`w M/T`.
    settling : scalar, s, >= 0
        Time after the start, or after the delay was identified, during which the estimates are constant: the large
        first error can drive the channel to its limits, which the rows do not contain.
    supervised : true or false
        Another block, such as `sampled_supervisor`, determines the command that is sent, `dq_sent`, which is then used
        as the applied command.
    echoed : true or false
        The robot reports the target of its servo: wire `q_echo` to it. The command applied in a sample is then computed
        from the change of the target, also if commands were delayed or lost.
    time_stamps : true or false
        The measurement times of the positions are known, and give the length of past samples; otherwise it is
        :math:`T`. The length of the coming sample is :math:`T` in both cases.
    aggregated : true or false
        Also output `slope`, the change of the predicted velocity per unit of command, for `expert_aggregation`.

    Notes
    -----
    Not for: a nonlinear servo, elastic joints, or a variable delay.

    References
    ----------
    [WangTAC2020]_, for the inverses of both servos in continuous time.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_sent", "n", "rad/s", optional=True),
        Input("q_echo", "n", "rad", optional=True),
        Input("t", "", "s", optional=True),
        DELAY_HAT,
        IDENTIFIED,
        PERIOD,
    )
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("epsilon", "n", "rad/s"),
        Output("guarded"),
        Output("slope", "n", optional=True),
    )
    truth = SERVO_TRUTH
    states = (
        State("theta", "c", sampled=True),
        State("gathered", "G", sampled=True, optional=True, recorded=False),
        State("rows", "W c", sampled=True, optional=True, recorded=False),
        State("goals", "W n", "rad/s", sampled=True, optional=True, recorded=False),
        State("late_rows", "A c", sampled=True, optional=True, recorded=False),
        State("late_goals", "A n", "rad/s", sampled=True, optional=True, recorded=False),
        State("psi_slow", "c", ANY, sampled=True, optional=True, recorded=False),
        State("y_slow", "n", "rad/s", sampled=True, optional=True),
        State("q_before", "n", "rad", sampled=True),
        State("q_aim", "n", "rad", sampled=True),
        State("z", "n", "rad s", sampled=True),
        State("m_before", "n", "rad", sampled=True),
        State("v_before", "n", "rad/s", sampled=True),
        State("m_planned", "n", "rad", sampled=True),
        State("plans", "n d", "rad/s", sampled=True),
        State("queue", "n d", "rad/s", sampled=True),
        State("count", sampled=True),
        State("turn", sampled=True, optional=True),
        State("t_before", "", "s", sampled=True, optional=True),
    )

    servo: Literal["pid", "pi", "p_pi"] = "pid"
    dynamics: Literal["robot", "joints"] = "robot"
    friction: tuple[Friction, ...] = ("viscous", "coulomb")
    delay: int = Field(0, ge=0, le=MOST_DELAY)
    delay_up_to: int | None = Field(None, ge=1, le=MOST_DELAY)
    estimator: Literal["projection", "least_squares"] = "projection"
    retention: Scalar = Positive(default=0.98)
    replay: int = Field(20, ge=1)
    average: int = Field(1, ge=1)
    stride: int = Field(1, ge=1)
    filtered: bool = True
    tau: Scalar = Positive("", "s", default=2.0)
    nu: Scalar = Positive("", "rad^2/s^2", default=1e-5)
    w_0: Diagonal = Positive("n", "rad/(N m s)")
    k_P: Diagonal = Positive("n", "1/s", default=1.8)
    k_I: Diagonal = Positive("n", "1/s^2", default=1.2, several=True)  # 1/s with a PI servo
    k_P_size: Scalar = Positive("", "1/s", default=1.0)
    k_I_size: Scalar = Positive("", "1/s^2", default=1.0, several=True)
    offset_size: Scalar = Positive("", "N m", default=30.0)
    inertia_size: Scalar = Positive("", "kg m^2", default=5.0, several=True)
    friction_size: Scalar = Positive("", "N m s/rad", default=5.0, several=True)
    k_u_size: Scalar = Positive(default=0.3)
    k_q_size: Scalar = Positive("", "1/s", default=3.0)
    k_P_box: Box = Interval("", "1/s", default=(0.2, 6.0))
    k_I_box: Box = Interval("", "1/s^2", default=(0.05, 4.0), several=True)
    offset_box: Box = Interval("", "rad/s", default=(-1.0, 1.0))
    k_u_box: Box = Interval(default=(-1.0, 1.5))
    k_q_box: Box = Interval("", "1/s", default=(-20.0, 20.0))
    inertia_box: Box = Interval("", "kg m^2", default=(-20.0, 20.0), several=True)
    friction_box: Box = Interval("", "N m s/rad", default=(0.0, 50.0), several=True)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    margin: Scalar = NonNegative(default=0.05)
    settling: Scalar = NonNegative("", "s", default=0.0)
    supervised: bool = False
    echoed: bool = False
    time_stamps: bool = False
    aggregated: bool = False

    @model_validator(mode="after")
    def _fits(self) -> SampledInverse:
        if self.retention > 1:
            raise ValueError(
                f"expected a retention of 1 at most, with which nothing is forgotten, found {self.retention}"
            )
        other = ("replay", "stride") if self.estimator == "least_squares" else ("retention",)
        for name in other:
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"expected no {name} with estimator {self.estimator}, which has none; leave it out")
        check_delay(self)
        return self

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """c: the parameters of all joints."""
        return {"c": averaged_servo(robot, self.servo, frozenset(self.friction), self.dynamics).elements}

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """W: stored rows; G: elements of the information matrices; A: rows averaged with a new one; d: queue length."""
        gathered = sum(map(triangle, averaged_servo(robot, self.servo, frozenset(self.friction), self.dynamics).parts))
        own = {"W": self.replay, "G": gathered, "A": self.average - 1, "d": longest(self) + 1}
        return {**super().sizes(robot), **own}

    def needs(self, port: str) -> bool:
        """The sent command if another block determines it; the target if the robot reports it."""
        return {"dq_sent": self.supervised, "q_echo": self.echoed}.get(port, needs_delay(self, port))

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with a zero command in the previous sample."""
        averaged, still = self._averaged(p), 0 * u.q
        begins = {"q_before": u.q, "q_aim": u.q_echo if self.echoed else u.q, "m_before": u.q, "m_planned": u.q}
        if self.filtered:
            row = self._response(p).row(Start(u.q, u.q, still, u.q, still), still, still, u.T)
            begins["psi_slow"] = averaged.changing(row)
        if self.time_stamps:
            begins["t_before"] = u.t - u.T
        return {**begins, "theta": averaged.kinds(p.k_P, p.k_I, 0, 0, 0, *averaged.of_p_pi(0, 0))}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The last sample, the update of the estimate, the predicted start of the command, and the command."""
        averaged, response, last = self._averaged(p), self._response(p), self._last(u, x, p)
        new = last.row_and_goal(response, u, x, p.settling, p.u_max)
        row, goal, kept = RowMeans(averaged, self.average).after(x, *new)
        if self.time_stamps:
            kept["t_before"] = u.t
        theta, memory = self._estimator(p).updated(x, row, goal, self._adaptation(p))
        theta_new = named("theta_new", theta)

        T, v = last.T, last.v
        middle = x.q_before + T * v / 2
        late = last.command if self.echoed else x.queue[:, 0]
        target, z = last.aimed.after(last.command, middle, T)
        q_aim, z_aim = Aimed(x.q_aim, x.z).after(late, middle, T)
        start, slow, next_slow = Start(u.q, target, z, middle, v), 0 * v, dict[str, SX]()
        if last.slow:
            psi_slow, y_slow = last.filtered(averaged, *last.slow, T / p.tau)
            slow, next_slow = y_slow - averaged.answer(psi_slow, theta_new), {"psi_slow": psi_slow, "y_slow": y_slow}
        delay = None if self.delay_up_to is None else u.delay_hat
        ahead = Ahead(acting(self, u, x.queue), acting(self, u, x.plans), delay, u.T)
        slow_share = u.T / p.tau if self.filtered else 0
        start, slow = response.when_acting(ahead, start, slow, slow_share, theta_new, p.margin)
        S = response.slope(theta_new, start.q, u.T)
        safe = averaged.safe(S, p.margin)
        dq_c = self._command(u, x, p, theta_new, start, slow, safe)
        rises = 1 + averaged.damping(theta_new, v, p.robot.friction_velocity, u.T) + safe * ca.diag(S)
        rises = (rises + ca.sqrt(rises * rises + 0.01)) / 2  # above zero with any estimate
        moved = {"slope": (1 + averaged.share(theta_new, u.T)) / rises} if self.aggregated else {}
        return Equations(
            outputs={
                **moved,
                "dq_c": dq_c,
                "q_start": start.q,
                "epsilon": last.g - averaged.answer(last.h, x.theta),
                "guarded": 1 - safe,
            },
            next={
                "theta": theta_new,
                **memory,
                **kept,
                "q_before": u.q,
                "m_before": middle,
                "v_before": v,
                "m_planned": start.q + u.T * u.dq_r / 2,
                "plans": ca.horzcat(x.plans[:, 1:], u.dq_r),
                "queue": ca.horzcat(x.queue[:, 1:], u.dq_sent if self.supervised else dq_c),
                "q_aim": q_aim,
                "z": z_aim,
                "count": x.count + 1 if self.delay_up_to is None else u.identified * (x.count + 1),
                **next_slow,
            },
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Steps of the estimate from sample to sample, and the identity of servo and robot between samples."""
        averaged, robot, last = self._averaged(p), p.robot, self._last(u, x, p)
        new, aim = last.row_and_goal(self._response(p), u, x, p.settling, p.u_max)
        row, goal, kept = RowMeans(averaged, self.average).after(x, new, aim)
        estimator, adaptation = self._estimator(p), self._adaptation(p)
        lines = (*estimator.kept(x, row, goal), *RowMeans.lines(kept, new, aim))
        known = not self.echoed and "dq_s" in truth and "q" in truth
        acted = (Acted(last.command, truth.dq_s, u.q, truth.q),) if known else ()
        plant = tuple[PlantIdentity, ...]()
        if averaged.coupled:
            unknown = {"offset": type(x.theta).sym("offset", robot.n)}
            true, identity = true_servo(averaged, self.servo, self.friction, robot, truth, unknown["offset"])
            plant = (identity,)
        else:  # any constants
            true = type(x.theta).sym("theta_true", averaged.size)
            unknown = {"theta_true": true}
        steps = estimator.steps(x, true, row, goal, adaptation)
        return Certificate(steps=(steps,), delay_lines=lines, plant=plant, acted=acted, unknown=unknown)

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """The rows have a column for each kind of friction of the plant; without coupling they hold any constants."""
        return columns_for(self.friction, truth) if self.dynamics == "robot" else ()

    def _last(self, u: Signals, x: Signals, p: Signals) -> LastSample:
        return last_sample(self, self._response(p), u, x)

    def _averaged(self, p: Signals) -> AveragedServo:
        return averaged_servo(p.robot.chain, self.servo, frozenset(self.friction), self.dynamics)

    def _response(self, p: Signals) -> Response:
        return Response(self._averaged(p), p.robot)

    def _estimator(self, p: Signals) -> Estimator:
        averaged = self._averaged(p)
        squares = self.estimator == "least_squares"
        return least_squares(averaged) if squares else Projection(averaged, self.replay, self.stride)

    def _adaptation(self, p: Signals) -> Adaptation:
        averaged = self._averaged(p)
        return Adaptation(averaged.gamma(p), p.nu, averaged.box(p), p.retention)

    def _command(self, u: Signals, x: Signals, p: Signals, theta: SX, start: Start, slow: SX, safe: SX) -> SX:
        """The command for which theta predicts dq_r, with the momentum of planned velocities, clipped to its bounds."""
        averaged, planned = self._averaged(p), start._replace(m_before=x.m_planned, v_before=x.plans[:, -1])
        psi_c = named("psi_c", self._response(p).row(planned, u.dq_r, 0 * u.dq_r, u.T, safe))
        wanted = u.dq_r + averaged.answer(psi_c, theta) + slow
        return clip(wanted / (1 + averaged.share(theta, u.T)), p.u_max)
