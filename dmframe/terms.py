"""The terms of which V and dV/dt are made: squares, and what else is known never to be negative, or to be bounded.

Each is built here of its parts, never stated as a whole, so that nobody can call a term non-negative that is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, final

import casadi as ca

from dmframe.condition import SX
from dmframe.fields import check_fields
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
            raise TypeError(
                f"Square({self.vector!r}, ...): expected the vector and its weight; what a term is called is printed "
                "from its expression"
            )
        check_fields(self)

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

    def __post_init__(self) -> None:
        check_fields(self)

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

    def __post_init__(self) -> None:
        check_fields(self)

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

    def __post_init__(self) -> None:
        check_fields(self)

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

    def __post_init__(self) -> None:
        check_fields(self)

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


@final
@dataclass(frozen=True, eq=False)
class NormalisedSteps:
    r"""Steps of the normalised gradient (projection algorithm, NLMS) that an estimate takes from sample to sample.

    For row after row (h, y), each output j with parameters of its own, with the floor :math:`\nu > 0` and the diagonal
    gain :math:`\Gamma > 0`:

    .. math:: \varepsilon_j = y_j - h_j^\top \theta_j, \quad n_j = \nu + h_j^\top \Gamma_j h_j, \quad
        \theta_j \leftarrow \theta_j + \Gamma_j h_j \varepsilon_j / n_j

    With :math:`\tilde\theta = \theta - \theta_{true}` and :math:`\eta = y - h^\top \theta_{true}`, each step moves
    :math:`\tilde\theta^\top \Gamma^{-1} \tilde\theta` by exactly

    .. math:: - (h^\top \tilde\theta)^2 / n - \nu \varepsilon^2 / n^2 + \eta^2 / n

    whatever the rows are: the first two are never positive, and the third is what the data have that no
    :math:`\theta_{true}` explains. Put back into a box that holds the true value, an estimate comes no farther from it.

    Parameters
    ----------
    estimate
        The state's name.
    theta, true, gain
        Columns: the parameters of all outputs, one below the other.
    parts
        How many parameters each output has.
    floor
        A scalar of parameters.
    rows
        Pairs of h, a column like theta, and y, a column with one element an output; in their order.
    box
        Nothing, or the least and the greatest values, columns, into which the estimate is put back after each step.
    """

    estimate: str
    theta: SX
    true: SX
    gain: SX
    parts: tuple[int, ...]
    floor: SX
    rows: tuple[tuple[SX, SX], ...]
    box: tuple[SX, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        rows = (piece for row in self.rows for piece in row)
        return self.theta, self.true, self.gain, self.floor, *rows, *self.box

    def with_pieces(self, pieces: Sequence[SX]) -> NormalisedSteps:
        """The same steps of other expressions."""
        theta, true, gain, floor, *rest = pieces
        count = 2 * len(self.rows)
        rows = tuple(zip(rest[:count:2], rest[1:count:2], strict=True))
        return NormalisedSteps(self.estimate, theta, true, gain, self.parts, floor, rows, tuple(rest[count:]))

    @property
    def storage(self) -> Square:
        r""":math:`|\theta - \theta_{true}|^2` weighed with the inverse of the gain."""
        return Square(self.theta - self.true, 1 / self.gain)

    @property
    def held(self) -> SX:
        """The estimate at the next sample."""
        return self._taken[0]

    @property
    def change(self) -> SX:
        """By what all steps together move what is stored, but for what the box takes away from it."""
        return self._taken[1]

    @property
    def decrease(self) -> SX:
        r"""The sum of :math:`(h^\top \tilde\theta)^2 / n + \nu \varepsilon^2 / n^2`, never negative."""
        return self._taken[2]

    @property
    def residual(self) -> SX:
        r"""The sum of :math:`\eta^2 / n`, never negative."""
        return self._taken[3]

    @property
    def sizes(self) -> tuple[SX, ...]:
        """The norms n of each row, by which its step divides: columns."""
        return tuple(self._size(h) for h, _ in self.rows)

    def _size(self, h: SX) -> SX:
        return self.floor + summed(self.parts, h * h * self.gain)

    @cached_property
    def _taken(self) -> tuple[SX, SX, SX, SX]:
        theta, moved, lost, gained = self.theta, ca.SX(0), ca.SX(0), ca.SX(0)
        for h, y in self.rows:
            size = self._size(h)
            missed, error = y - summed(self.parts, h * theta), summed(self.parts, h * (theta - self.true))
            lost += ca.sum1(error**2 / size + self.floor * missed**2 / size**2)
            gained += ca.sum1((missed + error) ** 2 / size)
            after = stepped(self.parts, theta, h, y, self.gain, self.floor)
            moved += ca.dot(after - theta, (after + theta - 2 * self.true) / self.gain)
            theta = ca.fmin(ca.fmax(after, self.box[0]), self.box[1]) if self.box else after
        return theta, moved, lost, gained


def stepped(parts: Sequence[int], theta: SX, h: SX, y: SX, gain: SX, floor: SX) -> SX:
    r"""One step of `NormalisedSteps`: :math:`\theta + \Gamma h \varepsilon / (\nu + h^\top \Gamma h)`."""
    learnt = gain * h
    share = (y - summed(parts, h * theta)) / (floor + summed(parts, h * learnt))
    return theta + learnt * ca.vertcat(*(ca.repmat(share[j], count) for j, count in enumerate(parts)))


def summed(parts: Sequence[int], column: SX) -> SX:
    """The sum over each output's parameters."""
    ends = [sum(parts[: j + 1]) for j in range(len(parts))]
    return ca.vertcat(*(ca.sum1(column[end - count : end]) for end, count in zip(ends, parts, strict=True)))


Dissipated = Square | NormSquare | Lemma | Gathered
"""A term that is never negative, by how it is built."""
Stored = Square | Gathered
"""A term of which V is made; a square alone is also positive."""
Bounded = Square | NormSquare | Clipped
"""A term with a known bound."""
