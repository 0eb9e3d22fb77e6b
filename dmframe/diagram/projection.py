r"""Convex sets onto which estimates are projected: boxes, balls, and sets of physically consistent parameters.

The rate of a projected state is its `nominal` rate plus a `correction`: a free symbol in a proof, and the value of
`law` in a run. Projection lemma: with :math:`S = \tfrac12 |\theta - \theta_{true}|_W^2` the correction adds
:math:`(\theta - \theta_{true})^\top W c \le 0` to dS/dt if the set is convex and contains the true value, and if c is
normal to the set in the metric W. After each finite step of a run, `held` projects the state onto the set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.linalg import square, times
from dmframe.diagram.bodies import Bodies


@final
@dataclass(frozen=True)
class Box:
    """Lower and upper bounds, element by element; its normals are the coordinate axes, in any diagonal metric."""

    kind: ClassVar[str] = "box"
    bounds: ClassVar[bool] = True

    lower: SX
    upper: SX

    @property
    def ends(self) -> tuple[SX, ...]:
        """Expressions that define the set."""
        return self.lower, self.upper

    def law(self, state: SX, nominal: SX) -> SX:
        """Correction at the boundary that cancels a rate out of the box."""
        out = ca.logic_or(
            ca.logic_and(state <= self.lower, nominal < 0), ca.logic_and(state >= self.upper, nominal > 0)
        )
        return ca.if_else(out, -nominal, 0)

    def held(self, state: SX) -> SX:
        """The nearest point of the box."""
        return ca.fmin(ca.fmax(state, self.lower), self.upper)

    def room(self, truth: SX) -> SX:
        """Expressions that are nonnegative if and only if the point is in the box."""
        return ca.vertcat(truth - self.lower, self.upper - truth)

    def askew(self, weight: SX) -> SX:
        """Zero if the correction is normal to the box in the metric of the weight: if the weight is diagonal."""
        if weight.is_column():
            return ca.SX.zeros(1)
        return ca.vec(ca.densify(weight - ca.diag(ca.diag(weight))))


@final
@dataclass(frozen=True)
class Ball:
    r"""The ellipsoid :math:`f = \sum_i (\theta_i - c_i)^2 / r_i^2 - 1 \le 0`; a ball if all half axes are equal.

    `gain` is the adaptation's :math:`\Gamma`, a matrix or its diagonal. The normal in the metric
    :math:`\Gamma^{-1}` is :math:`\Gamma \nabla f`: with :math:`c = -\mu \Gamma \nabla f`, :math:`\mu \ge 0`,
    :math:`(\theta - \theta_{true})^\top \Gamma^{-1} c = -\mu (\theta - \theta_{true})^\top \nabla f`. This is
    :math:`\le 0` on the boundary, since f is convex and :math:`f \le 0` at the true value.
    """

    kind: ClassVar[str] = "ball"
    bounds: ClassVar[bool] = True

    center: SX
    radius: SX
    gain: SX

    @property
    def ends(self) -> tuple[SX, ...]:
        """Expressions that define the set."""
        return self.center, self.radius, self.gain

    def law(self, state: SX, nominal: SX) -> SX:
        r"""Correction at the boundary that cancels the outward component of the nominal rate v.

        .. math:: c = -\Gamma \nabla f\, \frac{\max(0, \nabla f^\top v)}{\nabla f^\top \Gamma \nabla f}
        """
        gradient = (state - self.center) / (self.radius * self.radius)
        outward = ca.dot(gradient, nominal)
        out = ca.logic_and(self._reach(state) >= 1, outward > 0)
        normal = times(self.gain, gradient)
        steepness = ca.dot(gradient, normal)
        return ca.if_else(out, -normal * (outward / steepness), ca.SX.zeros(state.shape[0]))

    def held(self, state: SX) -> SX:
        """The point of the set on the line to its centre; for a ball, the nearest point."""
        away = state - self.center
        return self.center + away / ca.sqrt(ca.fmax(self._reach(state), 1))

    def room(self, truth: SX) -> SX:
        """An expression that is nonnegative if and only if the point is in the set."""
        return 1 - self._reach(truth)

    def askew(self, weight: SX) -> SX:
        """Zero if the weight is a multiple of the inverse gain, in whose metric the correction is normal."""
        if weight.is_column() and self.gain.is_column():
            ratio = weight * self.gain
            return ratio - ratio[0]
        product = (ca.diag(weight) if weight.is_column() else weight) @ square(self.gain)
        return ca.vec(ca.densify(product - product[0, 0] * ca.SX.eye(product.shape[0])))

    def _reach(self, point: SX) -> SX:
        away = (point - self.center) / self.radius
        return ca.dot(away, away)


@final
@dataclass(frozen=True)
class Projection:
    """A projected state: its rate is `nominal` plus a correction that is zero inside the set.

    `name` and `parameter` are the labels of the state and of the parameter that defines its set.
    """

    name: str
    parameter: str
    state: SX
    nominal: SX
    correction: SX
    set: Box | Ball | Bodies

    @property
    def block(self) -> str:
        """The name of the state's block."""
        return self.name.partition(".")[0]

    @property
    def of(self) -> str:
        """The state's name in its block."""
        return self.name.partition(".")[2]

    @property
    def kind(self) -> str:
        """``box``, ``ball`` or ``set of bodies``."""
        return self.set.kind

    @property
    def law(self) -> SX:
        """The correction in a run."""
        return self.set.law(self.state, self.nominal)


__all__ = ["Ball", "Bodies", "Box", "Projection"]
