"""A constant goal."""

from __future__ import annotations

from typing import Final, final

from pydantic import model_validator

from dmframe.block import AbstractBlock, Equations, Output, Real, Side, Signals, Vector
from dmframe.common.errors import listed
from dmframe_blocks._quaternions import quaternion

GOALS: Final = ("x_d", "q_d", "chi_d")


@final
class Setpoint(AbstractBlock):
    """Constant goal of the tool, of the joints, or in a camera image; for the tool optionally with an orientation.

    Parameters
    ----------
    x_d : (m,), m
        Goal of the tool. Set one of `x_d`, `q_d` and `chi_d`.
    q_d : (n,), rad
        Goal of the joints.
    orientation : (3,), rad
        Orientation of the tool in the base frame as a rotation vector, axis times angle; none by default.
    chi_d : (2,)
        Goal of the tool in the image of a `camera`.

    Notes
    -----
    Not for: a step during motion, at which the reference would be discontinuous.
    """

    side = Side.SOURCE
    outputs = (
        Output("x_d", "m", "m", optional=True),
        Output("q_d", "n", "rad", optional=True),
        Output("p_d", "4", optional=True),
        Output("chi_d", "2", optional=True),
    )

    x_d: Vector | None = Real("m", "m", default=None, spread=False)
    q_d: Vector | None = Real("n", "rad", default=None, spread=False)
    orientation: Vector | None = Real("3", "rad", default=None, spread=False)
    chi_d: Vector | None = Real("2", default=None, spread=False)

    @model_validator(mode="after")
    def _one_goal(self) -> Setpoint:
        given = [name for name in GOALS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"expected one of x_d, q_d and chi_d, found {listed(given) or 'none'}")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The configured goal."""
        outputs = {name: getattr(p, name) for name in GOALS if name in p}
        return Equations(outputs=outputs | ({"p_d": quaternion(p.orientation)} if "orientation" in p else {}))
