"""Spiral path on a sphere, with the tool perpendicular to the surface."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector, named
from dmframe_blocks._quaternions import quaternion, turned


@final
class Spiral(AbstractBlock):
    r"""Spiral tool path on a sphere, from its top outwards and back, with the tool perpendicular to the surface.

    With the inclination :math:`b` towards the direction at the angle a, the path is

    .. math::

        b &= \tfrac12 \mathrm{lean}\, (1 - \cos(\mathrm{breath}\, t)), \quad
                   a = \mathrm{rate}\, t + \mathrm{phase}                                           \tag{1} \\
        x_d &= c + r\, (\sin(b) \sin(a),\, \sin(b) \cos(a),\, \cos(b))   \tag{2}

    with :math:`c = \mathrm{center}` and :math:`r = \mathrm{radius}`. The quaternion :math:`p_d` is that of the rotation
    by :math:`b` about the horizontal axis perpendicular to that direction, times that of the orientation on top.

    Parameters
    ----------
    center : (3,), m
        Centre of the sphere.
    radius : scalar, m
        Radius of the sphere.
    lean : scalar, rad
        Largest inclination from the top, seen from the centre.
    rate : scalar, rad/s
        Angular rate around the vertical axis.
    breath : scalar, rad/s
        Angular frequency of the motion out and back; one cycle takes :math:`2 \pi` divided by it.
    phase : scalar, rad
        Initial direction.
    orientation : (3,), rad
        Orientation of the tool in the base frame at the top, as a rotation vector: axis times angle.
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
