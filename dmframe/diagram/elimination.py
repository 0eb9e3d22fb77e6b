"""Sparse linear systems as straight-line expressions, with pivots chosen when the expressions are built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import casadi as ca

from dmframe.common.errors import EngineError

MOST_FACTORS: Final = 5000
"""Limit for expressions and compilation in a few seconds: 70 states, all coupled."""


@final
class Turn(NamedTuple):
    """One pivot: its row, and the indices in `Elimination.factors` of the factors that the solution uses.

    `lower` are the multiples of the pivot's row subtracted from other rows, `upper` the remaining entries of that row,
    and `inverse` is 1 over the pivot; None for a pivot that is 1 by structure.
    """

    row: int
    lower: tuple[tuple[int, int], ...]
    upper: tuple[tuple[int, int], ...]
    inverse: int | None


@final
@dataclass(frozen=True)
class Elimination:
    """LU factorisation of a square matrix with diagonal pivots in the order of least fill-in [Markowitz1957]_.

    No pivot is chosen by its value: check a solution with `residual_small`.
    """

    turns: tuple[Turn, ...]
    factors: tuple[Any, ...]

    @classmethod
    def of(cls, matrix: Any) -> Elimination:
        """Factorise a sparse SX matrix with a full diagonal. Raises `EngineError` for one that is too large."""
        size = matrix.size1()
        rows = [dict[int, Any]() for _ in range(size)]
        for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
            if not matrix[i, j].is_zero():
                rows[i][j] = matrix[i, j]
        left, turns, factors = set(range(size)), list[Turn](), list[Any]()

        def kept(value: Any) -> int:
            factors.append(value)
            return len(factors) - 1

        def check() -> None:
            if len(factors) + sum(len(rows[i]) for i in left) > MOST_FACTORS:
                raise EngineError(
                    f"solver: expected linear systems of at most {MOST_FACTORS} factors, found more, in {size} states "
                    "of the plant; take solver.method: rk4 or cvodes",
                    path=("solver", "method"),
                )

        check()
        while left:
            pivot = min(left, key=lambda i: ((len(rows[i]) - 1) * (sum(i in rows[k] for k in left) - 1), i))
            left.remove(pivot)
            own = rows[pivot]
            value = own.pop(pivot)
            inverse = None if value.is_one() else kept(1 / value)
            upper = tuple((j, kept(element)) for j, element in own.items())
            lower = []
            for k in sorted(left):
                if pivot not in rows[k]:
                    continue
                element = rows[k].pop(pivot)
                multiple = element if inverse is None else element * factors[inverse]
                lower.append((k, kept(multiple)))
                for j, entry in own.items():
                    rows[k][j] = rows[k].get(j, 0) - multiple * entry
            check()
            turns.append(Turn(pivot, tuple(lower), upper, inverse))
        return cls(tuple(turns), tuple(factors))

    def solution(self, factors: Sequence[Any], right: Sequence[Any]) -> list[Any]:
        """Solution for a right-hand side; `factors` are `self.factors`, or symbols for them."""
        values = list(right)
        for turn in self.turns:
            for k, place in turn.lower:
                values[k] = values[k] - factors[place] * values[turn.row]
        for turn in reversed(self.turns):
            for j, place in turn.upper:
                values[turn.row] = values[turn.row] - factors[place] * values[j]
            if turn.inverse is not None:
                values[turn.row] = values[turn.row] * factors[turn.inverse]
        return values


BACKWARD: Final = 1e-8
"""Bound of the componentwise backward error of a solution [OettliPrager1964]_."""


def residual_small(matrix: Any, solution: Any, right: Any) -> Any:
    r"""True if a solution solves a nearby system, :math:`|b - A x| \le \omega (|A| |x| + |b|)` in each row.

    False also if a value is not a number. A factorisation without numeric pivoting can lose all digits.
    """
    sizes = ca.fabs(matrix) @ ca.fabs(solution) + ca.fabs(right)
    small = ca.SX(1)
    for row in ca.vertsplit(ca.fabs(right - matrix @ solution) <= BACKWARD * sizes):
        small = ca.logic_and(small, row)
    return small
