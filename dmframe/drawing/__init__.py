"""Block diagrams of graphs, drawn from the diagram that runs."""

from dmframe.drawing.drawing import Drawing, check_ending
from dmframe.drawing.flowchart import mermaid
from dmframe.drawing.picture import svg

__all__ = ["Drawing", "check_ending", "mermaid", "svg"]
