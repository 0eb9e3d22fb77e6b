"""Functions that load a graph and call one of its methods: ``dm.run("ur10_fast")``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dmframe.graph.graph import Graph
from dmframe.graph.load import load

if TYPE_CHECKING:
    from dmframe.drawing import Drawing
    from dmframe.report.analysis import Analysis
    from dmframe.report.verification import Verification
    from dmframe.results.run import Run
    from dmframe.simulate.engine import Choice

Source = str | Path | Mapping[str, Any] | Graph
"""Arguments that `load` accepts."""


def run(source: Source, until: float | str | None = None, *, engine: Choice = "auto") -> Run:
    """Load a graph and call `Graph.run`."""
    return load(source).run(until, engine=engine)


def verify(source: Source, *, seed: int = 0) -> Verification:
    """Load a graph and call `Graph.verify`."""
    return load(source).verify(seed=seed)


def analyse(source: Source, horizon: float | str = 20.0) -> Analysis:
    """Load a graph and call `Graph.analyse`."""
    return load(source).analyse(horizon)


def draw(source: Source) -> Drawing:
    """Load a graph and call `Graph.draw`."""
    return load(source).draw()
