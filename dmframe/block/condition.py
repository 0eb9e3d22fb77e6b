"""Conditions of a block's proof: inequalities that values decide, and assumptions that a graph cannot decide.

The texts are plain text; a text with formulas is a `dmframe.common.text.sentence`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from dmframe.block.fields import check_fields
from dmframe.common.text import Text

SX = Any
"""A CasADi expression; the library is untyped."""


@final
@dataclass(frozen=True)
class Inequality:
    """A condition: every element of `expression` is > 0 (>= 0 if not `strict`).

    `otherwise` is the message for a condition on the diagram itself: it names the remedy. The identity may depend on
    such a condition, so the message is also printed for a refuted diagram.
    """

    name: Text | str
    expression: SX
    source: Text | str
    strict: bool = True
    otherwise: Text | str = ""

    def __post_init__(self) -> None:
        check_fields(self)


@final
@dataclass(frozen=True)
class CommonLyapunov:
    r"""A condition: :math:`\ddot z + a \dot z + b z = 0` is stable for arbitrary motions of a and b in their boxes.

    It is sufficient that one P > 0 satisfies :math:`A^\top P + P A < 0`, :math:`A = [[0, 1], [-b, -a]]`, at the four
    corners. `a` and `b` are (rows, 2): lower and upper bounds, one row per joint.
    """

    name: Text | str
    a: SX
    b: SX
    source: Text | str

    def __post_init__(self) -> None:
        check_fields(self)
        for name, box in (("a", self.a), ("b", self.b)):
            if box.shape[0] < 1 or box.shape[1] != 2 or box.shape != self.a.shape:
                rows = self.a.shape[0] or "one or more"
                size = " x ".join(map(str, box.shape))
                raise TypeError(
                    f"CommonLyapunov {self.name!r}: expected {name} with {rows} rows of 2 numbers, a lower and an "
                    f"upper end, one row a joint, as many in a as in b; found {size}"
                )


@final
@dataclass(frozen=True)
class Assumption:
    """A fact that a proof uses and that cannot be checked from the graph."""

    text: Text | str
    source: Text | str = ""

    def __post_init__(self) -> None:
        check_fields(self)


Condition = Inequality | CommonLyapunov | Assumption
"""A condition or an assumption of a block's proof."""
