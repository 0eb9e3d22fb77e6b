"""The loop in Jaxonomy, the robot in arrays."""

from __future__ import annotations

from typing import ClassVar

from tests.benchmarks.peers import jaxonomy_blocks


class Loop(jaxonomy_blocks.Loop):
    """A direct first version."""

    title: ClassVar[str] = "Jaxonomy, arrays"
    note: ClassVar[str] = "the same functions as the row of JAX in arrays; without its compilation"
    arrays: ClassVar[bool] = True
