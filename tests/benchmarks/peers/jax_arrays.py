"""The loop in JAX: robot and controller in arrays, a `scan` over the samples."""

from __future__ import annotations

from typing import ClassVar

from tests.benchmarks.peers import jax_by_hand


class Loop(jax_by_hand.Loop):
    """A direct first version."""

    title: ClassVar[str] = "JAX, arrays"
    note: ClassVar[str] = "rigid-body code by hand in 3 x 3 matrices, as one writes it first"
    arrays: ClassVar[bool] = True
