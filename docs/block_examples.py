"""For each block the smallest packaged graph that contains it, and the simulated effect of its main parameter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import dmframe as dm
from dmframe.block import AbstractBlock
from dmframe.block.parameter import specs
from dmframe.block.port import Side
from dmframe.catalogue import graphs
from dmframe.common.errors import DmframeError

FACTORS: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors of a parameter's value in the graph, tried one after another."""
LONGEST: Final = 20.0
"""Duration of the run of a trial [s]."""


@dataclass(frozen=True)
class Example:
    """The smallest packaged graph with a block: its name, and the block's name there; and all others with the block."""

    graph: str
    block: str
    others: tuple[str, ...]


@cache
def example(name: str) -> Example | None:
    """Where a block is used: smallest are the fewest joints, then the fewest blocks, of graphs that can be proved."""
    found = dict[str, tuple[bool, int, int, str]]()
    blocks = dict[str, str]()
    for graph in graphs():
        whole = loaded(graph)
        mine = [block for block, fact in whole.blocks.facts.items() if fact["type"] == name]
        if mine:
            found[graph] = (
                _unproved(whole),
                whole.robot.n if whole.robot is not None else 0,
                len(whole.blocks),
                graph,
            )
            blocks[graph] = mine[0]
    if not found:
        return None
    smallest = min(found, key=found.__getitem__)
    return Example(smallest, blocks[smallest], tuple(graph for graph in found if graph != smallest))


def _unproved(graph: dm.Graph) -> bool:
    """True for a graph with a block that states no certificate."""
    blocks = (graph.blocks[name] for name in graph.blocks)
    return any(
        type(block).certificate is AbstractBlock.certificate for block in blocks if block.side is not Side.SOURCE
    )


@cache
def loaded(graph: str) -> dm.Graph:
    """A packaged graph, loaded once."""
    return dm.load(graph)


def diagram_of(graph: str) -> Any:
    """Its diagram."""
    return loaded(graph).diagram


def main_parameter(kind: type[AbstractBlock], block: AbstractBlock) -> str:
    """The first parameter that must be above zero, else the first non-zero number; empty without one."""
    known = {name: spec for name, spec in specs(kind).items() if spec.form in ("diagonal", "gain")}
    given = [name for name in known if _scaled(getattr(block, name), 2.0) is not None]
    positive = [name for name in given if known[name].sign == "> 0" and kind.model_fields[name].is_required()]
    return next(iter([*positive, *given]), "")


def _scaled(value: Any, factor: float) -> Any:
    """A value times a factor; None if the value would not change, or is not a number."""
    if isinstance(value, float | int) and not isinstance(value, bool):
        return factor * value if value else None
    if isinstance(value, tuple) and all(isinstance(item, float | int) for item in value):
        return tuple(factor * item for item in value) if any(value) else None
    return None


@dataclass(frozen=True)
class Trials:
    """The error with each value of a parameter, ``block.parameter``.

    Rows contain the factor, the value, the RMS error over the first and the last eighth, and a remark.
    """

    label: str
    until: float
    rows: tuple[tuple[str, str, str, str, str], ...]


def trials(kind: type[AbstractBlock], shown: Example) -> Trials | None:
    """The block's main parameter at some multiples of the graph's value; None for a block that has none."""
    graph = loaded(shown.graph)
    block = graph.blocks[shown.block]
    name = main_parameter(kind, block)
    if not name:
        return None
    label, until = f"{shown.block}.{name}", min(graph.duration, LONGEST)
    values = [_scaled(getattr(block, name), factor) for factor in FACTORS]
    rows = zip(FACTORS, values, _tried(graph, label, values, until), strict=True)
    return Trials(label, until, tuple((f"x {factor:g}", _number(value), *row) for factor, value, row in rows))


def _tried(graph: dm.Graph, label: str, values: Sequence[Any], until: float) -> list[tuple[str, str, str]]:
    """The error with each value: from one build, or from separate ones where a value is rejected."""
    try:
        return [_figures(run) for run in dm.compare(graph.variants({label: values}), until=until)]
    except DmframeError as error:
        if len(values) == 1:
            return [("", "", f"rejected: {error.text}")]
        return [row for value in values for row in _tried(graph, label, [value], until)]


def _figures(run: dm.Run) -> tuple[str, str, str]:
    error = run.error
    ended = "" if run.divergence is None else f"diverges at {run.divergence.time:.3g} s"
    if error is None:
        return "", "", ended or "nothing to follow"
    return _figure(error.rms_by_eighth[0], error.unit), _figure(error.rms_final, error.unit), ended


def _number(value: Any) -> str:
    return ", ".join(f"{item:.4g}" for item in value) if isinstance(value, tuple) else f"{value:.4g}"


def _figure(value: float | None, unit: str) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3g} {unit}"
