"""What a block claims about energy: storage, dissipation, supply, and the conditions under which it holds.

A block with storage S, dissipations d_i and supply s claims, along the closed loop,

    dS/dt = s - d_1 - d_2 - ...

The supplies of the blocks of a diagram cancel, so that V, the weighted sum of the storages, falls by the dissipations.
Squares and lemmas are kept apart, term by term, so that boundedness and integrability can be read off mechanically.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import casadi as ca

SX = Any
"""A CasADi expression; the library is untyped."""


@final
@dataclass(frozen=True)
class Square:
    r"""The quadratic form :math:`|a|_W^2 = a^\top W a`.

    Parameters
    ----------
    of
        How a reader writes a: ``"w - 1/K_star"``.
    vector
        a, a column.
    weight
        W: a matrix, or a column or scalar that stands for a diagonal.
    """

    of: str
    vector: SX
    weight: SX

    @property
    def value(self) -> SX:
        """The form as one scalar expression."""
        if self.weight.is_column():
            return ca.sum1(self.weight * self.vector * self.vector)
        return ca.dot(self.vector, self.weight @ self.vector)


@final
@dataclass(frozen=True)
class Lemma:
    """A term that is not a square, and that `name` shows to be non-negative."""

    name: str
    value: SX


@final
@dataclass(frozen=True)
class Certificate:
    """One block's part of the Lyapunov function.

    Parameters
    ----------
    storage
        S is *half* the sum of these squares.
    dissipation
        What is lost, each term non-negative.
    supply
        What flows in from the other blocks.
    consumes
        c, for a cascade: its supply holds c |sigma|^2, and the servo level has to pay for it.
    truth
        True values that other blocks' estimates have: ``{"a_d": ...}``.
    """

    storage: tuple[Square, ...] = ()
    dissipation: tuple[Square | Lemma, ...] = ()
    supply: SX = 0
    consumes: SX | None = None
    truth: Mapping[str, SX] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Condition:
    """An inequality that a proof needs: every element of `expression` above zero (or not below, if not `strict`)."""

    name: str
    expression: SX
    source: str
    strict: bool = True
