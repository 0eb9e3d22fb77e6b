"""Diagrams: blocks are wired, checked, and flattened to one closed loop."""

from dmframe.diagram.closed_loop import ClosedLoop, Parameter, Variable
from dmframe.diagram.diagram import Diagram

__all__ = ["ClosedLoop", "Diagram", "Parameter", "Variable"]
