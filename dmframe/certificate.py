"""What a block claims about energy: storage, dissipation, supply, and the conditions under which it holds.

A block with storage S, dissipations d_i and supply s claims, along the closed loop,

    dS/dt = s - d_1 - d_2 - ... (+ e_1 + ..., bounded terms, of a robust adaptation)

The supplies of the blocks of a diagram cancel, so that V, the weighted sum of the storages, falls by the dissipations.
Squares and lemmas are kept apart, term by term, so that boundedness and integrability can be read off mechanically.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, final

import casadi as ca

from dmframe.condition import SX, Assumption, CommonLyapunov, Condition, Inequality
from dmframe.errors import BlockError
from dmframe.naming import operation


@final
@dataclass(frozen=True, eq=False)
class Square:
    r"""The quadratic form :math:`|a|_W^2 = a^\top W a`.

    Parameters
    ----------
    vector
        a, a column.
    weight
        W: a matrix, or a column or scalar that stands for a diagonal.
    of
        How a reader writes a; the framework prints it from the expression, and no author says it.
    """

    vector: SX
    weight: SX = 1
    of: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.vector, str):
            raise BlockError(
                f"Square({self.vector!r}, ...): expected the vector and its weight; what a term is called is printed "
                "from its expression"
            )

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.vector, self.weight

    def with_pieces(self, pieces: Sequence[SX]) -> Square:
        """The same form of other expressions."""
        vector, weight = pieces
        return Square(vector, weight, self.of)

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        if isinstance(self.weight, int | float) or self.weight.is_column():
            return ca.dot(self.vector, self.weight * self.vector)
        return ca.dot(self.vector, self.weight @ self.vector)


TINY = 2.0**-100
"""Under the root of a norm, so that it has a derivative, zero, at zero."""


@operation
def norm(vector: SX) -> SX:
    """The Euclidean norm of a column."""
    return ca.sqrt(ca.fmax(ca.sumsqr(vector), TINY))


@operation
def clip(vector: SX, width: SX) -> SX:
    """Each element held between -width and width."""
    return width * ca.fmin(ca.fmax(vector / width, -1), 1)


@operation
def beyond(vector: SX, width: SX) -> SX:
    """What each element has beyond -width or width: zero in between."""
    return width * _beyond(vector / width)


def _beyond(x: SX) -> SX:
    return x - ca.fmin(ca.fmax(x, -1), 1)


MONOTONE: Final[Mapping[str, Callable[[SX], SX]]] = MappingProxyType(
    {"tanh": ca.tanh, "sign": ca.sign, "atan": ca.atan, "beyond": _beyond}
)
"""Functions that never decrease, by the name that a `Lemma` gives; `beyond` is that of width 1."""


@final
@dataclass(frozen=True, eq=False)
class Lemma:
    r"""A term that is not a square, and that is not negative because :math:`\phi` never decreases.

    .. math:: \sum_i w_i (a_i - b_i) (\phi(a_i / v_i) - \phi(b_i / v_i)), \quad w_i \ge 0, \; v_i > 0

    The term is built here of its parts, never stated as a whole: nobody can call a term non-negative that is not.

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
    of: str = ""

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.weight, self.first, self.second, self.scale

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        phi = MONOTONE[self.phi]
        slip = phi(self.first / self.scale) - phi(self.second / self.scale)
        return ca.sum1(self.weight * (self.first - self.second) * slip)

    def with_pieces(self, pieces: Sequence[SX]) -> Lemma:
        """The same term of other expressions."""
        weight, first, second, scale = pieces
        return Lemma(weight, first, second, scale, self.phi, self.of)


