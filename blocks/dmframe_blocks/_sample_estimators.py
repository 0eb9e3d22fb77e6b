"""Estimators of a sampled inverse: the projection algorithm with replay, and least squares with forgetting."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Protocol, final

import casadi as ca

from dmframe.block import (
    SX,
    DelayLine,
    Expression,
    LeastSquaresSteps,
    NormalisedSteps,
    Signals,
    Steps,
    inverse_factors,
    named,
    operation,
)
from dmframe_blocks._averaged_servo import AveragedServo


class Adaptation(NamedTuple):
    """Parameters of an estimator: Gamma, nu, the box, and the retention per sample."""

    gain: Any
    floor: Any
    box: Any
    retention: Any


class Estimator(Protocol):
    """Updates theta and the estimator's memory."""

    def updated(self, x: Signals, h: SX, g: SX, by: Adaptation) -> tuple[SX, Mapping[str, SX]]:
        """Theta after a new row h, g, and the states of the memory."""

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Adaptation) -> Steps:
        """The same steps for a proof."""

    def kept(self, x: Signals, h: SX, g: SX) -> tuple[DelayLine, ...]:
        """The states that store rows."""


@final
@dataclass(frozen=True)
class Projection:
    """Projections onto the new row, the stored rows from new to old, and the new row again."""

    averaged: AveragedServo
    replay: int
    stride: int

    def updated(self, x: Signals, h: SX, g: SX, by: Adaptation) -> tuple[SX, Mapping[str, SX]]:
        """Theta after these steps, each clipped to the box; and the stored rows, with the new one if it is due."""
        theta = self.averaged.updated(
            x.theta, h, g, x.rows, x.goals, named("sizes", by.gain), by.floor, named("box", by.box)
        )
        kept = {"rows": self._stored(x, x.rows, h), "goals": self._stored(x, x.goals, g)}
        if self.stride > 1:
            kept["turn"] = ca.if_else(x.turn < self.stride - 1, x.turn + 1, 0)
        return theta, kept

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Adaptation) -> Steps:
        """Normalised steps."""
        stored = [(x.rows[k, :].T, x.goals[k, :].T) for k in range(self.replay)]
        rows, box = ((h, g), *stored, (h, g)), tuple(ca.horzsplit(by.box))
        return NormalisedSteps("theta", x.theta, true, by.gain, self.averaged.parts, by.floor, rows, box)

    def kept(self, x: Signals, h: SX, g: SX) -> tuple[DelayLine, ...]:
        """Rows and goals."""
        return tuple(DelayLine(name, item.T, self._turn(x)) for name, item in (("rows", h), ("goals", g)))

    def _stored(self, x: Signals, rows: SX, new: SX) -> SX:
        pushed = self.averaged.pushed(rows, new)
        return pushed if self.stride == 1 else ca.if_else(self._turn(x), pushed, rows)

    def _turn(self, x: Signals) -> SX:
        """True at each sample whose row is stored."""
        return 1 if self.stride == 1 else x.turn < 1


@final
@dataclass(frozen=True)
class LeastSquares:
    """Recursive least squares over all rows, with exponential forgetting."""

    averaged: AveragedServo

    def updated(self, x: Signals, h: SX, g: SX, by: Adaptation) -> tuple[SX, Mapping[str, SX]]:
        """Theta in its box, and the lower triangles of G."""
        sizes, box = named("sizes", by.gain), named("box", by.box)
        both = named("updated", self.regressed(x.theta, x.gathered, h, g, sizes, by.floor, box))
        size = self.averaged.size
        return both[:size], {"gathered": by.retention * both[size:]}

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Adaptation) -> Steps:
        """Steps of least squares."""
        box = tuple(ca.horzsplit(by.box))
        states, sizes = (x.theta, x.gathered, true, by.gain), (self.averaged.parts, by.floor, by.retention)
        return LeastSquaresSteps("theta", "gathered", *states, *sizes, ((h, g),), box)

    def kept(self, x: Signals, h: SX, g: SX) -> tuple[DelayLine, ...]:
        """No rows."""
        return ()

    @cached_property
    def regressed(self) -> Callable[..., Expression]:
        """Operation that updates the estimate with a row."""

        @operation
        def regressed(theta: Any, gathered: Any, h: Any, g: Any, Gamma: Any, nu: Any, box: Any) -> Any:
            """Theta by least squares, projected onto its box, and below it the triangles of G + h h'/nu, by joint."""
            estimates, triangles, end = [], [], 0
            for j, part in enumerate(self.averaged.joints):
                start, end = end, end + triangle(part.stop - part.start)
                G = ca.tril2symm(ca.SX(ca.Sparsity.lower(part.stop - part.start), gathered[start:end]))
                found = self.step(theta[part], G, h[part], g[j], Gamma[part], nu, box[part, :])
                estimates.append(found[0])
                triangles += [found[1][column:, column] for column in range(G.shape[0])]
            return ca.vertcat(*estimates, *triangles)

        return regressed

    def step(self, theta: Any, G: Any, h: Any, g: Any, Gamma: Any, nu: Any, box: Any) -> tuple[Any, Any]:
        """Theta and G of one joint after a row; P is the inverse of 1/Gamma + G, before and after it."""
        M, N = inverse_factors(ca.diag(1 / Gamma) + G)  # P = M'N
        P_h = N.T @ (M @ h)
        n = nu + ca.dot(h, P_h)
        left, right = ca.vertcat(M, P_h.T), ca.vertcat(N, -P_h.T / n)
        return self.put_back(theta + P_h * (g - ca.dot(h, theta)) / n, G + h @ h.T / nu, left, right, box)

    def put_back(self, theta: Any, G: Any, left: Any, right: Any, box: Any) -> tuple[Any, Any]:
        """Projection onto each violated face in the norm of P^-1, P = left'right; clipping if another face is violated.

        The projection onto face i subtracts column i of P with a multiplier; the elements after i need it at once,
        those before i in the end. P itself is not computed. An element is exactly on its face if no later one is
        projected: rounding would count as outside below.

        Clipping one element could increase the norm of P^-1, which couples the elements. G is therefore set to zero in
        that case, so that the norm is diagonal.
        """
        columns = list(zip(ca.horzsplit(left), ca.horzsplit(right), strict=True))
        moved, faces, multipliers = ca.SX(left.shape[0], 1), list[Any](), list[Any]()
        for i, (row, column) in enumerate(columns):
            here = theta[i] - ca.dot(row, moved)
            faces.append(ca.fmin(ca.fmax(here, box[i, 0]), box[i, 1]))
            multipliers.append((here - faces[i]) / ca.dot(row, column))
            moved += column * multipliers[i]
        elements, moved = list[Any](), ca.SX(left.shape[0], 1)
        for (row, column), face, multiplier in zip(*map(reversed, (columns, faces, multipliers)), strict=True):
            elements.insert(0, face - ca.dot(row, moved))
            moved += column * multiplier
        theta = ca.vertcat(*elements)
        cut, inside = ca.fmin(ca.fmax(theta, box[:, 0]), box[:, 1]), ca.SX(1)
        for i in range(theta.shape[0] - 1):  # the last element has just been projected
            inside *= theta[i] == cut[i]
        return cut, inside * G


@lru_cache(maxsize=8)
def least_squares(averaged: AveragedServo) -> LeastSquares:
    """The shared estimator object, so that its operation is unique."""
    return LeastSquares(averaged)


def triangle(size: int) -> int:
    """Number of elements of the lower triangle of a square matrix."""
    return size * (size + 1) // 2
