r"""The set of estimates whose links are bodies, and the nearest of them.

A link's ten parameters a make up its pseudo-inertia P(a), which is linear in them. With the nominal body's,
:math:`P_0 = L L^\top`, and a share s, the set is that of all a with :math:`P \ge s P_0`. In
:math:`Z = L^{-1} P L^{-\top} - s` it is :math:`Z \ge 0`, and the metric :math:`\mathrm{tr}(P_0^{-1} X P_0^{-1} Y)` of
what P changes by is Frobenius's. So the nearest body has a closed form: Z with its negative eigenvalues at zero.

A rate is stopped already where an eigenvalue of Z is `RIM`, a billionth of the nominal body. So the lemma speaks of the
set :math:`Z \ge` `RIM`, in which the true bodies have to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import casadi as ca

from dmframe.certificate import SX
from dmframe.eigen import eigen, positive_part
from dmframe.linalg import ldl, solve_spd
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import dual, parameters_of, pseudo_inertia

TEN = len(INERTIAL)
RIM = 2.0**-30
"""How thick the rim is, in nominal bodies: rounding in what was put onto it must not decide what may move there."""


@final
@dataclass(frozen=True)
class _Link:
    """One link's body: from parameters to Z, and back."""

    nominal: SX
    share: SX

    @property
    def root(self) -> SX:
        """L, lower triangular."""
        factor, pivots = ldl(matrix(self.nominal))
        return factor @ ca.diag(ca.sqrt(ca.vertcat(*pivots)))

    def seen(self, a: SX) -> SX:
        """What parameters, or their rates, change Z by."""
        half = ca.solve(self.root, matrix(a))
        return ca.solve(self.root, half.T)

    def at(self, a: SX) -> SX:
        """Z."""
        return self.seen(a) - self.share * ca.SX.eye(4)

    def parameters(self, X: SX) -> SX:
        """What of the parameters changes Z by X."""
        return row(self.root @ X @ self.root.T)


@final
@dataclass(frozen=True)
class Bodies:
    r"""Estimates of which each link's pseudo-inertia is at least a share of its nominal body's.

    Parameters
    ----------
    nominal : (10 links,)
        The nominal bodies' parameters. The estimates begin with those of as many links.
    share : scalar, > 0
        s: no eigenvalue of :math:`P_0^{-1} \hat P` is below.
    """

    kind: ClassVar[str] = "set of bodies"
    bounds: ClassVar[bool] = False
    """A cone has no end: that what is in it stays bounded has to be V's merit."""

    nominal: SX
    share: SX

    @property
    def ends(self) -> tuple[SX, ...]:
        """What says where it is."""
        return self.nominal, self.share

    def law(self, state: SX, nominal: SX) -> SX:
        r"""On the rim, takes away what of the nominal rate leads out: the nearest rate that does not is left.

        With N the eigenvectors of Z there, a rate D leads out unless :math:`N^\top D N \ge 0`. So
        :math:`c = N\, (-N^\top D N)_+ N^\top`.
        """
        found = []
        for link, a, rate in zip(self._links(), _split(state, self._size), _split(nominal, self._size), strict=True):
            values, V = eigen(link.at(a))
            out = ca.if_else(values <= RIM, 1, 0)
            across = (out @ out.T) * (V.T @ link.seen(rate) @ V)
            found.append(link.parameters(V @ positive_part(-across) @ V.T))
        return self._whole(found, state)

    def held(self, state: SX) -> SX:
        """The nearest estimates with bodies in the set, in the metric of their nominal ones; inside, the same."""
        pairs = zip(self._links(), _split(state, self._size), strict=True)
        return state + self._whole([link.parameters(positive_part(-link.at(a))) for link, a in pairs], state)

    def room(self, truth: SX) -> SX:
        """Not negative where a point lies in the set.

        Of each link, the sums of products of one, two, three and all eigenvalues of :math:`P_0^{-1} P - s`, by Newton's
        identities, times 1, 2, 6 and 24: these are real, and none is negative iff no sum is. So it takes no root.
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
        """Zero where the weight is, of each link, a multiple of the nominal body's metric, and couples it with nothing.

        That is where the weight times the metric's inverse is one number.
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

    def _whole(self, links: Sequence[SX], state: SX) -> SX:
        """A column of all estimates: zero of what belongs to no link."""
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
    r"""The inverse of the metric :math:`\mathrm{tr}(P^{-1} X P^{-1} X)` at a body: it takes g to the row of P Q P."""
    P = matrix(a)
    units = ([float(i == j) for i in range(TEN)] for j in range(TEN))
    return ca.horzcat(*(row(P @ ca.DM(dual(unit)) @ P) for unit in units))


__all__ = ["Bodies", "gain", "matrix", "row"]
