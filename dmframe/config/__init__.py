"""From the text of a graph file to checked data."""

from dmframe.config.graph import Graph, load_graph

__all__ = ["Graph", "load_graph"]
