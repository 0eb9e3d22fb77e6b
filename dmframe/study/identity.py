"""Identity of a study: all inputs that determine the numbers of a row."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dmframe.common.version import version
from dmframe.config.resolved import companions, resolved, robot_source
from dmframe.graph.graph import Graph
from dmframe.study.design import Spread

if TYPE_CHECKING:
    from dmframe.study.plan import Study

FORMAT: Final = 1
"""Version of the table's format, part of the identity."""


def identity_of(study: Study) -> dict[str, Any]:
    """The identity as plain data for JSON."""
    file = study.file
    sample: dict[str, Any] = {
        factor.name: {
            "of": list(factor.labels),
            "how": factor.how,
            "unit": factor.unit,
            "elements": factor.elements,
            "spread": list(map(_spread, factor.each)) if factor.each else _spread(factor.spread),
        }
        for factor in study.factors
    }
    if study.factors:
        sample |= {"method": file.sample.method, "seed": file.sample.seed}
        if not study.design.extends:
            sample["runs"] = file.sample.runs  # another number moves all samples
    grid = {
        axis.name: [
            [case.graph, case.factor, list(axis.scaled), [[given.label, given.plain] for given in case.sets]]
            for case in axis.cases
        ]
        for axis in study.axes
    }
    return {
        "format": FORMAT,
        "dmframe": version(),
        "graphs": {name: resolved(base) for name, base in study.bases.items()},
        "sample": sample,
        "grid": grid,
        "measure": {
            "signals": list(file.measure.signals),
            "limits": {key: str(value) for key, value in file.measure.limits.items()},
        },
        "files": files_of(study),
    }


def _spread(spread: Spread | None) -> list[str] | None:
    if spread is None:
        return None
    return [spread.kind, *map(repr, (spread.a, spread.b, spread.lower, spread.upper))]


def key_of(identity: Mapping[str, Any]) -> str:
    """SHA-256 of an identity, in hexadecimal digits."""
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def files_of(study: Study) -> dict[str, str]:
    """Digest of each file that determines the dynamics: sources of blocks, models of robots."""
    found = dict[str, str]()
    for graph in graphs_of(study):
        for path in _paths(graph):
            found.setdefault(path.name, hashlib.sha256(path.read_bytes()).hexdigest())
    return dict(sorted(found.items()))


def graphs_of(study: Study) -> list[Graph]:
    """Graphs that together name all files: those of the study, and one per case with its own block or robot."""
    points = study.cases_that(lambda axis: any(label.split(".")[0] in ("blocks", "robot") for label in axis.labels))
    return [*study.bases.values(), *(point.graph for point in points)]


def _paths(graph: Graph) -> list[Path]:
    found = list(companions(graph).values())
    for block in graph.blocks.values():
        file = inspect.getsourcefile(type(block))
        if file is not None and Path(file).is_file():
            found.append(Path(file))
    source = robot_source(graph)
    if source is not None:
        found.append(source.urdf)
    return found
