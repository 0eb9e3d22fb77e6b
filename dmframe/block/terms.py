"""Terms of V and dV/dt: squares, and other terms that are non-negative or bounded by construction.

Each term is built from its vectors and weights, so that a block cannot declare a term nonnegative that is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, final

import casadi as ca

from dmframe.block.condition import SX
from dmframe.block.fields import Expressions
from dmframe.block.linalg import ldl, solve_spd
from dmframe.block.naming import operation
from dmframe.common.text import UNNAMED, Text


@final
@dataclass(frozen=True, eq=False)
class Square(Expressions):
    r"""The quadratic form :math:`|a|_W^2 = a^\top W a`.

    Parameters
    ----------
    vector
        a, a column.
    weight
        W: a matrix, or a column or scalar for a diagonal matrix.
    of
        Printed name of a; the framework derives it from the expression, and blocks do not set it.
    positive
        Of a weight that contains signals: the reason why it stays above a positive constant along the motion. The graph
        cannot show this, so it is an assumption with this text. Factors of the weight made of parameters are
        checked.
    """

    vector: SX
    weight: SX = 1
    of: Text = UNNAMED
    positive: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.vector, str):
            raise TypeError(
                f"Square({self.vector!r}, ...): expected the vector and its weight; the name of a term is printed "
                "from its expression"
            )
        super().__post_init__()

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        if isinstance(self.weight, int | float) or self.weight.is_column():
            return ca.dot(self.vector, self.weight * self.vector)
        return ca.dot(self.vector, self.weight @ self.vector)


TINY = 2.0**-100
"""Lower bound of the radicand of a norm, so that its derivative at zero exists and is zero."""


@operation
def norm(vector: SX) -> SX:
    """The Euclidean norm of a column."""
    return ca.sqrt(ca.fmax(ca.sumsqr(vector), TINY))


@operation
def clip(vector: SX, width: SX) -> SX:
    """Each element limited to [-width, width]."""
    return width * ca.fmin(ca.fmax(vector / width, -1), 1)


@operation
def beyond(vector: SX, width: SX) -> SX:
    """Dead zone of each element: the part beyond -width or width, and zero in between."""
    return width * _beyond(vector / width)


def _beyond(x: SX) -> SX:
    return x - ca.fmin(ca.fmax(x, -1), 1)


MONOTONE: Final[Mapping[str, Callable[[SX], SX]]] = MappingProxyType(
    {"tanh": ca.tanh, "sign": ca.sign, "atan": ca.atan, "beyond": _beyond}
)
"""Non-decreasing functions by the name that a `Lemma` uses; `beyond` has the width 1."""


@final
@dataclass(frozen=True, eq=False)
class Lemma(Expressions):
    r"""A term that is non-negative because :math:`\phi` is non-decreasing.

    .. math:: \sum_i w_i (a_i - b_i) (\phi(a_i / v_i) - \phi(b_i / v_i)), \quad w_i \ge 0, \; v_i > 0

    Parameters
    ----------
    weight
        w, a column or a scalar of parameters.
    first, second
        a and b, columns.
    scale
        v, a column or a scalar of parameters.
    phi
        A name of `MONOTONE`.
    """

    weight: SX
    first: SX
    second: SX
    scale: SX
    phi: str = "tanh"
    of: Text = UNNAMED

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        phi = MONOTONE[self.phi]
        slip = phi(self.first / self.scale) - phi(self.second / self.scale)
        return ca.sum1(self.weight * (self.first - self.second) * slip)


@final
@dataclass(frozen=True, eq=False)
class NormSquare(Expressions):
    r"""The form :math:`|b|\,|a|_W^2`: a square whose weight grows with the norm of a signal.

    Parameters
    ----------
    vector, weight, of
        As of a `Square`.
    by
        b, a column of signals.
    by_of
        Printed name of b, made from the expression.
    """

    vector: SX
    weight: SX
    by: SX
    of: Text = UNNAMED
    by_of: Text = UNNAMED

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        return norm(self.by) * self.square.value

    @property
    def square(self) -> Square:
        """The form without the norm."""
        return Square(self.vector, self.weight, self.of)


@final
@dataclass(frozen=True, eq=False)
class InformationSquare(Expressions):
    r"""The form :math:`c\,|a|_G^2` with an information matrix G with forgetting.

    .. math:: \dot G = -\mathrm{forgetting}\, G + W^\top \mathrm{diag}(r) W, \quad G(0) = 0 \quad\Rightarrow\quad
        G(t) = \int_0^t e^{-\mathrm{forgetting} (t - s)} W^\top \mathrm{diag}(r) W\, ds \ge 0

    so it is never negative although its weight is a state. The exact test includes this equation of G.

    Parameters
    ----------
    vector
        a, a column.
    weight
        c, a scalar of parameters.
    memory
        G, symmetric: a state, or an expression of one.
    regressor
        W.
    by
        r, a column of parameters.
    forgetting
        A scalar of parameters.
    """

    vector: SX
    weight: SX
    memory: SX
    regressor: SX
    by: SX
    forgetting: SX
    of: Text = UNNAMED

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        return self.weight * ca.dot(self.vector, self.memory @ self.vector)

    @property
    def rate(self) -> SX:
        """The required dG/dt."""
        return gathered(self.memory, self.regressor, self.by, self.forgetting)


def gathered(memory: SX, regressor: SX, by: SX, forgetting: SX) -> SX:
    """-forgetting G + W' diag(r) W."""
    return regressor.T @ ca.diag(by) @ regressor - forgetting * memory


