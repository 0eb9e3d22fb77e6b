"""Sparse matrices of enclosures: what is not stored is zero, exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from dmframe.exact.fixed import Fixed
from dmframe.exact.matrix import Matrix
from dmframe.program import Program

Row = dict[int, Fixed]

ZERO: Final = Fixed(0, 0)


def stored_rows(program: Program, values: Sequence[Fixed], rows: int) -> list[Row]:
    """The first output of a program, row by row, of the values of its nodes."""
    found: list[Row] = [{} for _ in range(rows)]
    for place, value in zip(program.outputs[0].places, program.stored(values)[0], strict=True):
        if value.lower or value.upper:
            found[place % rows][place // rows] = value
    return found


def combined(factors: Mapping[int, Fixed], rows: Sequence[Row] | Mapping[int, Row]) -> Row:
    """The sum of rows, each times its factor; what cancels exactly is left out."""
    found: Row = {}
    for place, factor in factors.items():
        for column, value in rows[place].items():
            term = factor * value
            found[column] = found[column] + term if column in found else term
    return {column: value for column, value in found.items() if value.lower or value.upper}


def product(left: Sequence[Row], right: Sequence[Row]) -> list[Row]:
    """The product of two matrices."""
    return [combined(row, right) for row in left]


def dense(rows: Sequence[Row], columns: int) -> Matrix:
    """The same as a matrix that stores everything."""
    return Matrix.of([[row.get(column, ZERO) for column in range(columns)] for row in rows], columns)


def sparse(matrix: Matrix) -> list[Row]:
    """The elements of a matrix that are not zero, exactly."""
    found: list[Row] = [{} for _ in range(matrix.shape[0])]
    for (row, column), middle in np.ndenumerate(matrix.middle):
        radius = matrix.radius[row, column]
        if middle or radius:
            found[row][column] = Fixed(middle - radius, middle + radius)
    return found


def picked(rows: Sequence[Row], places: Sequence[int]) -> list[Row]:
    """Some columns, in that order."""
    order = {place: k for k, place in enumerate(places)}
    return [{order[column]: value for column, value in row.items() if column in order} for row in rows]


__all__ = ["Row", "combined", "dense", "picked", "product", "sparse", "stored_rows"]