@final
@dataclass(frozen=True, eq=False)
class NormSquare:
    r"""The form :math:`|b|\,|a|_W^2`: a square whose weight grows with the norm of a signal.

    Parameters
    ----------
    vector, weight, of
        As of a `Square`.
    by
        b, a column of signals.
    by_of
        How a reader writes b; printed from the expression too.
    """

    vector: SX
    weight: SX
    by: SX
    of: str = ""
    by_of: str = ""

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.vector, self.weight, self.by

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        return norm(self.by) * self.square.value

    @property
    def square(self) -> Square:
        """The form without the norm."""
        return Square(self.vector, self.weight, self.of)

    def with_pieces(self, pieces: Sequence[SX]) -> NormSquare:
        """The same form of other expressions."""
        vector, weight, by = pieces
        return NormSquare(vector, weight, by, self.of, self.by_of)


@final
@dataclass(frozen=True, eq=False)
class Gathered:
    r"""The form :math:`c\,|a|_G^2` with a matrix G that a block gathers along the motion, and forgets.

    .. math:: \dot G = -\mathrm{forgetting}\, G + W^\top \mathrm{diag}(r) W, \quad G(0) = 0 \quad\Rightarrow\quad
        G(t) = \int_0^t e^{-\mathrm{forgetting} (t - s)} W^\top \mathrm{diag}(r) W\, ds \ge 0

    so it is never negative, though its weight is a state: that the state moves like this is a part of the exact test.

    Parameters
    ----------
    vector
        a, a column.
    weight
        c, a scalar of parameters.
    memory
        G, symmetric: a state, or made of one.
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
    of: str = ""

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.vector, self.weight, self.memory, self.regressor, self.by, self.forgetting

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        return self.weight * ca.dot(self.vector, self.memory @ self.vector)

    @property
    def rate(self) -> SX:
        """What dG/dt has to be."""
        return gathered(self.memory, self.regressor, self.by, self.forgetting)

    def with_pieces(self, pieces: Sequence[SX]) -> Gathered:
        """The same form of other expressions."""
        vector, weight, memory, regressor, by, forgetting = pieces
        return Gathered(vector, weight, memory, regressor, by, forgetting, self.of)


def gathered(memory: SX, regressor: SX, by: SX, forgetting: SX) -> SX:
    """-forgetting G + W' diag(r) W."""
    return regressor.T @ ca.diag(by) @ regressor - forgetting * memory


@final
@dataclass(frozen=True, eq=False)
class Clipped:
    r"""The term :math:`\sum_i \mathrm{clip}(s_i, v_i) b_i`, of either sign and at most :math:`\sum_i v_i |b_i|`.

    Parameters
    ----------
    first, width, other
        s, v and b: columns, the width of parameters above zero.
    """

    first: SX
    width: SX
    other: SX
    of: str = ""

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.first, self.width, self.other

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return ca.dot(clip(self.first, self.width), self.other)

    def with_pieces(self, pieces: Sequence[SX]) -> Clipped:
        """The same term of other expressions."""
        first, width, other = pieces
        return Clipped(first, width, other, self.of)


Dissipated = Square | NormSquare | Lemma | Gathered
"""A term that is never negative, by how it is built."""
Stored = Square | Gathered
"""A term of which V is made; a square alone is also positive."""
Bounded = Square | NormSquare | Clipped
"""A term with a known bound."""


@final
@dataclass(frozen=True, eq=False)
class Consumed:
    r"""What a cascade takes from the servo level: :math:`c\,|a|^2`; some block there has to pay for it.

    Parameters
    ----------
    vector
        a, a column: the error with which the servo level follows the cascade's reference.
    c
        A scalar of parameters.
    """

    vector: SX
    c: SX

    @property
    def value(self) -> SX:
        """The term as one scalar expression."""
        return self.c * ca.dot(self.vector, self.vector)


