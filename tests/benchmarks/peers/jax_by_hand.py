"""The loop in JAX: robot and controller in scalar code that XLA fuses, a `scan` over the samples."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer

CHUNK = 125


class Loop(Peer):
    """Compiled for a chunk of samples, so that another length of the run needs no compilation."""

    title: ClassVar[str] = "JAX, scalar code"
    package: ClassVar[str] = "jax"
    module: ClassVar[str] = "jax"
    note: ClassVar[str] = (
        "rigid-body code by hand in scalars without constant zeros, as XLA fuses best: an expert's work"
    )
    arrays: ClassVar[bool] = False

    def build(self) -> None:
        import jax
        import jax.numpy as jnp

        from tests.benchmarks.jax_loop import functions, integrated

        loop, n = self.loop, self.loop.n
        control, rate, self.z, self.x = functions(loop, arrays=self.arrays)
        gains = {key: jnp.asarray(value) for key, value in loop.gains.items()}
        substeps = loop.substeps(self.step)
        h = loop.T / substeps

        def tick(state: Any, k: Any) -> Any:
            z, x = state
            dq_c, z = control(k * loop.T, z, x, gains)
            x = integrated(rate, x, dq_c, h, substeps)
            return (z, x), x[2 * n : 3 * n]

        self.chunk = jax.jit(lambda state, k: jax.lax.scan(tick, state, k + jnp.arange(CHUNK, dtype=float)))

    def run(self, seconds: float) -> Array:
        ticks = self.loop.ticks(seconds)
        state, parts = (self.z, self.x), [self.loop.start["q"][None]]
        for first in range(0, ticks, CHUNK):
            state, q = self.chunk(state, float(first))
            parts.append(q)
        return np.concatenate(parts)[: ticks + 1]
