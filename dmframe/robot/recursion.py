"""Recursions over a robot's joints, stated once for arguments with the same zeros and repeated by CasADi.

A function repeats its operations at other expressions in a fortieth of the time of the recursion in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca

from dmframe.robot.chain import SerialChain

_STATED: dict[Any, Any] = {}
_MOST = 256
"""Functions that are kept."""


def placed(chain: SerialChain, numbers: Iterable[Fraction]) -> tuple[Any, ...]:
    """The kinds of the joints, and which numbers of the robot are 0 or +-1 and so are no symbols."""
    return (*(joint.kind for joint in chain.joints), *(int(x) if x in (0, 1, -1) else None for x in numbers))


def repeated(
    recursion: Callable[..., Any], placed: tuple[Any, ...], given: Sequence[Any], constants: Sequence[Any]
) -> Any:
    """`recursion` of the arguments `given`, operation by operation.

    Parameters
    ----------
    placed
        What the recursion does depends on this and on the zeros and constants of its arguments; if empty, it is not
        stated once.
    given
        Its arguments; constants remain constants.
    constants
        Columns of the symbols that it reads besides its arguments.
    """
    if not placed or not all(isinstance(item, ca.SX) for item in given):
        return recursion(*given)
    fixed = [item.is_constant() for item in given]
    pairs = list(zip(given, fixed, strict=True))
    if any(not is_fixed and any(x.is_constant() for x in item.nonzeros()) for item, is_fixed in pairs):
        return recursion(*given)  # CasADi would simplify later than the recursion does
    key = placed, *((_places(item), tuple(ca.DM(item).nonzeros()) if is_fixed else None) for item, is_fixed in pairs)
    if key not in _STATED:
        if len(_STATED) >= _MOST:
            _STATED.clear()
        symbols = [item if is_fixed else ca.SX.sym("x", item.sparsity()) for item, is_fixed in pairs]
        moving = [item for item, is_fixed in zip(symbols, fixed, strict=True) if not is_fixed]
        _STATED[key] = ca.Function("recursion", [*moving, *constants], [recursion(*symbols)])
    moving = [item for item, is_fixed in pairs if not is_fixed]
    return _STATED[key].call([*moving, *constants])[0]


def forget() -> None:
    """Forget what was stated, where the recursions themselves are replaced."""
    _STATED.clear()


def _places(item: Any) -> tuple[Any, ...]:
    """The shape, and where it has elements."""
    rows, columns = item.sparsity().get_triplet()
    return item.shape, tuple(rows), tuple(columns)
