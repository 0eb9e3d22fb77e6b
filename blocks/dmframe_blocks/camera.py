"""A fixed camera that sees the tool."""

from __future__ import annotations

from typing import final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    AbstractBlock,
    Access,
    Certificate,
    Equations,
    Input,
    Output,
    Positive,
    Real,
    Scalar,
    Side,
    Signals,
    Vector,
    named,
)
from dmframe_blocks._directions import check_space


@final
class Camera(AbstractBlock):
    r"""A pinhole that stands still: where in its image the tool is, and how far in front of it.

    .. math::

        \mathrm{depth} &= \mathrm{ahead}^\top (x - \mathrm{position})                                       \tag{1} \\
        \chi &= \frac{1}{\mathrm{depth}} N (x - \mathrm{position}), \quad
                N = \begin{bmatrix} \mathrm{right}^\top \\ \mathrm{down}^\top \end{bmatrix}    \tag{2}

    The image is measured, the depth is not. As the tool moves, the depth times the velocity of the image is
    :math:`(N - \chi\, \mathrm{ahead}^\top)` times that of the tool: linear in the nine numbers
    a_c = (right, down, ahead).

    Image coordinates are slopes: pixels from any fixed pixel, divided by any fixed number of pixels. With the focal
    length in pixels as that number, `right` and `down` are unit vectors; as nobody needs to know it, a number near to
    it does as well, and they are then a little longer or shorter. They need not be at right angles: skew pixels, and
    pixels that are no squares, are in them.

    Parameters
    ----------
    position : (3,), m
        Of the pinhole, in the base's frame.
    right, down, ahead : (3,)
        Along the rows and columns of the image, and into the scene, in the base's frame; not in one plane. `ahead` of
        length 1 makes the depth one in metres.
    depth_min : scalar, m, > 0
        A run tells where the tool comes nearer than this, or behind the camera.

    Notes
    -----
    Not for: a lens that bends straight lines, a camera on the robot. That the tool stays in sight is not looked at.

    References
    ----------
    [Liu2006]_; [HartleyZisserman2004]_ chapter 6.
    """

    side = Side.PLANT
    inputs = (Input("x", "3", "m"),)
    outputs = (
        Output("chi", "2", "", Access.MEASURED),
        Output("depth", "", "m"),
        Output("a_c", "9"),
        Output("lacking", "", "m", notice="the tool is nearer to the camera than depth_min"),
    )

    position: Vector = Real("3", "m", spread=False)
    right: Vector = Real("3", spread=False)
    down: Vector = Real("3", spread=False)
    ahead: Vector = Real("3", spread=False)
    depth_min: Scalar = Positive("", "m", default=0.1)

    @model_validator(mode="after")
    def _sees_a_plane(self) -> Camera:
        check_space(right=self.right, down=self.down, ahead=self.ahead)
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        r = u.x - p.position
        depth, N = ca.dot(p.ahead, r), named("N", ca.vertcat(p.right.T, p.down.T))
        return Equations(
            outputs={
                "chi": N @ r / depth,
                "depth": depth,
                "a_c": ca.vertcat(p.right, p.down, p.ahead),
                "lacking": ca.fmax(p.depth_min - depth, 0),
            }
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate()
