"""Sum of circular motions in a plane of the task space, with stops."""

from __future__ import annotations

from typing import Any, Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    TIME,
    AbstractBlock,
    Equations,
    NonNegative,
    Output,
    Positive,
    Real,
    Scalar,
    Side,
    Signals,
    Vector,
    named,
    operation,
)


@final
class Epicycles(AbstractBlock):
    r"""Tool path that is a sum of circles, each with its own radius and angular rate.

        x_d = c + sum_i r_i (cos(w_i t_stop + phi_i), sin(w_i t_stop + phi_i))

    with :math:`c = \mathrm{center}`, in the two axes of `plane`; a task with two coordinates has one plane only. One
    circle is a circle, two of opposite rates are an ellipse or a line, and incommensurate rates are a path that never
    repeats. The path time :math:`t_{stop}` is t, or stops at regular intervals: with :math:`P = \mathrm{every}`,

        t_stop = (1 - stop) t + stop P (n + s(tau))

    where n is the number of whole intervals until t, and :math:`s(\tau)` is the minimum-jerk motion of `waypoints` from
    0 to 1 over the first part of the interval, followed by a pause that takes the fraction `pause` of it. With a stop
    of 1 the tool is at rest there, with 0 it never stops.

    Parameters
    ----------
    center : (m,), m
        Centre of the first circle.
    radius : list, m
        Radius of each circle.
    rate : list, rad/s
        Angular rate of each circle; a negative one turns the other way.
    phase : list, rad
        Initial angle on each circle.
    plane : xy, xz or yz
        The plane in which the path lies.
    stop : scalar, >= 0
        How much of the motion stops, at most 1.
    every : scalar, s, > 0
        Interval from one stop to the next.
    pause : scalar, >= 0
        Fraction of the interval, below 1, that a stop takes.

    References
    ----------
    [Flash1985]_ for s.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("x_d", "m", "m"),)

    center: Vector = Real("m", "m", spread=False)
    radius: Vector = Real("*", "m", spread=False)
    rate: Vector = Real("*", "rad/s", spread=False)
    phase: Vector = Real("*", "rad", spread=False)
    plane: Literal["xy", "xz", "yz"] = "xy"
    stop: Scalar = NonNegative(default=0.0)
    every: Scalar = Positive("", "s", default=5.0)
    pause: Scalar = NonNegative(default=0.2)

    @model_validator(mode="after")
    def _sizes(self) -> Epicycles:
        counts = {name: len(getattr(self, name)) for name in ("radius", "rate", "phase")}
        if len(set(counts.values())) > 1:
            found = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ValueError(f"expected a radius, a rate and a phase for each circle, found {found}")
        if self.stop > 1:
            raise ValueError(f"expected a stop of at most 1, found {self.stop:g}")
        if self.pause >= 1:
            raise ValueError(f"expected a pause below 1, found {self.pause:g}")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The sum of the circles at the path time."""
        m = p.center.numel()
        first, second = ("xyz".index(axis) for axis in self.plane) if m == 3 else (0, 1)
        t_stop = named("t_stop", (1 - p.stop) * u.t + p.stop * p.every * stops(u.t / p.every, p.pause))
        angle = p.rate * t_stop + p.phase
        along: list[Any] = [0] * m
        along[first], along[second] = ca.dot(p.radius, ca.cos(angle)), ca.dot(p.radius, ca.sin(angle))
        return Equations(outputs={"x_d": p.center + ca.vertcat(*along)})


@operation
def stops(intervals: Any, pause: Any) -> Any:
    """The completed intervals, n + 10 s^3 - 15 s^4 + 6 s^5, with s the elapsed fraction of the last motion."""
    whole = ca.floor(intervals)
    s = ca.fmin((intervals - whole) / (1 - pause), 1)
    return whole + s * s * s * (10 + s * (6 * s - 15))
