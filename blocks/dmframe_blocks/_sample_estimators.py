"""How a sampled inverse learns from rows: projections onto new and stored ones, or least squares that forgets."""

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
    inverse_spd,
    named,
    operation,
)
from dmframe_blocks._averaged_servo import AveragedServo


class Learning(NamedTuple):
    """What an estimator is given: Gamma, nu, the box, and what it does not forget from sample to sample."""

    gain: Any
    floor: Any
    box: Any
    retention: Any


class Estimator(Protocol):
    """Moves theta, and what it keeps of the samples."""

    def learnt(self, x: Signals, h: SX, g: SX, by: Learning) -> tuple[SX, Mapping[str, SX]]:
        """Theta after a new row h, g, and the states that it keeps."""

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Learning) -> Steps:
        """The same for a proof."""

    def kept(self, x: Signals, h: SX, g: SX) -> tuple[DelayLine, ...]:
        """The states that hold rows."""


@final
@dataclass(frozen=True)
class Projection:
    """Onto the new row, the stored ones from new to old, and the new one once more."""

    averaged: AveragedServo
    replay: int
    stride: int

    def learnt(self, x: Signals, h: SX, g: SX, by: Learning) -> tuple[SX, Mapping[str, SX]]:
        """Theta after these steps, in its box after each; and the rows with the new one, if its turn has come."""
        theta = self.averaged.learnt(
            x.theta, h, g, x.rows, x.goals, named("sizes", by.gain), by.floor, named("box", by.box)
        )
        kept = {"rows": self._stored(x, x.rows, h), "goals": self._stored(x, x.goals, g)}
        if self.stride > 1:
            kept["turn"] = ca.if_else(x.turn < self.stride - 1, x.turn + 1, 0)
        return theta, kept

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Learning) -> Steps:
        """Normalised ones."""
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
    """Of all rows so far, each sample's counting a little less than that of the next."""

    averaged: AveragedServo

    def learnt(self, x: Signals, h: SX, g: SX, by: Learning) -> tuple[SX, Mapping[str, SX]]:
        """Theta in its box, and the lower triangles of G."""
        sizes, box = named("sizes", by.gain), named("box", by.box)
        both = named("learnt", self.regressed(x.theta, x.gathered, h, g, sizes, by.floor, box))
        size = self.averaged.size
        return both[:size], {"gathered": by.retention * both[size:]}

    def steps(self, x: Signals, true: SX, h: SX, g: SX, by: Learning) -> Steps:
        """Steps of least squares."""
        box = tuple(ca.horzsplit(by.box))
        states, sizes = (x.theta, x.gathered, true, by.gain), (self.averaged.parts, by.floor, by.retention)
        return LeastSquaresSteps("theta", "gathered", *states, *sizes, ((h, g),), box)

    def kept(self, x: Signals, h: SX, g: SX) -> tuple[DelayLine, ...]:
        """No rows."""
        return ()

    @cached_property
    def regressed(self) -> Callable[..., Expression]:
        """The operation that learns from a row."""

        @operation
        def regressed(theta: Any, gathered: Any, h: Any, g: Any, Gamma: Any, nu: Any, box: Any) -> Any:
            """Theta by least squares, back in its box, and below it the triangles of G + h h'/nu, joint by joint."""
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
        """Theta and G of one joint after a row; in P the inverse of 1/Gamma + G, before and after it."""
        P = inverse_spd(ca.diag(1 / Gamma) + G)
        learnt = P @ h
        n = nu + ca.dot(h, learnt)
        return self.put_back(
            theta + learnt * (g - ca.dot(h, theta)) / n, G + h @ h.T / nu, P - learnt @ learnt.T / n, box
        )

    def put_back(self, theta: Any, G: Any, P: Any, box: Any) -> tuple[Any, Any]:
        """Onto the nearest point of each face that is passed, as P^-1 measures it; if that leaves another, cut.

        An element that is cut would take others along in the norm of P^-1: so G is forgotten then, and no norm joins
        them any more.
        """
        for i in range(theta.shape[0]):
            face = ca.fmin(ca.fmax(theta[i], box[i, 0]), box[i, 1])
            theta = theta - P[:, i] * (theta[i] - face) / P[i, i]
            theta[i] = face  # as it is but for rounding, which would count as outside below
        cut, inside = ca.fmin(ca.fmax(theta, box[:, 0]), box[:, 1]), ca.SX(1)
        for i in range(theta.shape[0] - 1):  # the last is where it was just put
            inside *= theta[i] == cut[i]
        return cut, inside * G


@lru_cache(maxsize=8)
def least_squares(averaged: AveragedServo) -> LeastSquares:
    """One object for all who ask, so that its operation is one."""
    return LeastSquares(averaged)


def triangle(size: int) -> int:
    """How many numbers the lower triangle of a square matrix has."""
    return size * (size + 1) // 2
