r"""A loop without its rounding: near a set-point a rounded signal is a staircase, which no slope describes.

In place of floor(x) stands x - 1/2, and in place of ceil(x) x + 1/2: what they are in the mean, where x is spread
evenly over a step. So the steps of an encoder are taken as fine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import casadi as ca

from dmframe.certificate import SX
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.exact.fixed import UndecidedError
from dmframe.program import OPERATIONS, by_code, codes, read, run

APPLY: Final[Mapping[int, Any]] = {
    code: (lambda a, b, code=code: ca.SX.binary(code, a, b))
    if row.arity == 2
    else (lambda a, code=code: ca.SX.unary(code, a))
    for code, row in OPERATIONS.items()
}
"""Each operation, applied to expressions."""

_MEANS: Final = by_code({"floor": lambda x: x - 0.5, "ceil": lambda x: x + 0.5})


def unknown(code: int) -> Exception:
    """What to raise for an operation that is not known."""
    return UndecidedError(f"CasADi's instruction {code} is not known here")


def unrounded(diagram: Diagram) -> Diagram:
    """The same diagram with all that is rounded as it is in the mean."""
    loop = diagram.loop
    if not rounds(loop):
        return diagram
    return replace(diagram, loop=loop.mapped(_mean))


def rounds(loop: ClosedLoop) -> bool:
    """Whether a signal of the loop is rounded."""
    moved = [*map(loop.moves_of, loop.variables), *(leaf.expression for leaf in loop.crossings)]
    return any(_rounded(part) for part in moved)


def _function(expression: SX) -> tuple[list[SX], Any]:
    symbols = ca.symvar(expression)
    return symbols, ca.Function("f", symbols, [expression])


def _rounded(expression: SX) -> bool:
    return bool(codes(_function(expression)[1]) & set(_MEANS))


def _mean(expression: Any) -> Any:
    if not _rounded(expression):
        return expression
    symbols, f = _function(expression)
    program = read(f)
    values = run(
        program,
        {**APPLY, **_MEANS},
        given=lambda argument, element: symbols[argument],
        constant=ca.SX,
        refuse=unknown,
    )
    (found,) = program.dense(values, ca.SX(0))
    return ca.reshape(ca.vertcat(*found), *expression.shape)


__all__ = ["APPLY", "rounds", "unknown", "unrounded"]
