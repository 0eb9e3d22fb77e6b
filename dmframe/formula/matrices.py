"""Arithmetic of LaTeX formulas with numbers, in which the shapes determine the kind of product."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

Numbers = np.ndarray
"""A matrix; a scalar is 1 x 1."""


@final
class UnreadableLatexError(Exception):
    """A formula outside of the grammar, or an unknown name."""


@final
class Eye:
    """A multiple of an identity matrix of undetermined size."""

    def __init__(self, scale: float) -> None:
        self.scale = scale


def block_matrix(rows: list[list[Any]]) -> Numbers:
    """A matrix of blocks, row by row."""
    heights = [max((item.shape[0] for item in row if not isinstance(item, Eye)), default=0) for row in rows]
    return np.block([[_sized(item, height) for item in row] for row, height in zip(rows, heights, strict=True)])


def _sized(item: Any, size: int) -> Numbers:
    return item.scale * np.eye(size) if isinstance(item, Eye) else as_matrix(item)


def stacked(parts: Sequence[Any]) -> Numbers:
    """(a, b): columns above one another."""
    if len({as_matrix(part).shape[1] for part in parts}) != 1:
        raise UnreadableLatexError("(a, b) stacks columns, and these have different widths")
    return np.vstack([as_matrix(part) for part in parts])


def as_matrix(value: Any) -> Numbers:
    """The numbers; an identity of undetermined size has none."""
    if isinstance(value, Eye):
        raise UnreadableLatexError("the identity I needs a matrix next to it")
    return np.asarray(value, dtype=float)


def scaled(sign: float, value: Any) -> Any:
    """A number times a value."""
    return Eye(sign * value.scale) if isinstance(value, Eye) else sign * value


def added(one: Any, other: Any) -> Any:
    """A sum of equal shapes, or with a scalar or an identity."""
    if isinstance(one, Eye) and isinstance(other, Eye):
        return Eye(one.scale + other.scale)
    if isinstance(one, Eye):
        one, other = other, one
    if isinstance(other, Eye):
        if one.shape[0] != one.shape[1]:
            raise UnreadableLatexError(f"the identity is added to {one.shape[0]} x {one.shape[1]}")
        return one + other.scale * np.eye(one.shape[0])
    if one.shape != other.shape and (1, 1) not in (one.shape, other.shape):
        raise UnreadableLatexError(f"{_size(one)} and {_size(other)} cannot be added")
    return one + other


def _size(value: Numbers) -> str:
    return f"{value.shape[0]} x {value.shape[1]}"


def multiplied(left: Any, right: Any) -> Any:
    """Product by shapes: a number scales, a column in front is a diagonal matrix, else a matrix product."""
    if isinstance(left, Eye):
        return scaled(left.scale, right)
    if isinstance(right, Eye):
        return Eye(right.scale * float(left[0, 0])) if left.shape == (1, 1) else left * right.scale
    if (1, 1) in (left.shape, right.shape) or (left.shape[1] == 1 and left.shape[0] == right.shape[0]):
        return left * right
    if left.shape[1] != right.shape[0]:
        raise UnreadableLatexError(f"{_size(left)} and {_size(right)} cannot be multiplied")
    return left @ right


def inverted(value: Any, *, matrix: bool = False) -> Any:
    """One over a value; for a square matrix its inverse."""
    value = as_matrix(value)
    if value.shape[0] == value.shape[1] and value.shape[0] > 1:
        if not matrix:
            raise UnreadableLatexError("a matrix is written with ^{-1}, not divided by")
        return np.linalg.inv(value)
    if value.shape[1] != 1:
        raise UnreadableLatexError(f"{_size(value)} has no inverse")
    return 1.0 / value
