"""The loop in NumPy on Pinocchio's Python bindings: a `for` loop and a hand-written RK4."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """Without a simulation framework."""

    title: ClassVar[str] = "NumPy + Pinocchio"
    package: ClassVar[str] = "pin"
    module: ClassVar[str] = "pinocchio"

    def build(self) -> None:
        from tests.benchmarks.controller import Controller, Plant

        self.controller, self.plant = Controller(self.loop), Plant(self.loop)

    def run(self, seconds: float) -> Array:
        loop, n, rate = self.loop, self.loop.n, self.plant.rate
        self.controller.reset()
        x, ticks, substeps = self.plant.start.copy(), loop.ticks(seconds), loop.substeps(self.step)
        h = loop.T / substeps
        q = np.empty((ticks + 1, n))
        q[0] = x[2 * n : 3 * n]
        for k in range(ticks):
            dq_c = self.controller.step(k * loop.T, x[2 * n : 3 * n], x[3 * n :], x[:n])
            for _ in range(substeps):
                k1 = rate(x, dq_c)
                k2 = rate(x + h / 2 * k1, dq_c)
                k3 = rate(x + h / 2 * k2, dq_c)
                k4 = rate(x + h * k3, dq_c)
                x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
            q[k + 1] = x[2 * n : 3 * n]
        return q
