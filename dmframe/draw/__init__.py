"""The picture of a diagram, from the same object that runs."""

from dmframe.draw.flowchart import mermaid
from dmframe.draw.picture import svg

__all__ = ["mermaid", "svg"]
