"""Base of the objects that are about one graph: a run, a verification, an analysis, an explanation, a page."""

from __future__ import annotations

import warnings

from dmframe.config.graph import BaseGraph
from dmframe.diagram import Diagram


class AboutGraph:
    """An object about a graph."""

    graph: BaseGraph

    @property
    def name(self) -> str:
        """The graph's name."""
        return self.graph.name

    @property
    def diagram(self) -> Diagram:
        """The graph's closed loop."""
        return self.graph.diagram

    @property
    def experiment(self) -> BaseGraph:
        """Former name of `graph`, with a notice."""
        what = type(self).__name__.lower()
        warnings.warn(f"{what}.experiment is now {what}.graph", DeprecationWarning, stacklevel=2)
        return self.graph