@final
@dataclass(frozen=True, eq=False)
class Driven:
    r"""Signals that V does not weigh, and that stay bounded because a stable linear equation drives them.

    .. math:: \dot z_j = \sum_k A_{jk} z_k + r_j, \quad j, k = 1 \dots N

    one such equation a joint. That every remainder r is bounded is decided from the closed loop's equations, and that A
    is stable at the graph's numbers, also while a state that it holds moves anywhere in its box. The signals that
    follow, `bounded`, are the z plus something bounded; and where r vanishes, the z do.

    Parameters
    ----------
    vectors
        z, columns.
    rates
        A, row by row: columns or scalars of parameters, or of states with a box.
    bounded
        What is bounded with them: columns.
    otherwise
        Conditions that have to take its place where it is not shown.
    of
        How a reader writes what is bounded; printed from the expressions.
    """

    vectors: tuple[SX, ...]
    rates: tuple[tuple[SX, ...], ...]
    bounded: tuple[SX, ...]
    otherwise: tuple[Condition, ...] = ()
    of: tuple[str, ...] = ()

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return (*self.vectors, *(rate for row in self.rates for rate in row), *self.bounded)

    def with_pieces(self, pieces: Sequence[SX]) -> Driven:
        """The same equations of other expressions."""
        left, count = list(pieces), len(self.vectors)
        vectors, left = left[:count], left[count:]
        rows = tuple(tuple(left[k * count : (k + 1) * count]) for k in range(count))
        return Driven(tuple(vectors), rows, tuple(left[count * count :]), self.otherwise, self.of)


@final
@dataclass(frozen=True)
class Certificate:
    """One block's part of the Lyapunov function.

    Parameters
    ----------
    storage
        S is *half* the sum of these terms.
    dissipation
        What is lost, each term non-negative.
    supply
        What flows in from the other blocks, beside what the block consumes.
    consumes
        For a cascade: what the servo level pays for.
    pays
        For the block that pays: coefficients with which the consumed vector is composed of the first dissipated
        squares' vectors, elementwise; none for a block that does not pay.
    task
        The block stands on the task level: its storage has the weight 1 where the servo level has kappa.
    truth
        True values that other blocks' estimates have: ``{"a_d": ...}``.
    excess
        What dS/dt may have above minus the dissipation: terms that are not dissipated but bounded, such as a leak
        leaves behind. A claim with one is proved up to a bounded residual.
    driven
        Signals that stay bounded although V does not weigh them.
    """

    storage: tuple[Stored, ...] = ()
    dissipation: tuple[Dissipated, ...] = ()
    supply: SX = 0
    consumes: Consumed | None = None
    pays: tuple[SX, ...] = ()
    task: bool = False
    truth: Mapping[str, SX] = field(default_factory=dict)
    excess: tuple[Bounded, ...] = ()
    driven: tuple[Driven, ...] = ()

    def mapped(self, transform: Callable[[list[SX]], list[SX]]) -> Certificate:
        """The certificate with all its expressions transformed together."""
        terms = (*self.storage, *self.dissipation, *self.excess, *self.driven)
        pieces = [ca.SX(piece) for term in terms for piece in term.pieces]
        consumed = [] if self.consumes is None else [ca.SX(self.consumes.vector), ca.SX(self.consumes.c)]
        done = iter(transform([*pieces, ca.SX(self.supply), *consumed, *map(ca.SX, self.pays)]))

        def rebuilt(term: Any) -> Any:
            return term.with_pieces([next(done) for _ in term.pieces])

        return Certificate(
            storage=tuple(rebuilt(term) for term in self.storage),
            dissipation=tuple(rebuilt(term) for term in self.dissipation),
            excess=tuple(rebuilt(term) for term in self.excess),
            driven=tuple(rebuilt(term) for term in self.driven),
            supply=next(done),
            consumes=Consumed(next(done), next(done)) if consumed else None,
            pays=tuple(done),
            task=self.task,
            truth=self.truth,
        )


__all__ = [
    "MONOTONE",
    "SX",
    "TINY",
    "Assumption",
    "Bounded",
    "Certificate",
    "Clipped",
    "CommonLyapunov",
    "Condition",
    "Consumed",
    "Dissipated",
    "Driven",
    "Gathered",
    "Inequality",
    "Lemma",
    "NormSquare",
    "Square",
    "Stored",
    "beyond",
    "clip",
    "gathered",
    "norm",
]