@final
@dataclass(frozen=True, eq=False)
class Clipped(Expressions):
    r"""The term :math:`\sum_i \mathrm{clip}(s_i, v_i) b_i`, of either sign and at most :math:`\sum_i v_i |b_i|`.

    Parameters
    ----------
    first, width, other
        s, v and b: columns, the width of parameters above zero.
    """

    first: SX
    width: SX
    other: SX
    of: Text = UNNAMED

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return ca.dot(clip(self.first, self.width), self.other)


@operation
def soft_clip(vector: SX, width: SX) -> SX:
    """Smooth saturation of each element; its magnitude stays below width."""
    return vector / ca.sqrt(1 + (vector / width) ** 2)


@operation
def potential(vector: SX, width: SX, weight: SX) -> SX:
    """Twice the energy of springs with the force weight * soft_clip(vector, width)."""
    # the form without a difference, 2 a^2 / (1 + root), would require the rule that root^2 equals its radicand
    return ca.sum1(2 * weight * width**2 * (ca.sqrt(1 + (vector / width) ** 2) - 1))


@operation
def divergence(estimate: SX, true: SX) -> SX:
    """Stein's loss: log(det(estimate)/det(true)) + trace(estimate^-1 true) - n."""
    estimate, true = ca.tril2symm(ca.tril(estimate)), ca.tril2symm(ca.tril(true))
    logarithms = [ca.log(ca.vertcat(*ldl(matrix)[1])) for matrix in (estimate, true)]
    return ca.sum1(logarithms[0] - logarithms[1]) + ca.trace(solve_spd(estimate, true)) - true.shape[0]


@final
@dataclass(frozen=True, eq=False)
class Potential(Expressions):
    r"""The energy of saturating springs: positive definite and radially unbounded in a.

    .. math:: \sum_i 2 w_i v_i^2 \left(\sqrt{1 + (a_i / v_i)^2} - 1\right), \quad w_i > 0, \; v_i > 0

    Near zero it is about :math:`|a|_W^2`; for large a it grows like :math:`2 \sum_i w_i v_i |a_i|`. The gradient of
    half of it is :math:`w_i a_i / \sqrt{1 + (a_i / v_i)^2}`, that is w times `soft_clip`.

    Parameters
    ----------
    vector
        a, a column.
    width
        v, a column or a scalar of parameters.
    weight
        w, a column or a scalar of parameters.
    """

    vector: SX
    width: SX
    weight: SX = 1
    of: Text = UNNAMED

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return potential(self.vector, self.width, self.weight)


@final
@dataclass(frozen=True, eq=False)
class LogDet(Expressions):
    r"""Stein's loss, a Bregman divergence between two symmetric positive definite matrices.

    .. math:: c \left(\log\det\hat P - \log\det P + \mathrm{tr}(\hat P^{-1} P) - n\right)
        = c \sum_i (\lambda_i - 1 - \log\lambda_i), \quad c > 0

    with :math:`\lambda_i > 0` the eigenvalues of :math:`\hat P^{-1} P`. It is zero if the matrices are equal and
    positive otherwise. It tends to infinity if :math:`\hat P` does, or if :math:`\hat P` approaches a singular matrix.
    A V that contains it and does not increase therefore keeps :math:`\hat P` in a compact set of positive definite
    matrices, if the initial :math:`\hat P` is positive definite.

    Parameters
    ----------
    matrix
        :math:`\hat P`, symmetric: a state, or an expression of one.
    true
        P, symmetric: an expression of parameters and true values.
    weight
        c, a scalar of parameters.
    """

    matrix: SX
    true: SX
    weight: SX = 1
    of: Text = UNNAMED

    @property
    def vector(self) -> SX:
        """The elements of the matrix; they are bounded if the term is."""
        return ca.vec(ca.densify(ca.SX(self.matrix)))

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return self.weight * divergence(self.matrix, self.true)


Dissipated = Square | NormSquare | Lemma | InformationSquare
"""A term that is non-negative by construction."""
Stored = Square | InformationSquare | Potential | LogDet
"""A term of V; all of them except `InformationSquare` are positive definite."""
Bounded = Square | NormSquare | Clipped
"""A term with a known bound."""
