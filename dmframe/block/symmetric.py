"""Symbols of a full gain matrix: symmetric by construction, with the zeros of its value as structural zeros.

A matrix of independent symbols would include non-symmetric gains, for which the theorems do not hold. With structural
zeros the inverse of a block-diagonal gain costs no more than the inverses of its blocks.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from dmframe.block.base import AbstractBlock
from dmframe.block.certificate import SX
from dmframe.block.parameter import Spec, specs


def symmetric_symbol(name: str, value: np.ndarray) -> SX:
    """(p, p); an element above the diagonal is the same symbol as the one below."""
    lower = ca.SX.sym(name, ca.sparsify(ca.DM(np.tril(value))).sparsity())
    return ca.triu2symm(lower.T)


def unique(spec: Spec | None, symbol: SX, value: np.ndarray) -> tuple[SX, np.ndarray]:
    """A parameter's symbols, each once, and their values; a symmetric matrix gives the column of its lower triangle.

    Raises `ValueError` if a value requires a symbol that the diagram does not have.
    """
    if spec is None or spec.form != "gain" or (symbol.is_column() and value.ndim < 2):
        return symbol, value
    if symbol.shape != (value.shape[0], value.shape[0]) and value.ndim == 2:
        raise ValueError("expected a diagonal, as in the diagram; a full matrix requires another diagram")
    symbols, rows, columns = lower_triangle(symbol)
    full = value if value.ndim == 2 else np.diag(np.broadcast_to(value, symbol.shape[0]))
    held = np.zeros_like(full)
    held[rows, columns] = held[columns, rows] = full[rows, columns]
    if not np.array_equal(held, full):
        raise ValueError("expected the zeros of the diagram's matrix; other zeros require another diagram")
    return symbols, full[rows, columns]


def lower_triangle(symbol: SX) -> tuple[SX, list[int], list[int]]:
    """The symbols of a symmetric matrix, each once, as a column; with their rows and columns."""
    lower = ca.tril(symbol)
    rows, columns = lower.sparsity().get_triplet()
    return ca.vertcat(*lower.nonzeros()), rows, columns


def full_gains(block: AbstractBlock, parameters: Mapping[str, SX]) -> list[str]:
    """The parameters of a block that are full gain matrices."""
    gains = [key for key, spec in specs(type(block)).items() if spec.form == "gain"]
    return [key for key in gains if key in parameters and not parameters[key].is_column()]
