"""The picture of a diagram, from the same object that runs."""

from dmframe.draw.mermaid import mermaid
from dmframe.draw.svg import svg

__all__ = ["mermaid", "svg"]
