"""Sampled adaptation laws: the storage, decrease and residual of their steps, and the estimates that result.

Each class computes these terms from the elements of its law, so that a block cannot declare a term non-negative that
is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import casadi as ca

from dmframe.condition import SX
from dmframe.fields import Expressions
from dmframe.linalg import inverse_spd, ldl
from dmframe.terms import Square


@final
@dataclass(frozen=True, eq=False)
class NormalisedSteps(Expressions):
    r"""Steps of the normalised gradient (projection algorithm, NLMS) that an estimate takes from sample to sample.

    For each row (h, y) in turn, with separate parameters for each output j, the floor :math:`\nu > 0` and the diagonal
    gain :math:`\Gamma > 0`:

    .. math:: \varepsilon_j = y_j - h_j^\top \theta_j, \quad n_j = \nu + h_j^\top \Gamma_j h_j, \quad
        \theta_j \leftarrow \theta_j + \Gamma_j h_j \varepsilon_j / n_j

    With :math:`\tilde\theta = \theta - \theta_{true}` and :math:`\eta = y - h^\top \theta_{true}`, each step changes
    :math:`\tilde\theta^\top \Gamma^{-1} \tilde\theta` by exactly

    .. math:: - (h^\top \tilde\theta)^2 / n - \nu \varepsilon^2 / n^2 + \eta^2 / n

    for arbitrary rows. This is the standard property of the projection algorithm [GoodwinSin1984]_. The first two terms
    are never positive; :math:`\eta` is the part of the data that :math:`\theta_{true}` does not explain. Projection
    onto a box that contains the true value does not increase the estimation error.

    Parameters
    ----------
    estimate
        The state's name.
    theta, true, gain
        Columns: the parameters of all outputs, one below the other.
    parts
        Number of parameters of each output.
    floor
        A scalar of parameters.
    rows
        Pairs of h, a column like theta, and y, a column with one element per output; in their order.
    box
        Empty, or the lower and upper bounds, columns, onto which the estimate is projected after each step.
    """

    estimate: str
    theta: SX
    true: SX
    gain: SX
    parts: tuple[int, ...]
    floor: SX
    rows: tuple[tuple[SX, SX], ...]
    box: tuple[SX, ...] = ()

    @property
    def storage(self) -> Square:
        r""":math:`|\theta - \theta_{true}|^2` with the inverse of the gain as its weight."""
        return Square(self.theta - self.true, 1 / self.gain)

    @property
    def held(self) -> SX:
        """The estimate at the next sample."""
        return self._taken[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the states that the steps move."""
        return (self.estimate,)

    @property
    def states(self) -> Mapping[str, SX]:
        """These states."""
        return {self.estimate: self.theta}

    @property
    def moves(self) -> Mapping[str, SX]:
        """What they are at the next sample."""
        return {self.estimate: self.held}

    @property
    def constant(self) -> Mapping[str, SX]:
        """What must not move."""
        return {"true": self.true, "gain": self.gain, "floor": self.floor}

    @property
    def change(self) -> SX:
        """Change of the storage over all steps, without the decrease due to the projection onto the box."""
        return self._taken[1]

    @property
    def decrease(self) -> SX:
        r"""The sum of :math:`(h^\top \tilde\theta)^2 / n + \nu \varepsilon^2 / n^2`, never negative."""
        return self._taken[2]

    @property
    def residual(self) -> SX:
        r"""The sum of :math:`\eta^2 / n`, never negative."""
        explained = ((y - summed(self.parts, h * self.true), self._size(h)) for h, y in self.rows)
        return sum((ca.sum1(eta**2 / size) for eta, size in explained), ca.SX(0))

    @property
    def sizes(self) -> tuple[SX, ...]:
        """Positive divisors of the steps, columns: the n of each row."""
        return tuple(self._size(h) for h, _ in self.rows)

    def _size(self, h: SX) -> SX:
        return self.floor + summed(self.parts, h * h * self.gain)

    @cached_property
    def _taken(self) -> tuple[SX, SX, SX]:
        theta, moved, lost = self.theta, ca.SX(0), ca.SX(0)
        for h, y in self.rows:
            size = self._size(h)
            missed, error = y - summed(self.parts, h * theta), summed(self.parts, h * (theta - self.true))
            lost += ca.sum1(error**2 / size + self.floor * missed**2 / size**2)
            after = stepped(self.parts, theta, h, y, self.gain, self.floor)
            moved += ca.dot(after - theta, (after + theta - 2 * self.true) / self.gain)
            theta = ca.fmin(ca.fmax(after, self.box[0]), self.box[1]) if self.box else after
        return theta, moved, lost


