"""Sparse ball matrices: an element that is not stored is exactly zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flint import arb, arb_mat

from dmframe.exact.balls import ZERO, precise
from dmframe.program import Program

Row = dict[int, arb]


def stored_rows(program: Program, values: Sequence[arb], rows: int) -> list[Row]:
    """Rows of the first output of a program, from the values of its nodes."""
    found: list[Row] = [{} for _ in range(rows)]
    for place, value in zip(program.outputs[0].places, program.stored(values)[0], strict=True):
        if not value.is_zero():
            found[place % rows][place // rows] = value
    return found


@precise()
def combined(factors: Mapping[int, arb], rows: Sequence[Row] | Mapping[int, Row]) -> Row:
    """Linear combination of rows; elements that cancel exactly are removed."""
    found: Row = {}
    for place, factor in factors.items():
        for column, value in rows[place].items():
            term = factor * value
            found[column] = found[column] + term if column in found else term
    return {column: value for column, value in found.items() if not value.is_zero()}


def product(left: Sequence[Row], right: Sequence[Row]) -> list[Row]:
    """Matrix product."""
    return [combined(row, right) for row in left]


def dense(rows: Sequence[Row], columns: int) -> arb_mat:
    """The same matrix in dense storage."""
    return arb_mat(len(rows), columns, [row.get(column, ZERO) for row in rows for column in range(columns)])


def sparse(matrix: arb_mat) -> list[Row]:
    """Nonzero elements of a matrix, by rows."""
    return [{column: v for column, v in enumerate(row) if not v.is_zero()} for row in matrix.tolist()]


def picked(rows: Sequence[Row], places: Sequence[int]) -> list[Row]:
    """Some columns, in the given order."""
    order = {place: k for k, place in enumerate(places)}
    return [{order[column]: value for column, value in row.items() if column in order} for row in rows]


__all__ = ["Row", "combined", "dense", "picked", "product", "sparse", "stored_rows"]
