"""A formula in three dialects: code, LaTeX, Unicode."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

from dmframe.formula.dialects import LATEX, TEXT, UNICODE
from dmframe.formula.tree import Node


@final
@dataclass(frozen=True)
class Formula:
    """One formula in three dialects; each is written at first use."""

    node: Node

    @cached_property
    def text(self) -> str:
        """In the code's names: ``J_hat'(x_o - x)/2 + s/beta``."""
        return TEXT.write(self.node)

    @cached_property
    def latex(self) -> str:
        """As LaTeX, without dollar signs."""
        return LATEX.write(self.node)

    @cached_property
    def unicode(self) -> str:
        """For a terminal or a drawing: ``ẇ = −Λ τ_dc σ``."""
        return UNICODE.write(self.node)

    def __str__(self) -> str:
        return self.text
