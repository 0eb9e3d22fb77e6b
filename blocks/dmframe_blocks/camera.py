"""A fixed camera that observes the tool."""

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
    r"""Pinhole camera, fixed in the base frame: image coordinates and depth of the tool.

    .. math::

        \mathrm{depth} &= \mathrm{ahead}^\top (x - \mathrm{position})                                       \tag{1} \\
        \chi &= \frac{1}{\mathrm{depth}} N (x - \mathrm{position}), \quad
                N = \begin{bmatrix} \mathrm{right}^\top \\ \mathrm{down}^\top \end{bmatrix}    \tag{2}

    The image is measured, the depth is not. The depth times the image velocity is
    :math:`(N - \chi\, \mathrm{ahead}^\top)` times the velocity of the tool: linear in the nine parameters
    a_c = (right, down, ahead).

    Image coordinates are dimensionless: pixels from any fixed pixel, divided by any fixed number of pixels. If that
    number is the focal length in pixels, `right` and `down` are unit vectors. The focal length need not be known: with
    an approximate number the vectors are slightly longer or shorter. They need not be orthogonal, so they also
    represent skewed and non-square pixels.

    Parameters
    ----------
    position : (3,), m
        Position of the pinhole in the base frame.
    right, down, ahead : (3,)
        Directions of the image rows, of the image columns, and into the scene, in the base frame; not coplanar. With
        `ahead` of length 1 the depth is in metres.
    depth_min : scalar, m, > 0
        A run reports if the tool comes nearer than this, or behind the camera.

    Notes
    -----
    Not for: lens distortion, a camera on the robot. The field of view is not modelled.

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
        """No storage."""
        return Certificate()
