"""What a block's proof needs: conditions that numbers decide, and assumptions that nothing in a graph can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from dmframe.fields import check_fields

SX = Any
"""A CasADi expression; the library is untyped."""


@final
@dataclass(frozen=True)
class Inequality:
    """A condition: every element of `expression` is above zero (or not below, if not `strict`).

    `otherwise` is what to say where it fails, of one that the diagram itself must fulfil: the remedy, by name. The
    identity may need it, so that it is told of a diagram that is refuted too.
    """

    name: str
    expression: SX
    source: str
    strict: bool = True
    otherwise: str = ""

    def __post_init__(self) -> None:
        check_fields(self)


@final
@dataclass(frozen=True)
class CommonLyapunov:
    r"""A condition: :math:`\ddot z + a \dot z + b z = 0` is stable while a and b move anywhere in their boxes.

    It is enough that one P > 0 has :math:`A^\top P + P A < 0`, :math:`A = [[0, 1], [-b, -a]]`, at the four corners.
    `a` and `b` are (rows, 2): lower and upper ends, one row a joint.
    """

    name: str
    a: SX
    b: SX
    source: str

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
    """Something that a proof needs and that nobody can check from the graph."""

    text: str
    source: str = ""

    def __post_init__(self) -> None:
        check_fields(self)


Condition = Inequality | CommonLyapunov | Assumption
"""What a block's proof needs."""
