"""Recursions over a robot's joints, traced once per structure of zeros and replayed by CasADi.

Replaying a traced function takes a fortieth of the time of the recursion in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca

from dmframe.robot.chain import SerialChain

_TRACED: dict[Any, Any] = {}
_MOST = 256
"""Maximum number of cached functions."""


def placed(chain: SerialChain, numbers: Iterable[Fraction]) -> tuple[Any, ...]:
    """Structure of the robot: kinds of the joints, and numbers that are 0 or +-1, which are not symbols."""
    return (*(joint.kind for joint in chain.joints), *(int(x) if x in (0, 1, -1) else None for x in numbers))


def repeated(
    recursion: Callable[..., Any], placed: tuple[Any, ...], given: Sequence[Any], constants: Sequence[Any]
) -> Any:
    """Apply `recursion` to the arguments `given`, operation by operation.

    Parameters
    ----------
    placed
        Structure on which the recursion depends, in addition to the zeros and constants of its arguments; if empty, the
        recursion is not traced.
    given
        Arguments; constants remain constants.
    constants
        Columns of further symbols that it reads.
    """
    if not placed or not all(isinstance(item, ca.SX) for item in given):
        return recursion(*given)
    fixed = [item.is_constant() for item in given]
    pairs = list(zip(given, fixed, strict=True))
    if any(not is_fixed and any(x.is_constant() for x in item.nonzeros()) for item, is_fixed in pairs):
        return recursion(*given)  # a traced function would be simplified less than the recursion
    key = placed, *((_places(item), tuple(ca.DM(item).nonzeros()) if is_fixed else None) for item, is_fixed in pairs)
    if key not in _TRACED:
        if len(_TRACED) >= _MOST:
            _TRACED.clear()
        symbols = [item if is_fixed else ca.SX.sym("x", item.sparsity()) for item, is_fixed in pairs]
        moving = [item for item, is_fixed in zip(symbols, fixed, strict=True) if not is_fixed]
        _TRACED[key] = ca.Function("recursion", [*moving, *constants], [recursion(*symbols)])
    moving = [item for item, is_fixed in pairs if not is_fixed]
    return _TRACED[key].call([*moving, *constants])[0]


def forget() -> None:
    """Clear the cache, after a replacement of the recursions themselves."""
    _TRACED.clear()


def _places(item: Any) -> tuple[Any, ...]:
    """Shape and sparsity pattern."""
    rows, columns = item.sparsity().get_triplet()
    return item.shape, tuple(rows), tuple(columns)
