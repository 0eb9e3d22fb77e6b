"""A graph's methods as functions, for a program of one line: ``dm.run("ur10_fast")``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dmframe.graph.graph import Graph
from dmframe.graph.load import load

if TYPE_CHECKING:
    from dmframe.drawing import Drawing
    from dmframe.report import Analysis, Verification
    from dmframe.results.run import Run
    from dmframe.simulate.engine import Choice

Source = str | Path | Mapping[str, Any] | Graph
"""What `load` takes."""


def run(source: Source, until: float | str | None = None, *, engine: Choice = "auto") -> Run:
    """`Graph.run` of a graph that is loaded for it."""
    return load(source).run(until, engine=engine)


def verify(source: Source, *, seed: int = 0) -> Verification:
    """`Graph.verify` of a graph that is loaded for it."""
    return load(source).verify(seed=seed)


def analyse(source: Source, horizon: float | str = 20.0) -> Analysis:
    """`Graph.analyse` of a graph that is loaded for it."""
    return load(source).analyse(horizon)


def draw(source: Source) -> Drawing:
    """`Graph.draw` of a graph that is loaded for it."""
    return load(source).draw()
