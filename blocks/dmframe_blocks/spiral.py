"""A spiral on a ball, with the tool at right angles to it."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector, named
from dmframe_blocks._quaternions import quaternion, turned


@final
class Spiral(AbstractBlock):
    r"""The tool goes round on a ball, from its top outwards and back, and stands at right angles to it all the while.

    Leaning by an angle :math:`b` towards the direction at the angle a, it is at

    .. math::

        b &= \tfrac12 \mathrm{lean}\, (1 - \cos(\mathrm{breath}\, t)), \quad
                   a = \mathrm{rate}\, t + \mathrm{phase}                                           \tag{1} \\
        x_d &= c + r\, (\sin(b) \sin(a),\, \sin(b) \cos(a),\, \cos(b))   \tag{2}

    with :math:`c = \mathrm{center}` and :math:`r = \mathrm{radius}`. Its quaternion :math:`p_d` is that of the turn by
    :math:`b` about the horizontal axis at right angles to that direction, times that of the orientation on top.

    Parameters
    ----------
    center : (3,), m
        The middle of the ball.
    radius : scalar, m
        Of the ball.
    lean : scalar, rad
        How far from the top it goes, seen from the middle.
    rate : scalar, rad/s
        At which it goes round.
    breath : scalar, rad/s
        At which it goes out and back; a whole way takes 2 pi over it.
    phase : scalar, rad
        In which direction it sets out.
    orientation : (3,), rad
        Of the tool in the base's frame, on the top: a rotation vector, axis times angle.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("x_d", "3", "m"), Output("p_d", "4"))

    center: Vector = Real("3", "m", spread=False)
    radius: Scalar = Real("", "m")
    lean: Scalar = Real("", "rad")
    rate: Scalar = Real("", "rad/s")
    breath: Scalar = Real("", "rad/s")
    phase: Scalar = Real("", "rad", default=0.0)
    orientation: Vector = Real("3", "rad", spread=False)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        b = named("b", p.lean * (1 - ca.cos(p.breath * u.t)) / 2)
        a = named("a", p.rate * u.t + p.phase)
        towards = ca.vertcat(ca.sin(b) * ca.sin(a), ca.sin(b) * ca.cos(a), ca.cos(b))
        leaning = ca.vertcat(ca.cos(b / 2), -ca.sin(b / 2) * ca.cos(a), ca.sin(b / 2) * ca.sin(a), 0)
        return Equations(
            outputs={"x_d": p.center + p.radius * towards, "p_d": turned(leaning, quaternion(p.orientation))}
        )
