"""A verdict over many numbers is that of `verify` for each single graph: boxes, counts, and moved numbers.

For each packaged graph some numbers and initial values are drawn, zeros included. If the box, the count of a study
or the margins of a page report that the proof holds, or that it fails, `verify` of that single graph has to agree.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.block.model import SYMBOLIC
from dmframe.block.parameter import PAIRS, specs
from dmframe.catalogue import graphs
from dmframe.certify import Verdict, verify
from dmframe.certify.begun import START
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal
from dmframe.study.sample_proofs import FAILS, HOLDS, conditions_at

LABELS, POINTS = 3, 2
"""Numbers of each graph that are changed, one after another, and how many values of each are tried."""


def numbers(diagram: Diagram) -> list[str]:
    """Parameters that are numbers and can be changed separately, and the initial values of all states."""
    own = {parameter.label for parameter in diagram.loop.parameters if not parameter.label.startswith("robot.")}
    starts = [f"{START}{variable.label}" for variable in diagram.loop.variables]
    return sorted(label for label in own if label.partition(".")[0] in diagram.blocks) + starts


def drawn(diagram: Diagram, label: str, rng: np.random.Generator) -> np.ndarray | None:
    """Values near the graph's own, a row each; None if its block accepts none of them."""
    if label.startswith(START):
        variable = next(v for v in diagram.loop.variables if f"{START}{v.label}" == label)
        held = diagram.models[variable.block].values.get(variable.name, np.zeros(variable.symbol.numel()))
        own = np.broadcast_to(np.ravel(held, order="F"), (variable.symbol.numel(),))
    else:
        block, _, name = label.partition(".")
        own = np.asarray(diagram.models[block].values[name], dtype=float)
    for size in (1.0, 0.3, 0.05):
        reach = size * (np.abs(own) + 0.1 * (own == 0))
        rows = own + rng.uniform(-1, 3, (POINTS, *(1 for _ in own.shape))) * reach
        if label.startswith(START) or all(_taken(diagram, label, row) for row in written(diagram, label, rows)):
            return np.asarray(rows)
    return None


def written(diagram: Diagram, label: str, rows: np.ndarray) -> np.ndarray:
    """Values as in a graph file: for an interval all lower ends, then all upper ones."""
    block, _, name = label.partition(".")
    spec = specs(type(diagram.blocks[block])).get(name) if block in diagram.blocks else None
    return np.moveaxis(rows, -1, 1) if spec is not None and spec.form in PAIRS else rows


def _taken(diagram: Diagram, label: str, row: np.ndarray) -> bool:
    try:
        with_values(diagram, {label: row.tolist()})
    except (DmframeError, ValueError):
        return False
    return True


def single(diagram: Diagram, start: dict[str, Any], label: str, row: np.ndarray) -> Verdict:
    """Verdict on one graph."""
    if label.startswith(START):
        return verify(diagram, start={**start, label.removeprefix(START): row.tolist()})
    return verify(with_values(diagram, {label: row.tolist()}), start=start)


def box_of(diagram: Diagram, start: dict[str, Any], label: str, rows: np.ndarray) -> Verdict | None:
    """Verdict over the box of the rows; None for a parameter that is part of other numbers of the loop."""
    shape = next((p.value.shape for p in diagram.loop.parameters if p.label == label), rows.shape[1:])
    if shape != rows.shape[1:]:
        return None
    ends = (np.ravel(end, order="F").tolist() for end in (rows.min(axis=0), rows.max(axis=0)))
    given = [Interval(decimal(low), decimal(high)) for low, high in zip(*ends, strict=True)]
    return verify(diagram, uncertain={label: given}, start=start)


def disagreements(name: str, labels: int = LABELS) -> Iterator[tuple[str, str]]:
    """Each comparison: the changed numbers, and ``agrees``, ``open``, or the false report."""
    graph = dm.load(name)
    diagram, start = graph.diagram, dict(graph.start)
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    with SYMBOLIC:
        nominal = verify(diagram, start=start)
        for label in rng.permutation(numbers(diagram)).tolist()[:labels]:
            rows = drawn(diagram, label, rng)
            if rows is None:
                continue
            moved = written(diagram, label, rows)
            verdicts = {"page": conditions_at(diagram, start, {label: moved}, POINTS, nominal)}
            box = box_of(diagram, start, label, rows)
            if box is not None:
                verdicts["count"] = conditions_at(diagram, start, {label: moved}, POINTS, box)
                verdicts["box"] = np.full(POINTS, HOLDS) if box.outcome == "proved" else None
            for point in range(POINTS):
                reports = {kind: int(found[point]) for kind, found in verdicts.items() if found is not None}
                if not {HOLDS, FAILS} & set(reports.values()):
                    yield label, "open"
                    continue
                proved = single(diagram, start, label, moved[point]).outcome == "proved"
                for kind, reported in reports.items():
                    false = (reported == HOLDS and not proved) or (reported == FAILS and proved)
                    word = "holds" if reported == HOLDS else "fails"
                    yield label, f"{kind} reports {word}, falsely, at {moved[point].tolist()}" if false else "agrees"


def false(name: str, labels: int) -> list[tuple[str, str]]:
    """False reports; an empty comparison for a graph without changed numbers."""
    return [(label, what) for label, what in disagreements(name, labels) if "falsely" in what]


def test_single_graphs_agree_with_the_verdict_over_many_numbers() -> None:
    assert false("arm2_joint", 1) == []


def test_the_ends_of_an_interval_are_those_of_the_graph_that_writes_them() -> None:
    graph, label = dm.load("arm2_joint"), "inverse.w_I_box"
    diagram, start = graph.diagram, dict(graph.start)
    # the first is the same for either order of the ends in a row; the second is valid in the written order only
    rows = np.array([[[0.5, 2.5], [2.5, 20]], [[0.5, 0.6], [20, 20]]])
    with SYMBOLIC:
        reported = conditions_at(diagram, start, {label: rows}, len(rows), verify(diagram, start=start))
    alone = [single(diagram, start, label, row).outcome == "proved" for row in rows]
    assert reported is not None
    assert reported.tolist() == alone == [FAILS, HOLDS]


@pytest.mark.parametrize("graph", sorted(graphs()))
def test_of_every_packaged_graph_so(graph: str) -> None:
    assert false(graph, LABELS) == []
