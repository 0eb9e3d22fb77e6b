"""Parameters of many runs as columns of one matrix, each checked as in a graph file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from dmframe.block import AbstractBlock
from dmframe.block.gain import Prior
from dmframe.block.parameter import Spec, specs
from dmframe.common.errors import DmframeError, NeedsDiagramError, UnknownNameError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values


def columns_of(values: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Values as arrays with a row per run. Raises `ValueFault` if they are not numbers, or differ in length."""
    columns = dict[str, np.ndarray]()
    for label, column in values.items():
        try:
            columns[label] = np.asarray(column, dtype=float)
        except (TypeError, ValueError):
            raise ValueFault(f"values.{label}: expected an array of numbers with a row per run") from None
        if columns[label].ndim == 0:
            raise ValueFault(f"values.{label}: expected a row per run, found one number")
    lengths = {label: len(column) for label, column in columns.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{label} {length}" for label, length in lengths.items())
        raise ValueFault(f"values: expected columns of one length, found {counts}")
    return columns


def runs_in(columns: Mapping[str, np.ndarray], alike: int = 1) -> int:
    """Number of runs; `alike` if nothing varies."""
    return next((len(column) for column in columns.values()), alike)


def varied(diagram: Diagram, columns: Mapping[str, np.ndarray], run: int) -> Diagram:
    """Diagram with the numbers of one run; raises as `with_values`."""
    return with_values(diagram, {label: column[run].tolist() for label, column in columns.items()})


def parameters_of(
    diagram: Diagram, columns: Mapping[str, np.ndarray], runs: int
) -> tuple[np.ndarray, dict[int, DmframeError]]:
    """(P, N): the column `ClosedLoop.p_values` of each run, and the faults of runs with values that are not allowed.

    All runs are checked at once if the parameters only require a sign and a size; otherwise, and to report a fault,
    each run is checked separately.

    Raises
    ------
    UnknownNameError, NeedsDiagramError
        A parameter that cannot be varied.
    """
    p = np.repeat(diagram.loop.p_values[:, None], runs, axis=1)
    alone = np.ones(runs, dtype=bool)
    plain = [_independent(diagram, label, column) for label, column in columns.items()]
    if runs and None not in plain:
        alone[:] = False
        for parameter in filter(None, plain):
            alone |= ~parameter.put(p)
        alone[[0, -1]] = True  # usually two different ones: they show whether blocks use the parameters as symbols
    faults = dict[int, DmframeError]()
    for run in np.flatnonzero(alone).tolist():
        try:
            p[:, run] = varied(diagram, columns, run).loop.p_values
        except (UnknownNameError, NeedsDiagramError):
            raise
        except DmframeError as fault:
            faults[run] = fault
    return p, faults


@final
@dataclass(frozen=True)
class _Independent:
    """Parameter whose elements may be any finite numbers of one sign, with its rows in p."""

    sign: str
    column: np.ndarray
    places: tuple[slice, ...]

    def put(self, p: np.ndarray) -> np.ndarray:
        """Write the values of all runs; returns a mask of valid runs."""
        for place in self.places:
            p[place] = self.column.T
        sound = np.all(np.isfinite(self.column), axis=1)
        if self.sign:
            least = np.min(self.column, axis=1, initial=np.inf)
            sound &= least > 0 if self.sign == "> 0" else least >= 0
        return np.asarray(sound)


def _independent(diagram: Diagram, label: str, column: np.ndarray) -> _Independent | None:
    """Parameter that can be written to p without its block; None for others, and for values of another size."""
    block, _, name = label.partition(".")
    owner = diagram.blocks.get(block)
    spec = None if owner is None else specs(type(owner)).get(name)
    if owner is None or spec is None or getattr(owner, name) is None or _has_rules(type(owner)):
        return None
    if _followed(diagram, block) or any(state.name == name for state in owner.states) or column.ndim > 2:
        return None
    places, first = list[slice](), 0
    for parameter in diagram.loop.parameters:
        size = parameter.value.size
        if parameter.label == label:
            if not _elements(spec, parameter.symbol.is_column()) or column.shape[1:] not in ((), parameter.value.shape):
                return None
            places.append(slice(first, first + size))
        first += size
    return _Independent(spec.sign, column.reshape(len(column), -1), tuple(places)) if places else None


def _elements(spec: Spec, column: bool) -> bool:
    """True if a parameter's elements are independent of one another."""
    return column and spec.form in ("diagonal", "vector", "gain")


def _has_rules(kind: type[AbstractBlock]) -> bool:
    """True for a class with validators of its own."""
    mine, base = kind.__pydantic_decorators__, AbstractBlock.__pydantic_decorators__
    return bool(mine.model_validators) or mine.field_validators.keys() != base.field_validators.keys()


def _followed(diagram: Diagram, block: str) -> bool:
    """True if another block's gain is computed from the block's parameters."""
    gains = (getattr(other, key) for other in diagram.blocks.values() for key in specs(type(other)))
    return any(isinstance(gain, Prior) and gain.inverse_of == block for gain in gains)
