"""Sampled adaptation laws: storage, decrease and residual of their update steps, and the next estimates.

Each class computes these terms from the elements of its law, so that a block cannot declare a term nonnegative that
is not.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar, Literal, final

import casadi as ca

from dmframe.block.condition import SX
from dmframe.block.fields import Expressions
from dmframe.block.terms import Square
from dmframe.prove.rules import Column, Rule, StepResult, step_result


class _UpdateSteps(Expressions):
    """Update steps as expressions, evaluated by the rule of the proof's checker (`dmframe.prove.rules`)."""

    _moving: ClassVar[tuple[tuple[str, str], ...]] = (("estimate", "theta"),)
    _constant: ClassVar[tuple[str, ...]] = ("true", "gain", "floor")

    @property
    def states(self) -> Mapping[str, SX]:
        """States that the steps update."""
        return {getattr(self, name): getattr(self, state) for name, state in self._moving}

    @property
    def constant(self) -> Mapping[str, SX]:
        """Expressions that must be constant."""
        return {name: getattr(self, name) for name in self._constant}

    @property
    def rule(self) -> Literal["normalised", "least_squares"]:
        """Name of the rule."""
        return "normalised" if len(self._moving) == 1 else "least_squares"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states that the steps update."""
        return tuple(getattr(self, name) for name, _ in self._moving)

    @property
    def named(self) -> dict[str, SX]:
        """All expressions, by their names in the rule."""
        given: Any = self
        found = {state: getattr(self, state) for _, state in self._moving} | dict(self.constant)
        for place, (h, y) in enumerate(given.rows):
            found |= {f"h{place}": h, f"y{place}": y}
        return found | dict(zip(("lower", "upper"), given.box, strict=False))

    @property
    def held(self) -> SX:
        """The estimate at the next sample."""
        return self.moves[self.names[0]]

    @property
    def moves(self) -> Mapping[str, SX]:
        """The states at the next sample."""
        return {name: ca.vertcat(*numbers) for name, numbers in self._step_result.moves.items()}

    @property
    def change(self) -> SX:
        """Change of the storage over all steps, without the decrease due to the box and to forgetting."""
        return 2 * self._step_result.moved

    @property
    def decrease(self) -> SX:
        """Decrease of the storage, nonnegative."""
        return 2 * self._step_result.lost

    @property
    def residual(self) -> SX:
        """Increase of the storage due to the part of the rows that the true parameters do not explain, nonnegative."""
        return 2 * self._step_result.gained

    def result_in(self, ring: Any, parts: Mapping[str, Column]) -> StepResult:
        """Result of the steps in a ring, from the numbers of `named`, dense and column-major."""
        given: Any = self
        names = self.names
        return step_result(
            ring, Rule(self.rule, names[0], names[-1], given.parts, len(given.rows), bool(given.box)), parts
        )

    @cached_property
    def _step_result(self) -> StepResult:
        elements = {name: ca.vertsplit(ca.vec(ca.densify(ca.SX(x)))) for name, x in self.named.items()}
        return self.result_in(_Scalars(), elements)


@final
class _Scalars:
    """The ring of scalar expressions."""

    def number(self, value: Fraction | int) -> SX:
        """A number."""
        return ca.SX(float(value))

    def reduced(self, value: SX) -> SX:
        """The expression itself."""
        return value

    def inverse(self, value: SX) -> SX:
        """1 / value."""
        return 1 / value

    def call(self, name: str, *arguments: SX) -> SX:
        """The value of a function."""
        return {"fmin": ca.fmin, "fmax": ca.fmax, "eq": operator.eq}[name](*arguments)


@final
@dataclass(frozen=True, eq=False)
class NormalisedSteps(_UpdateSteps):
    r"""Update of an estimate by the normalised gradient (projection algorithm, NLMS) from sample to sample.

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


def summed(parts: Sequence[int], column: SX) -> SX:
    """The sum over each output's parameters."""
    ends = [sum(parts[: j + 1]) for j in range(len(parts))]
    return ca.vertcat(*(ca.sum1(column[end - count : end]) for end, count in zip(ends, parts, strict=True)))


@final
@dataclass(frozen=True, eq=False)
class LeastSquaresSteps(_UpdateSteps):
    r"""Update of an estimate by recursive least squares with forgetting from sample to sample.

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

    _moving: ClassVar = (("estimate", "theta"), ("memory", "gathered"))
    _constant: ClassVar = ("true", "gain", "floor", "retention")

    @property
    def storage(self) -> Square:
        r""":math:`|\theta - \theta_{true}|^2` with the weight W."""
        metric = ca.diagcat(*unpacked(self.parts, self.gathered))
        return Square(self.theta - self.true, ca.diag(1 / self.gain) + metric)

    @property
    def kept(self) -> SX:
        """The memory at the next sample."""
        return self.moves[self.memory]


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
