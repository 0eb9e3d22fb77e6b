"""Reading of graph files: from YAML text to a graph."""

from dmframe.config.graph import BaseGraph

__all__ = ["BaseGraph"]
