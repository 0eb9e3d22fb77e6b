"""Reference velocity that respects joint limits."""

from __future__ import annotations

from typing import Any, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Barrier,
    Certificate,
    Condition,
    Diagonal,
    Equations,
    Inequality,
    Input,
    NonNegative,
    Output,
    Positive,
    Real,
    Signals,
    named,
)


@final
class SafeReference(AbstractBlock):
    r"""Limits a reference velocity so that the joints respect their position and velocity limits.

    .. math::

        r_{up}  &= \mathrm{approach} (q_{max} - \mathrm{margin} - q), \quad
        r_{low} = \mathrm{approach} (q - q_{min} - \mathrm{margin})   \tag{1} \\
        v_{up}  &= \tfrac12 (v_{max} + r_{up}
                   - \mathrm{rounding} \sqrt{1 + ((v_{max} - r_{up}) / \mathrm{rounding})^2})   \tag{2} \\
        v_{low} &= \tfrac12 (\mathrm{rounding} \sqrt{1 + ((v_{max} - r_{low}) / \mathrm{rounding})^2}
                   - v_{max} - r_{low})   \tag{3} \\
        \dot q_r &= \tfrac12 (v_{low} + v_{up}
                   + \mathrm{rounding} \sqrt{1 + ((\dot q_{wish} - v_{low}) / \mathrm{rounding})^2}
                   - \mathrm{rounding} \sqrt{1 + ((\dot q_{wish} - v_{up}) / \mathrm{rounding})^2})   \tag{4}

    and with limits from the graph

    .. math::

        r_{up}  &= \mathrm{approach} (\mathrm{upper} - \mathrm{margin} - q), \quad
        r_{low} = \mathrm{approach} (q - \mathrm{lower} - \mathrm{margin})   \tag{5}

    (2) is smooth and never above :math:`r_{up}` and :math:`v_{max}`; (3) correspondingly below. (4) always lies between
    both, and approximates the wish if that is well between them. The limits :math:`q_{min}`, :math:`q_{max}` and
    :math:`v_{max}` are those of the robot's URDF, unless `lower`, `upper` and `speed` are given.

    The storage of the servo level decreases for any reference velocity with a known derivative. The block therefore
    limits the reference, not the command. The distance of a joint from its limit decreases no faster than approach
    times the distance plus the velocity tracking error s, whose square V dissipates; V(0) bounds its integral. `verify`
    computes by how much each joint may exceed the limits of the reference, from the initial state and the intervals of
    `uncertain`. A `margin` of this size keeps the true limits.

    The limits have precedence over the path: while one is active the tool waits or leaves its path, and there is no
    proof for the task. The storage of the generator is not a part of V.

    Parameters
    ----------
    approach : diagonal (n,), 1/s, > 0
        Approach rate: at the distance :math:`h` from its limit a joint's velocity towards it is at most this rate times
        :math:`h`.
    margin : diagonal (n,), rad, >= 0
        Distance from each limit at which the reference stops.
    rounding : diagonal (n,), rad/s, > 0
        Width of the smooth transition between bounds. A smaller width approximates the bounds more closely and requires
        more acceleration there.
    lower, upper : diagonal (n,), rad
        Position limits of the joints; by default those of the robot's URDF.
    speed : diagonal (n,), rad/s, > 0
        Velocity limits of the joints; by default those of the robot's URDF.

    Notes
    -----
    Not for: a generator with an observer or adaptive kinematics, whose proofs are coupled; limits of task space,
    torques or accelerations. The command itself is not limited: the compensation of disturbances by the servo's inverse
    is added to the reference. The bound holds in continuous time.

    References
    ----------
    [Ames2019]_ for barriers; [WangTAC2020]_ Theorem 4 for the dissipation of s.
    """

    uses_robot = True
    inputs = (Input("q", "n", "rad"), Input("dq_wish", "n", "rad/s"))
    outputs = (
        Output("dq_r", "n", "rad/s"),
        Output("outside", "n", "rad", notice="a joint is beyond the limits that are to be kept"),
        Output("overlap", "n", "rad", notice="the margins leave no room between the limits that are to be kept"),
    )

    approach: Diagonal = Positive("n", "1/s", default=3.0)
    margin: Diagonal = NonNegative("n", "rad", default=0.0)
    rounding: Diagonal = Positive("n", "rad/s", default=0.02)
    lower: Diagonal | None = Real("n", "rad", default=None)
    upper: Diagonal | None = Real("n", "rad", default=None)
    speed: Diagonal | None = Positive("n", "rad/s", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (5)."""
        q_min, q_max, v_max = self._limits(p)
        r_up = named("r_up", p.approach * (q_max - p.margin - u.q))
        r_low = named("r_low", p.approach * (u.q - q_min - p.margin))
        v_up = named("v_up", (v_max + r_up - p.rounding * root((v_max - r_up) / p.rounding)) / 2)
        v_low = named("v_low", (p.rounding * root((v_max - r_low) / p.rounding) - v_max - r_low) / 2)
        above, below = (p.rounding * root((u.dq_wish - end) / p.rounding) for end in (v_low, v_up))
        return Equations(
            outputs={
                "dq_r": (v_low + v_up + above - below) / 2,
                "outside": ca.fmax(ca.fmax(u.q - q_max, q_min - u.q), 0),
                "overlap": ca.fmax(2 * p.margin + q_min - q_max, 0),
            }
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage; the wish is not the reference that is tracked."""
        return Certificate(barriers=(self._barrier(u, p),), filters=("dq_wish",))

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """The admissible range between the limits is not empty."""
        q_min, q_max, _ = self._limits(p)
        text = "the margins leave room between the limits"
        return (Inequality(text, q_max - q_min - 2 * p.margin, "there is a pose to be in"),)

    def _barrier(self, u: Signals, p: Signals) -> Barrier:
        q_min, q_max, v_max = self._limits(p)
        return Barrier(u.q, u.dq_wish, q_min + p.margin, q_max - p.margin, v_max, p.approach, p.rounding, p.margin)

    def _limits(self, p: Signals) -> tuple[Any, Any, Any]:
        return (
            p.lower if "lower" in p else p.robot.lower_limits,
            p.upper if "upper" in p else p.robot.upper_limits,
            p.speed if "speed" in p else p.robot.velocity_limits,
        )


def root(x: Any) -> Any:
    """The square root of 1 + x^2."""
    return ca.sqrt(1 + x**2)
