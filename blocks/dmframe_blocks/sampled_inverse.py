"""Adaptive inverse of a position servo, over one sample."""

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
    DelayLine,
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
    solve_spd,
)
from dmframe.robot.parameters import Friction
from dmframe_blocks._averaged_servo import AveragedServo, Start, averaged_servo
from dmframe_blocks._friction import columns_for
from dmframe_blocks._loads import with_held
from dmframe_blocks._sample_estimators import Estimator, Learning, Projection, least_squares, triangle

_PREDICTING = 4
"""Newton's steps with which the average velocity of a sample is predicted whose command is known."""


@final
class SampledInverse(AbstractBlock):
    r"""Learns over samples how a closed servo answers, and commands what makes it move as asked.

    Averaged over a sample from kT to (k+1)T with the command u held, servo and robot are linear in constants of each
    joint, from measured positions alone. With v = (q(k+1) - q(k))/T, the middle pose m = q + T v/2, the servo's target
    target, e = m - target - T u/2 and z the sum of T e over the samples before:

        y = u - v = psi' theta,    psi = (e, z + T e/2, 1, [Y_p(m, v) - Y_p before]/T - Y_c(m, v) + Y_g(m), v, phi(v))

    theta = (K_P/K_D, K_I/K_D, offset, w a, w B, w D), w = 1/(K K_D). It is the inverse of `pid_inverse` with equality,
    so theta follows by regression, whatever moved the robot; no plant stands in the loop of the adaptation. Of a PI
    servo the row is (e, 1, ...), theta (K_I/K_P, offset, ...), w = 1/(K K_P).

    *Rows.* With `filtered`, what both sides have been over the time tau is taken from them, except from the 1:
    h = psi - L psi and g = y - L y, L y(k+1) = (1 - T/tau) L y(k) + T/tau y(k). So a target that is known but for a
    constant is as good, and z may drift.

    *Estimate.* For the new row, the stored ones from new to old, and the new one once more,

        theta = theta + Gamma h (g - h' theta)/(nu + h' Gamma h)

    then each element is put back into its box. With theta in the box the sum of the squared errors, weighed by the
    inverse of Gamma, rises in no step by more than eta^2/(nu + h' Gamma h), eta being what averages of functions lose
    against functions of averages, whatever the command, the period and the gain.

    *Estimate by least squares.* Instead, of all rows so far: for the new one alone, with a matrix G for each joint,

        theta = theta + P h (g - h' theta)/(nu + h' P h),    P = (1/Gamma + G)^-1,    G = retention (G + h h'/nu)

    The squared errors, weighed by 1/Gamma + G, rise by no more than eta^2/nu a sample. P is never above Gamma, so that
    what no row shows is learnt no faster than with projections; what many rows have shown is hardly moved by one more.
    A face of the box is met along the nearest line as P^-1 measures it; where that leads out of another face, G of
    that joint starts again at zero.

    *Command.* u makes the predicted error of the coming sample zero, if its average velocity is dq_r:

        u = (dq_r + psi(dq_r, u = 0)' theta + L (y - psi' theta))/(1 + k_P T/2 + k_I T^2/4)

    its momentum changing from the last planned velocity to this one. Where w M/T is no safe slope, the momentum stays
    out: the symmetric part of 1 + w M/T - (1/2 + margin) is to be positive definite, and |w M/T| at most 4.

    *Delay.* A command acts `delay` samples later. The samples until then, whose commands are known, are predicted one
    by one from the same relation; q_start is where the robot then is.

    A joint whose command was clipped at u_max learns nothing from that sample. With `echoed`, u and target are what the
    robot says that they were.

    Parameters
    ----------
    servo : pid or pi
        What the maker's servo is: PID of positions, or PI of velocities.
    friction : list of viscous, coulomb
        Friction with a column for each joint.
    delay : 0, 1 or 2
        Whole samples from a command to its effect. It must be right.
    estimator : projection or least_squares
        How theta is learnt. Behind an encoder least squares wants `average` 2 or more, without which it drifts, and is
        quieter then; it errs more, for seconds, when a load changes.
    retention : scalar, > 0, <= 1
        Of least squares: the share of G that is kept from sample to sample. At 0.98 some 50 samples count.
    replay : number, > 0
        How many samples are kept and learnt from again; least squares keeps none.
    average : number, > 0
        How many samples in a row are learnt from as one, their mean: some 70 ms of an encoder with steps.
    stride : number, > 0
        Of how many samples one is stored: those that are replayed should be some 90 ms apart. Not of least squares.
    filtered : true or false
        Learn from changes within tau. Without it an error of the target, even constant, grows in z.
    tau : scalar, s, > 0
        The time over which what is slow counts as a disturbance, and not as something to learn.
    nu : scalar, rad^2/s^2, > 0
        Below this share of h' Gamma h a row teaches little. Larger is quieter and slower.
    w_0 : diagonal (n,), rad/(N m s), > 0
        A guess of 1/(K K_D), right to a factor of ten: by it the elements of theta count alike.
    k_P, k_I : (n,), 1/s, 1/s^2, > 0
        Where these two elements start; all others start at zero. With a PI servo k_I, K_I/K_P, is in 1/s.
    k_P_size, k_I_size : scalar, 1/s, 1/s^2, > 0
        How far from their start these elements may well be: Gamma holds the squares.
    offset_size, inertia_size, friction_size : scalar, N m, kg m^2, N m s/rad, > 0
        The same of the offset, of w a, and of w B and w D, over w_0.
    k_P_box, k_I_box, offset_box : interval, 1/s, 1/s^2, rad/s
        Where these elements are known to be.
    inertia_box, friction_box : interval, kg m^2, N m s/rad
        The same of w a and w B, w D, over w_0.
    u_max : diagonal (n,), rad/s, > 0
        The largest command.
    margin : scalar, >= 0
        Of the slope above 1/2.
    supervised : true or false
        Another block, such as `sampled_supervisor`, decides what is sent, dq_sent: it is what acts and is learnt from.
    echoed : true or false
        The robot reports the target of its servo: wire q_echo to it. What acted in a sample is then what the target has
        moved by, whatever became of the commands on their way.
    time_stamps : true or false
        The time at which positions were measured is known, so that a sample that is over was as long as it was; without
        it, T. The coming sample is taken to last T either way.

    Notes
    -----
    Not for: a servo that is not linear, elastic joints, or a delay that changes.

    References
    ----------
    [WangTAC2020]_, whose inverses of both servos it reads over a sample.
    """

    uses_robot = True
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
        Output("epsilon", "n", "rad/s"),
        Output("guarded"),
    )
    truth = (
        Input("K", "n", "N m/V"),
        Input("K_D", "n", "V s/rad"),
        Input("K_P", "n", ANY),
        Input("K_I", "n", ANY),
        Input("B", "n", "N m s/rad"),
        Input("D", "n", "N m"),
        Input("i", "n", ANY),
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_c", "n", "rad"),
        Input("dq_s", "n", "rad/s"),
        Input("a_held", "10"),
    )
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

    servo: Literal["pid", "pi"] = "pid"
    friction: tuple[Friction, ...] = ("viscous", "coulomb")
    delay: Literal[0, 1, 2] = 0
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
    k_P_box: Box = Interval("", "1/s", default=(0.2, 6.0))
    k_I_box: Box = Interval("", "1/s^2", default=(0.05, 4.0), several=True)
    offset_box: Box = Interval("", "rad/s", default=(-1.0, 1.0))
    inertia_box: Box = Interval("", "kg m^2", default=(-20.0, 20.0), several=True)
    friction_box: Box = Interval("", "N m s/rad", default=(0.0, 50.0), several=True)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    margin: Scalar = NonNegative(default=0.05)
    supervised: bool = False
    echoed: bool = False
    time_stamps: bool = False

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
        return self

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """c: the parameters of all joints."""
        return {"c": averaged_servo(robot, self.servo, frozenset(self.friction)).elements}

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """W rows are stored, G numbers gathered, A rows averaged with a new one; d commands act now or wait."""
        gathered = sum(map(triangle, averaged_servo(robot, self.servo, frozenset(self.friction)).parts))
        own = {"W": self.replay, "G": gathered, "A": self.average - 1, "d": self.delay + 1}
        return {**super().sizes(robot), **own}

    def needs(self, port: str) -> bool:
        """What is sent, where another block decides it; the target, where the robot reports it."""
        return {"dq_sent": self.supervised, "q_echo": self.echoed}.get(port, False)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, as if nothing had been commanded in the sample before."""
        averaged, still = self._averaged(p), 0 * u.q
        begins = {"q_before": u.q, "q_aim": u.q_echo if self.echoed else u.q, "m_before": u.q, "m_planned": u.q}
        if self.filtered:
            begins["psi_slow"] = averaged.changing(self._psi(p, Start(u.q, u.q, still, u.q, still), still, still, u.T))
        if self.time_stamps:
            begins["t_before"] = u.t - u.T
        return {**begins, "theta": averaged.kinds(p.k_P, p.k_I, 0, 0, 0)}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """What the last sample was, what is learnt from it, where the command will act, and the command."""
        averaged, T = self._averaged(p), self._over(u, x)
        u_applied, v, psi, y, h, g = self._sample(u, x, p)
        row, goal, kept = self._meant(x, p, *self._lesson(x, p, u_applied, h, g))
        if self.time_stamps:
            kept["t_before"] = u.t
        theta, learnt = self._estimator(p).learnt(x, row, goal, self._learning(p))
        theta_new = named("theta_new", theta)

        middle = x.q_before + T * v / 2
        target, z = x.q_aim + T * u_applied, x.z + T * (middle - x.q_aim - T * u_applied / 2)
        start, slow, next_slow = Start(u.q, target, z, middle, v), 0 * y, dict[str, SX]()
        if self.filtered:
            psi_slow = named("psi_next", averaged.changing(x.psi_slow + T / p.tau * (psi - x.psi_slow)))
            y_slow = named("y_next", x.y_slow + T / p.tau * (y - x.y_slow))
            slow, next_slow = y_slow - averaged.answer(psi_slow, theta_new), {"psi_slow": psi_slow, "y_slow": y_slow}
        for k in range(1, self.delay + 1):
            start, slow = self._predicted(k, x, p, theta_new, start, slow, u.T)
        safe = averaged.safe(self._slope(p, theta_new, start.q, u.T), p.margin)
        dq_c = self._command(u, x, p, theta_new, start, slow, safe)
        return Equations(
            outputs={
                "dq_c": dq_c,
                "q_start": start.q,
                "epsilon": g - averaged.answer(h, x.theta),
                "guarded": 1 - safe,
            },
            next={
                "theta": theta_new,
                **learnt,
                **kept,
                **next_slow,
                "q_before": u.q,
                "q_aim": target,
                "z": z,
                "m_before": middle,
                "v_before": v,
                "m_planned": start.q + u.T * u.dq_r / 2,
                "plans": ca.horzcat(x.plans[:, 1:], u.dq_r),
                "queue": ca.horzcat(x.queue[:, 1:], u.dq_sent if self.supervised else dq_c),
                "count": x.count + 1,
            },
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """What the estimate's error does from sample to sample, and what servo and robot obey in between."""
        averaged, robot = self._averaged(p), p.robot
        u_applied, _, _, _, h, g = self._sample(u, x, p)
        new, aim = self._lesson(x, p, u_applied, h, g)
        row, goal, kept = self._meant(x, p, new, aim)
        pid = self.servo == "pid"
        gain = truth.K_D if pid else truth.K_P
        w, offset = 1 / (truth.K * gain), type(x.theta).sym("offset", robot.n)
        k_P, k_I = truth.K_P / gain, truth.K_I / gain
        B, D = (truth.B if "viscous" in self.friction else 0 * w), (truth.D if "coulomb" in self.friction else 0 * w)
        links = with_held(robot.inertia, truth.a_held) if "a_held" in truth else robot.inertia
        true = averaged.row(k_P if pid else k_I, k_I, offset, w @ links.T, w * B, w * D)
        estimator = self._estimator(p)
        i = truth.i - offset / k_I
        Y = robot.gravity_regressor(truth.q) - robot.kinetic_regressor(truth.q, truth.dq)
        one, phi, still = ca.DM.ones(robot.n), robot.coulomb(truth.dq), 0 * truth.dq
        rest = averaged.row(truth.q - truth.q_c if pid else i, i, one, Y, truth.dq, phi)
        moving = averaged.row(still, still, still, robot.momentum_regressor(truth.q, truth.dq), still, still)
        return Certificate(
            steps=(estimator.steps(x, true, row, goal, self._learning(p)),),
            delay_lines=(
                *estimator.kept(x, row, goal),
                *(DelayLine(name, item.T) for name, item in (("late_rows", new), ("late_goals", aim)) if name in kept),
            ),
            plant=(PlantIdentity(averaged.answer(moving, true), averaged.answer(rest, true) + truth.dq - truth.dq_s),),
            acted=() if self.echoed else (Acted(u_applied, truth.dq_s, u.q, truth.q),),
            unknown={"offset": offset},
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """Whatever friction the plant has, the rows have a column for it."""
        return columns_for(self.friction, truth)

    def _sample(self, u: Signals, x: Signals, p: Signals) -> tuple[SX, SX, SX, SX, SX, SX]:
        """Of the sample that is over: command and average velocity, psi and y, and h and g, less what is slow."""
        T = self._over(u, x)
        u_applied = named("u_applied", (u.q_echo - x.q_aim) / T if self.echoed else x.queue[:, 0])
        v = named("v", (u.q - x.q_before) / T)
        psi = named("psi", self._psi(p, Start(x.q_before, x.q_aim, x.z, x.m_before, x.v_before), v, u_applied, T))
        y = named("y_row", u_applied - v)
        h, g = (named("h_row", psi - x.psi_slow), named("g_row", y - x.y_slow)) if self.filtered else (psi, y)
        return u_applied, v, psi, y, h, g

    def _over(self, u: Signals, x: Signals) -> SX:
        """How long the sample that is over was."""
        return named("T_over", u.t - x.t_before) if self.time_stamps else u.T

    def _lesson(self, x: Signals, p: Signals, u_applied: SX, h: SX, g: SX) -> tuple[SX, SX]:
        """What is learnt from h and g: nothing where the command was clipped."""
        learns = named("learns", (x.count > 0) * (ca.fabs(u_applied) < p.u_max))
        return self._averaged(p).of_joint(learns) * h, learns * g

    def _averaged(self, p: Signals) -> AveragedServo:
        return averaged_servo(p.robot.chain, self.servo, frozenset(self.friction))

    def _psi(self, p: Signals, start: Start, v: SX, command: SX, T: SX, *, momentum: SX = 1) -> SX:
        """The row of a sample with average velocity v under a command; `momentum` 0 leaves that's change out."""
        robot, m = p.robot, start.q + T * v / 2
        e = m - start.target - T * command / 2
        change = (robot.momentum_regressor(m, v) - robot.momentum_regressor(start.m_before, start.v_before)) / T
        Y = momentum * change - robot.kinetic_regressor(m, v) + robot.gravity_regressor(m)
        return self._averaged(p).row(e, start.z + T * e / 2, ca.DM.ones(robot.n), Y, v, robot.coulomb(v))

    def _meant(self, x: Signals, p: Signals, row: SX, goal: SX) -> tuple[SX, SX, dict[str, SX]]:
        """The mean of a new row and those before it, of which there are few at first; and what is kept of them."""
        if self.average == 1:
            return row, goal, {}
        averaged, number = self._averaged(p), named("number", ca.fmax(1, ca.fmin(x.count, self.average)))
        late = {"late_rows": averaged.pushed(x.late_rows, row), "late_goals": averaged.pushed(x.late_goals, goal)}
        mean = named("mean_row", (row + averaged.total(x.late_rows)) / number)
        return mean, named("mean_goal", (goal + averaged.total(x.late_goals)) / number), late

    def _estimator(self, p: Signals) -> Estimator:
        averaged = self._averaged(p)
        squares = self.estimator == "least_squares"
        return least_squares(averaged) if squares else Projection(averaged, self.replay, self.stride)

    def _learning(self, p: Signals) -> Learning:
        return Learning(self._gamma(p), p.nu, self._box(p), p.retention)

    def _gamma(self, p: Signals) -> SX:
        """The squares of how far each element may be from its start."""
        kinds, w = self._averaged(p).kinds, p.w_0
        sizes = kinds(p.k_P_size, p.k_I_size, w * p.offset_size, w * p.inertia_size, w * p.friction_size)
        return sizes * sizes

    def _box(self, p: Signals) -> SX:
        """The least and the greatest of each element."""
        w = p.w_0
        return self._averaged(p).kinds(p.k_P_box, p.k_I_box, p.offset_box, w @ p.inertia_box, w @ p.friction_box)

    def _slope(self, p: Signals, theta: SX, q: SX, T: SX) -> SX:
        """S = w M(q)/T as theta has it: how the answer rises with the velocity, by inertia."""
        robot, units = p.robot, ca.horzsplit(ca.DM.eye(p.robot.n))
        momenta = ca.horzcat(*(robot.momentum_regressor(q, unit) for unit in units))
        return self._averaged(p).inertia(theta, momenta) / T

    def _predicted(self, k: int, x: Signals, p: Signals, theta: SX, start: Start, slow: SX, T: SX) -> tuple[Start, SX]:
        """Where sample k from now starts, and what is slow then, after one whose command is known."""
        averaged, robot, command, v = self._averaged(p), p.robot, x.queue[:, k], x.plans[:, k]
        S = named(f"S_{k}", self._slope(p, theta, start.q, T))
        safe = named(f"safe_{k}", averaged.safe(S, p.margin))
        rises = named(f"rise_{k}", ca.DM.eye(robot.n) + safe * (S + S.T) / 2)

        def left(v: SX) -> SX:
            return command - v - averaged.answer(self._psi(p, start, v, command, T, momentum=safe), theta)

        for i in range(1, _PREDICTING + 1):
            damped = rises + ca.diag(averaged.damping(theta, v, robot.friction_velocity, T))
            v = named(f"v_{k}_{i}", v + solve_spd(damped, left(v) - slow))
        if self.filtered:
            slow = named(f"slow_{k}", slow + T / p.tau * (left(v) + averaged.offset(theta) - slow))
        middle = named(f"m_{k}", start.q + T * v / 2)
        z = named(f"z_{k}", start.z + T * (middle - start.target - T * command / 2))
        target = named(f"target_{k}", start.target + T * command)
        return Start(named(f"q_{k}", start.q + T * v), target, z, middle, v), slow

    def _command(self, u: Signals, x: Signals, p: Signals, theta: SX, start: Start, slow: SX, safe: SX) -> SX:
        """The command under which dq_r is what theta predicts, momentum from plan to plan, within its bounds."""
        averaged, planned = self._averaged(p), start._replace(m_before=x.m_planned, v_before=x.plans[:, -1])
        psi_c = named("psi_c", self._psi(p, planned, u.dq_r, 0 * u.dq_r, u.T, momentum=safe))
        wanted = u.dq_r + averaged.answer(psi_c, theta) + slow
        return clip(wanted / (1 + averaged.share(theta, u.T)), p.u_max)
