"""Discrete-time reference for tracking in the task space with known kinematics."""

from __future__ import annotations

from typing import Self, final

import casadi as ca
from pydantic import Field, model_validator

from dmframe.block import (
    PERIOD,
    SX,
    AbstractBlock,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Signals,
    named,
    solve_spd,
)
from dmframe_blocks._identified_delay import (
    DELAY_HAT,
    IDENTIFIED,
    MOST_DELAY,
    longest,
    needs_delay,
)
from dmframe_blocks._margins import braked, check_gain, ends_of_sample, gain_at_limit, remark_of


@final
class SampledTracking(AbstractBlock):
    r"""Average joint velocity over a sample that moves the tool to the next point of its path.

    The commanded sample starts at the pose :math:`q_{start}` and should end with the tool at :math:`x_{goal}`. The
    error :math:`\Delta x = f(q_{start}) - x_d`, the output x_err, is fed back through the transpose of the Jacobian
    or, with Lambda, through its inverse:

    .. math::

        x_{goal} &= x_{d,1} + \Delta x - T \gamma J(q_{start}) J(q_{start})^\top \Delta x   \tag{1} \\
        x_{goal} &= x_{d,1} + (1 - T \Lambda) \Delta x                                     \tag{2}

    The velocity with :math:`f(q_{start} + T \dot q_r) = x_{goal}` is computed by two Newton
    steps, with :math:`q_0 = q_{start} + T \dot q_{null}` and :math:`q_1 = q_{start} + T v_1`:

    .. math::

        v_1      &= \dot q_{null} + J(q_0)^\top (J(q_0) J(q_0)^\top + \mathrm{damping}^2 I)^{-1}
                    (x_{goal} - f(q_0)) / T   \tag{3} \\
        \dot q_r &= v_1 + J(q_1)^\top (J(q_1) J(q_1)^\top + \mathrm{damping}^2 I)^{-1}
                    (x_{goal} - f(q_1)) / T   \tag{4}

    If the robot moves with this average velocity, the error decreases from sample to sample by the factor
    :math:`1 - T \gamma \sigma^2` in the directions of the singular values, or by :math:`1 - T \Lambda`. The motion of
    the path causes no error.

    *Gain from margins.* If the joints move by the command, multiplied by a constant gain g that is unknown, and m
    samples later than predicted, then :math:`\Delta x_{k+1} = \Delta x_k - T \Lambda g \Delta x_{k-m}`, which is stable
    if and only if :math:`0 < T \Lambda g < 2 \sin(\pi / (4 m + 2))`. With `gain_margin` in place of Lambda

        T Lambda = 2 sin(pi/(4 delay_margin + 2))/gain_margin

    so that this loop is stable with any g below `gain_margin` and any m up to `delay_margin`.

    *Braking.* A robot whose acceleration is limited cannot end a fast correction at once: with a high gain it
    overshoots, each time farther. With `braking` the gain is multiplied by the share with which each joint could stop
    at that acceleration when its error is zero. With the scaled error
    :math:`e = \max_j |(J^+ \Delta x)_j| / \mathrm{braking}_j`

        share = sqrt(2 far - 1)/far,    far = max(Lambda^2 e, 1)

    which is 1 for errors below :math:`\mathrm{braking} / \Lambda^2`. Choose it well below the acceleration of the
    robot, since the motion along the path needs a part of it.

    The output dq_path is the velocity along the path without feedback, :math:`J^+(q_{start}) (x_{d,1} - x_d)/T`.

    A command that acts `delay` samples later is computed for the sample that starts then: set the same `delay` in the
    block that predicts q_start. With `delay_up_to` the input delay_hat is this delay, and the margin of the gain is
    taken for delay_margin + delay_hat samples, so that it does not rely on the prediction; until the delay is
    identified it is taken for delay_margin + delay_up_to. dq_null moves a redundant robot in the null space of its
    Jacobian.

    Parameters
    ----------
    gamma : scalar, rad^2/(m^2 s), > 0
        Task gain with feedback through :math:`J^\top`. :math:`T \gamma` must be below 2 over the largest squared
        singular value of :math:`J`.
    Lambda : scalar, 1/s, > 0
        Task gain with feedback through the inverse of :math:`J`, instead of :math:`\gamma`. :math:`T \Lambda` must be
        below 2.
    gain_margin : scalar, >= 1
        Margin of the gain from a command to the motion, instead of gamma or Lambda: see above.
    delay_margin : 0, 1, 2, ...
        Margin of the delay from a command to the motion, in samples. The lag of the servo counts.
    braking : diagonal (n,), rad/s^2, > 0
        Acceleration with which a correction by Lambda or gain_margin brakes; without it the feedback is linear.
    damping : scalar, m/rad, >= 0
        Damping of the inverse: near a singular pose it limits the joint velocities, and the tool leaves its path.
    delay : 0, 1, ..., 8
        Whole samples from a command to its effect.
    delay_up_to : 1, 2, ..., 8
        Instead of `delay`: the input delay_hat of a `delay_probe` is the delay, up to this number of samples.

    Notes
    -----
    Not for: uncertain kinematics, or a signal x_d whose future is unknown.

    References
    ----------
    [WangTAC2020]_ Section V, for the law in continuous time; [LevinMay1976]_ for the bound of the gain.
    """

    uses_robot = True
    inputs = (
        Input("q_start", "n", "rad"),
        Input("x_d", "m", "m"),
        *(Input(f"x_d_{k}", "m", "m", ahead_of="x_d", ahead=k, optional=k > 3) for k in range(1, MOST_DELAY + 2)),
        Input("dq_null", "n", "rad/s", optional=True),
        DELAY_HAT,
        IDENTIFIED,
        PERIOD,
    )
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("x_err", "m", "m", optional=True),
        Output("dq_path", "n", "rad/s", optional=True),
    )

    gamma: Scalar | None = Positive("", "rad^2/(m^2 s)", default=None)
    Lambda: Scalar | None = Positive("", "1/s", default=None)
    gain_margin: Scalar | None = Positive(default=None)
    delay_margin: int = Field(1, ge=0)
    braking: Diagonal | None = Positive("n", "rad/s^2", default=None)
    damping: Scalar = NonNegative("", "m/rad", default=0.01)
    delay: int = Field(0, ge=0, le=MOST_DELAY)
    delay_up_to: int | None = Field(None, ge=1, le=MOST_DELAY)

    @model_validator(mode="after")
    def _has_one_gain(self) -> Self:
        gains = ("gamma", "Lambda", "gain_margin")
        check_gain(self, gains, "gamma, by J', and Lambda or gain_margin, by the inverse of J")
        if self.braking is not None and self.gamma is not None:
            raise ValueError("expected no braking with gamma, which feeds back through J'; give Lambda or gain_margin")
        return self

    def remark(self) -> str:
        """That the gain follows from margins."""
        return remark_of(self)

    def needs(self, port: str) -> bool:
        """The delay, if it is identified; and the path as far ahead as the longest delay."""
        return needs_delay(self, port) or port in [f"x_d_{k}" for k in range(4, longest(self) + 2)]

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (4), and the velocity along the path without feedback."""
        now, goal = self._points(u)
        x_err = named("x_err", p.robot.position(u.q_start) - now)
        x_goal = named("x_goal", goal + self._left(u, p, x_err))
        v_1 = named("v_1", self._newton(u, p, x_goal, u.dq_null))
        along = self._turned(p, u.q_start, (goal - now) / u.T)
        return Equations(outputs={"dq_r": self._newton(u, p, x_goal, v_1), "x_err": x_err, "dq_path": along})

    def _newton(self, u: Signals, p: Signals, x_goal: SX, v: SX) -> SX:
        """(3) and (4): one Newton step from the average velocity v for the sample that should end at x_goal."""
        q = u.q_start + u.T * v
        return v + self._turned(p, q, (x_goal - p.robot.position(q)) / u.T)

    def _turned(self, p: Signals, q: SX, dx: SX) -> SX:
        """The joint velocity of a tool velocity, by the damped inverse of J."""
        J = p.robot.jacobian(q)
        return J.T @ solve_spd(J @ J.T + p.damping * p.damping * ca.DM.eye(p.robot.m), dx)

    def _points(self, u: Signals) -> tuple[SX, SX]:
        """The points of the path at the start and at the end of the sample in which the command acts."""
        path = [getattr(u, name) for name in ("x_d", *(f"x_d_{k}" for k in range(1, longest(self) + 2)))]
        return ends_of_sample(self, u, path, names=("x_at", "x_to"))

    def _left(self, u: Signals, p: Signals, x_err: SX) -> SX:
        """The error that (1) or (2) leaves at the end of the sample."""
        if "gamma" in p:
            J = p.robot.jacobian(u.q_start)
            return x_err - u.T * p.gamma * (J @ (J.T @ x_err))
        step = u.T * p.Lambda if "Lambda" in p else gain_at_limit(self, u) / p.gain_margin
        if "braking" not in p:
            return (1 - step) * x_err
        error = named("error_scaled", ca.mmax(ca.fabs(self._turned(p, u.q_start, x_err)) / p.braking))
        return (1 - step * named("gain_share", braked(error, step / u.T))) * x_err
