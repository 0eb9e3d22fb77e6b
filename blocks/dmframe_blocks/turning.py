"""An orientation that turns about a fixed axis."""

from __future__ import annotations

from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import TIME, AbstractBlock, Equations, Output, Real, Scalar, Side, Signals, Vector, named
from dmframe_blocks._directions import check_direction
from dmframe_blocks._quaternions import about, quaternion, turned


@final
class Turning(AbstractBlock):
    r"""The tool turns about an axis that is fixed in space, to and fro, round and round, or both.

    Its angle is

    .. math::

        a = \mathrm{spin}\, t + \mathrm{amplitude} \sin(\mathrm{rate}\, t + \mathrm{phase})   \tag{1}

    and its quaternion :math:`p_d` that of the turn by a, times that of the orientation from which it turns.

    Parameters
    ----------
    orientation : (3,), rad
        Of the tool in the base's frame where the angle is 0, a rotation vector: axis times angle.
    axis : (3,)
        The axis, in the base's frame; of any length but zero.
    amplitude : scalar, rad
        How far it swings to either side.
    rate : scalar, rad/s
        Angular frequency of the swing.
    phase : scalar, rad
        Where in the swing it begins.
    spin : scalar, rad/s
        At which it goes round beside the swing.
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
