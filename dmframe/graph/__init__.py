"""Graphs: the objects that a program changes, runs, proves, analyses, draws and compares."""

from dmframe.graph.graph import Graph
from dmframe.graph.load import load
from dmframe.graph.runs import Runs, compare
from dmframe.graph.shelf import blocks, graphs, robots
from dmframe.graph.sweep import sweep

__all__ = ["Graph", "Runs", "blocks", "compare", "graphs", "load", "robots", "sweep"]
