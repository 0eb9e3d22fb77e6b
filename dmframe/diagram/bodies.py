r"""The convex set of physically consistent estimates of inertial parameters, and the projection onto it.

The pseudo-inertia P(a) of a link is linear in its ten parameters a. With that of the nominal body,
:math:`P_0 = L L^\top`, and a fraction s, the set is :math:`P \ge s P_0`. In
:math:`Z = L^{-1} P L^{-\top} - s` it is :math:`Z \ge 0`, and the metric :math:`\mathrm{tr}(P_0^{-1} X P_0^{-1} Y)` of
changes of P is that of the Frobenius norm. The projection therefore has a closed form: the negative eigenvalues of Z
are set to zero.

A rate is stopped where an eigenvalue of Z is `RIM`, a billionth of the nominal body. The projection lemma therefore
holds for the set :math:`Z \ge` `RIM`, which has to contain the true parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.linalg import ldl, solve_spd
from dmframe.common.eigen import eigen, positive_part
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import dual, parameters_of, pseudo_inertia

TEN = len(INERTIAL)
RIM = 2.0**-30
"""Thickness of the boundary layer in nominal bodies, so that rounding does not decide whether a point is on it."""


@final
@dataclass(frozen=True)
class _Link:
    """Conversion of one link's parameters to Z and back."""

    nominal: SX
    share: SX

    @property
    def root(self) -> SX:
        """L, lower triangular."""
        factor, pivots = ldl(matrix(self.nominal))
        return factor @ ca.diag(ca.sqrt(ca.vertcat(*pivots)))

    def transformed(self, a: SX) -> SX:
        """Change of Z due to a change of the parameters, or its rate."""
        half = ca.solve(self.root, matrix(a))
        return ca.solve(self.root, half.T)

    def at(self, a: SX) -> SX:
        """Z."""
        return self.transformed(a) - self.share * ca.SX.eye(4)

    def parameters(self, X: SX) -> SX:
        """Change of the parameters that changes Z by X."""
        return row(self.root @ X @ self.root.T)


@final
@dataclass(frozen=True)
class Bodies:
    r"""Estimates for which the pseudo-inertia of each link is at least a fraction of the nominal one.

    Parameters
    ----------
    nominal : (10 links,)
        The nominal parameters of the links. The estimates begin with those of as many links.
    share : scalar, > 0
        s, the lower bound of the eigenvalues of :math:`P_0^{-1} \hat P`.
    """

    kind: ClassVar[str] = "set of bodies"
    bounds: ClassVar[bool] = False
    """False: a cone is unbounded, so the estimates in it have to be bounded by V."""

    nominal: SX
    share: SX

    @property
    def ends(self) -> tuple[SX, ...]:
        """The expressions that define the set."""
        return self.nominal, self.share

    def law(self, state: SX, nominal: SX) -> SX:
        r"""On the boundary, the correction that leaves the nearest rate that does not leave the set.

        With N the eigenvectors of Z for its boundary eigenvalues, a rate D leaves the set unless
        :math:`N^\top D N \ge 0`. The correction is :math:`c = N\, (-N^\top D N)_+ N^\top`.
        """
        found = []
        for link, a, rate in zip(self._links(), _split(state, self._size), _split(nominal, self._size), strict=True):
            values, V = eigen(link.at(a))
            out = ca.if_else(values <= RIM, 1, 0)
            across = (out @ out.T) * (V.T @ link.transformed(rate) @ V)
            found.append(link.parameters(V @ positive_part(-across) @ V.T))
        return self._all_estimates(found, state)

    def held(self, state: SX) -> SX:
        """Projection onto the set in the metric of the nominal parameters."""
        pairs = zip(self._links(), _split(state, self._size), strict=True)
        return state + self._all_estimates([link.parameters(positive_part(-link.at(a))) for link, a in pairs], state)

    def room(self, truth: SX) -> SX:
        """Expressions that are non-negative if and only if the point is in the set.

        For each link they are the elementary symmetric polynomials of the eigenvalues of :math:`P_0^{-1} P - s`, by
        Newton's identities, times 1, 2, 6 and 24. The eigenvalues are real, and none is negative if and only if no
        polynomial is. No eigenvalue has to be computed.
        """
        found = list[SX]()
        for link, a in zip(self._links(), _split(truth, self._size), strict=True):
            X = solve_spd(matrix(link.nominal), matrix(a)) - (link.share + RIM) * ca.SX.eye(4)
            X2 = X @ X
            t, t2, t3, t4 = ca.trace(X), ca.trace(X2), ca.trace(X2 @ X), ca.trace(X2 @ X2)
            found += [t, t * t - t2, t * t * t - 3 * t * t2 + 2 * t3]
            found.append(t * t * t * t - 6 * t * t * t2 + 3 * t2 * t2 + 8 * t * t3 - 6 * t4)
        return ca.vertcat(*found)

    def askew(self, weight: SX) -> SX:
        """Zero if the weight of each link is a multiple of the metric of the nominal body, without coupling terms.

        This is the case if the weight times the inverse of the metric is a scalar.
        """
        W, found = ca.diag(weight) if weight.is_column() else weight, list[SX]()
        for k, link in enumerate(self._links()):
            own = slice(TEN * k, TEN * (k + 1))
            product = W[own, own] @ gain(link.nominal)
            found.append(ca.vec(product - product[0, 0] * ca.SX.eye(TEN)))
            found += [ca.vec(W[own, : TEN * k]), ca.vec(W[own, TEN * (k + 1) :])]
        return ca.densify(ca.vertcat(*found))

    @property
    def _size(self) -> int:
        return int(self.nominal.numel())

    def _links(self) -> Iterator[_Link]:
        return (_Link(nominal, self.share) for nominal in _split(self.nominal, self._size))

    def _all_estimates(self, links: Sequence[SX], state: SX) -> SX:
        """A column of all estimates, with zeros for those that belong to no link."""
        return ca.densify(ca.vertcat(*links, ca.SX.zeros(state.numel() - self._size)))


def _split(column: SX, size: int) -> list[SX]:
    return list(ca.vertsplit(column[:size], TEN))


def matrix(a: Any) -> SX:
    """The pseudo-inertia of ten parameters."""
    return ca.blockcat(pseudo_inertia(ca.vertsplit(ca.SX(a))))


def row(P: Any) -> SX:
    """The ten parameters of a pseudo-inertia."""
    return ca.vertcat(*parameters_of([[P[i, j] for j in range(4)] for i in range(4)]))


def gain(a: Any) -> SX:
    r"""The inverse of the metric :math:`\mathrm{tr}(P^{-1} X P^{-1} X)` at a body: it maps g to the row of P Q P."""
    P = matrix(a)
    units = ([float(i == j) for i in range(TEN)] for j in range(TEN))
    return ca.horzcat(*(row(P @ ca.DM(dual(unit)) @ P) for unit in units))


__all__ = ["Bodies", "gain", "matrix", "row"]
