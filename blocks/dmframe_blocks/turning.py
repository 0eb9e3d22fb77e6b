"""Rotation of the tool about a fixed axis."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector, named
from dmframe_blocks._directions import check_direction
from dmframe_blocks._quaternions import about, quaternion, turned


@final
class Turning(AbstractBlock):
    r"""Desired orientation that rotates about an axis fixed in space, with an oscillation, a constant rate, or both.

    The angle is

    .. math::

        a = \mathrm{spin}\, t + \mathrm{amplitude} \sin(\mathrm{rate}\, t + \mathrm{phase})   \tag{1}

    and the quaternion :math:`p_d` is that of the rotation by a, times that of the initial orientation.

    Parameters
    ----------
    orientation : (3,), rad
        Orientation of the tool in the base frame for the angle 0, as a rotation vector: axis times angle.
    axis : (3,)
        Axis in the base frame, of any length but zero.
    amplitude : scalar, rad
        Amplitude of the oscillation.
    rate : scalar, rad/s
        Angular frequency of the oscillation.
    phase : scalar, rad
        Initial phase of the oscillation.
    spin : scalar, rad/s
        Constant angular rate in addition to the oscillation.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("p_d", "4"),)

    orientation: Vector = Real("3", "rad", spread=False)
    axis: Vector = Real("3", spread=False)
    amplitude: Scalar = Real("", "rad", default=0.0)
    rate: Scalar = Real("", "rad/s", default=0.0)
    phase: Scalar = Real("", "rad", default=0.0)
    spin: Scalar = Real("", "rad/s", default=0.0)

    @model_validator(mode="after")
    def _an_axis(self) -> Turning:
        check_direction("axis", self.axis)
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        a: Any = named("a", p.spin * u.t + p.amplitude * ca.sin(p.rate * u.t + p.phase))
        return Equations(outputs={"p_d": turned(about(p.axis, a), quaternion(p.orientation))})
