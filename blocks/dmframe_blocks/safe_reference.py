"""A reference velocity that leads no joint beyond its limits."""

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
    r"""Holds a reference velocity between what the joints' limits of position and velocity leave.

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

    and with limits that a graph gives

    .. math::

        r_{up}  &= \mathrm{approach} (\mathrm{upper} - \mathrm{margin} - q), \quad
        r_{low} = \mathrm{approach} (q - \mathrm{lower} - \mathrm{margin})   \tag{5}

    (2) is smooth, and never above :math:`r_{up}` and :math:`v_{max}`; (3) likewise below. (4) lies between both,
    whatever is wished, and is the wish where that is well between them. The limits :math:`q_{min}`, :math:`q_{max}` and
    :math:`v_{max}` are those of the robot's URDF, unless `lower`, `upper` and `speed` say others.

    The servo level of the proof falls for any reference velocity whose derivative the controller knows: so it is the
    reference that is limited, never the command. A joint's room shrinks no faster than approach times itself and the
    error s of following the reference, on which V has no more than V(0) to spend: `verify` says by how much each joint
    may pass the limits that the reference keeps, from where the loop starts and from the intervals of `uncertain`. A
    `margin` of so much keeps the true limits.

    The limits go before the path: while one is active the tool waits or leaves its path, and nothing is proved of the
    task. What the generator stores is no part of V.

    Parameters
    ----------
    approach : diagonal (n,), 1/s, > 0
        How fast a joint may use up its room: at the distance h from its limit no faster than approach times h.
    margin : diagonal (n,), rad, >= 0
        By how much the reference stops before each limit.
    rounding : diagonal (n,), rad/s, > 0
        Of the rounding where one bound takes over from another. Smaller is nearer to the sharp bounds, and asks for
        more acceleration there.
    lower, upper : diagonal (n,), rad
        Limits of the joints; without them, those of the robot's URDF.
    speed : diagonal (n,), rad/s, > 0
        Limits of the velocities; likewise.

    Notes
    -----
    Not for: a generator over an observer or adaptive kinematics, whose proof is one with theirs; limits of the task
    space, torques or accelerations. The command is not limited: a disturbance that the
    servo's inverse compensates comes on top of the reference. The tube is one of continuous time.

    References
    ----------
    [Ames2019]_ for barriers; [WangTAC2020]_ Theorem 4 for what is spent on s.
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
        """Nothing is stored; what is wished is not what is followed."""
        return Certificate(barriers=(self._barrier(u, p),), filters=("dq_wish",))

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """There is room between the limits."""
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
    """The root of 1 + x^2."""
    return ca.sqrt(1 + x**2)