def stepped(parts: Sequence[int], theta: SX, h: SX, y: SX, gain: SX, floor: SX) -> SX:
    r"""One step of `NormalisedSteps`: :math:`\theta + \Gamma h \varepsilon / (\nu + h^\top \Gamma h)`."""
    learnt = gain * h
    share = (y - summed(parts, h * theta)) / (floor + summed(parts, h * learnt))
    return theta + learnt * ca.vertcat(*(ca.repmat(share[j], count) for j, count in enumerate(parts)))


def summed(parts: Sequence[int], column: SX) -> SX:
    """The sum over each output's parameters."""
    ends = [sum(parts[: j + 1]) for j in range(len(parts))]
    return ca.vertcat(*(ca.sum1(column[end - count : end]) for end, count in zip(ends, parts, strict=True)))


@final
@dataclass(frozen=True, eq=False)
class LeastSquaresSteps(Expressions):
    r"""Steps of recursive least squares with forgetting that an estimate takes from sample to sample.

    For each row (h, y) in turn, with separate parameters and a separate matrix :math:`G_j` for each output j, which
    starts at zero or at a positive semidefinite matrix:

    .. math:: W = \Gamma^{-1} + G, \quad \varepsilon = y - h^\top \theta, \quad n = \nu + h^\top W^{-1} h, \quad
        \theta \leftarrow \theta + W^{-1} h \varepsilon / n, \quad G \leftarrow G + h h^\top / \nu

    With :math:`\tilde\theta = \theta - \theta_{true}` and :math:`\eta = y - h^\top \theta_{true}`, each step changes
    :math:`\tilde\theta^\top W \tilde\theta` by exactly

    .. math:: - \varepsilon^2 / n + \eta^2 / \nu

    for arbitrary rows. The operations that follow can only decrease it:

    - Element by element, an estimate outside its box is projected onto the face in the norm of W,
      :math:`\theta \leftarrow \theta - W^{-1} e_i (\theta_i - b_i) / (W^{-1})_{ii}`. The projection onto one face may
      lead out of another. If the estimate is still outside its box after the last element, :math:`G \leftarrow 0`, so
      that W is diagonal, and each element is clipped. The estimate is therefore in its box at each sample.
    - After all rows :math:`G \leftarrow \lambda G`, with :math:`0 \le \lambda \le 1`.

    Parameters
    ----------
    estimate, memory
        The states' names. The memory contains the lower triangles of all G, column by column, one below the other.
    theta, gathered
        These states, columns.
    true, gain
        Columns: the parameters of all outputs, one below the other.
    parts
        Number of parameters of each output.
    floor, retention
        :math:`\nu > 0` and :math:`\lambda`, scalars of parameters.
    rows
        Pairs of h, a column like theta, and y, a column with one element per output; in their order.
    box
        Empty, or the lower and upper bounds, columns.
    """

    estimate: str
    memory: str
    theta: SX
    gathered: SX
    true: SX
    gain: SX
    parts: tuple[int, ...]
    floor: SX
    retention: SX
    rows: tuple[tuple[SX, SX], ...]
    box: tuple[SX, ...] = ()

    @property
    def storage(self) -> Square:
        r""":math:`|\theta - \theta_{true}|^2` with the weight W."""
        metrics = (_metric(self._part(self.gain, j), G) for j, G in enumerate(unpacked(self.parts, self.gathered)))
        return Square(self.theta - self.true, ca.diagcat(*metrics))

    @property
    def held(self) -> SX:
        """The estimate at the next sample."""
        return self._taken.theta

    @property
    def kept(self) -> SX:
        """The memory at the next sample."""
        return self.retention * packed(self._taken.gathered)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the states that the steps move."""
        return self.estimate, self.memory

    @property
    def states(self) -> Mapping[str, SX]:
        """These states."""
        return {self.estimate: self.theta, self.memory: self.gathered}

    @property
    def moves(self) -> Mapping[str, SX]:
        """What they are at the next sample."""
        return {self.estimate: self.held, self.memory: self.kept}

    @property
    def constant(self) -> Mapping[str, SX]:
        """What must not move."""
        return {"true": self.true, "gain": self.gain, "floor": self.floor, "retention": self.retention}

    @property
    def change(self) -> SX:
        """Change of the storage over all steps, without the decrease due to the box and to forgetting."""
        return self._taken.moved

    @property
    def decrease(self) -> SX:
        r"""The sum of :math:`\varepsilon^2 / n`, never negative."""
        return self._taken.lost

    @property
    def residual(self) -> SX:
        r"""The sum of :math:`\eta^2 / \nu`, never negative."""
        return sum((ca.sumsqr(y - summed(self.parts, h * self.true)) / self.floor for h, y in self.rows), ca.SX(0))

    @property
    def sizes(self) -> tuple[SX, ...]:
        """Positive divisors of the steps, columns: pivots of W, the n of each row, diagonals of W^-1."""
        return self._taken.sizes

    def _part(self, column: SX, j: int) -> SX:
        end = sum(self.parts[: j + 1])
        return column[end - self.parts[j] : end]

    @cached_property
    def _taken(self) -> _Taken:
        theta, moved, lost = list[SX](), ca.SX(0), ca.SX(0)
        memories, sizes = list(unpacked(self.parts, self.gathered)), list[SX]()
        for j in range(len(self.parts)):
            now, true, gain = (self._part(column, j) for column in (self.theta, self.true, self.gain))
            for h, y in ((self._part(h, j), y[j]) for h, y in self.rows):
                W = _metric(gain, memories[j])
                learnt = inverse_spd(W) @ h
                size, missed, error = self.floor + ca.dot(h, learnt), y - ca.dot(h, now), now - true
                memories[j] += h @ h.T / self.floor
                after, next_W = now + learnt * missed / size, _metric(gain, memories[j])
                moved += _form(after - true, next_W) - _form(error, W)
                lost += missed**2 / size
                sizes += [*ldl(W)[1], size]
                now = after
                if self.box:
                    P = inverse_spd(next_W)
                    sizes += [*ldl(next_W)[1], ca.diag(P)]
                    now, memories[j] = _put_back(now, memories[j], P, *(self._part(end, j) for end in self.box))
            theta.append(now)
        return _Taken(ca.vertcat(*theta), tuple(memories), moved, lost, tuple(sizes))


@final
@dataclass(frozen=True, eq=False)
class _Taken:
    """Results of the steps of least squares."""

    theta: SX
    gathered: tuple[SX, ...]
    moved: SX
    lost: SX
    sizes: tuple[SX, ...]


def _metric(gain: SX, gathered: SX) -> SX:
    return ca.diag(1 / gain) + gathered


def _form(vector: SX, W: SX) -> SX:
    return ca.dot(vector, W @ vector)


def _put_back(theta: SX, gathered: SX, P: SX, lower: SX, upper: SX) -> tuple[SX, SX]:
    """Projection onto one face after the other in the norm of W = P^-1; if that fails, clipping and G = 0."""
    for i in range(theta.numel()):
        face = ca.fmin(ca.fmax(theta[i], lower[i]), upper[i])
        theta = theta - P[:, i] * ((theta[i] - face) / P[i, i])
        theta[i] = face  # exactly, without the rounding error of the line above
    cut = ca.fmin(ca.fmax(theta, lower), upper)
    for i in range(theta.numel() - 1):  # the last element has just been projected
        gathered = gathered * (theta[i] == cut[i])
    return cut, gathered


def packed(matrices: Sequence[SX]) -> SX:
    """Lower triangles of symmetric matrices, column by column, one below the other."""
    return ca.vertcat(*(ca.densify(G)[ca.Sparsity.lower(G.shape[0])].nz[:] for G in matrices))


def unpacked(parts: Sequence[int], column: SX) -> Sequence[SX]:
    """The symmetric matrices of these sizes from the column of their lower triangles."""
    sizes = [count * (count + 1) // 2 for count in parts]
    pieces = ca.vertsplit(column, [sum(sizes[:j]) for j in range(len(sizes) + 1)])
    return [ca.tril2symm(ca.SX(ca.Sparsity.lower(n), piece)) for n, piece in zip(parts, pieces, strict=True)]


def packed_size(parts: Sequence[int]) -> int:
    """Number of elements of the lower triangles."""
    return sum(count * (count + 1) // 2 for count in parts)


Steps = NormalisedSteps | LeastSquaresSteps
"""Sampled adaptation laws whose effect on V is known in closed form."""
