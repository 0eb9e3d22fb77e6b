"""The loop in bdsim: a continuous block for servo and robot, a sampled one for the controller."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer

TOLERANCE = 1e-6


class Loop(Peer):
    """Two blocks."""

    title: ClassVar[str] = "bdsim"
    package: ClassVar[str] = "bdsim"
    module: ClassVar[str] = "bdsim"
    method: ClassVar[str] = f"SciPy's RK45, relative tolerance {TOLERANCE:g}"
    note: ClassVar[str] = (
        "has SciPy's solvers only, with variable step, started afresh at each sample; right-hand side and controller "
        "are NumPy on Pinocchio"
    )

    def build(self) -> None:
        from tests.benchmarks.controller import Controller, Plant

        self.law, self.plant = Controller(self.loop), Plant(self.loop)

    def run(self, seconds: float) -> Array:
        import bdsim
        from bdsim.block_types import ContinuousBlock, SampledBlock

        loop, n, law, plant = self.loop, self.loop.n, self.law, self.plant
        law.reset()
        ticks = loop.ticks(seconds)
        found = np.full((ticks + 1, n), np.nan)

        class Robot(ContinuousBlock):  # type: ignore[misc]
            nin, nout = 1, 1

            def __init__(self, **options: Any) -> None:
                super().__init__(nstates=4 * n, **options)
                self._x0 = plant.start.copy()

            def output(self, t: float, u: list[Any], x: Array) -> list[Any]:
                return [x]

            def deriv(self, t: float, u: list[Any], x: Array) -> Array:
                return plant.rate(x, u[0])

        class Sampled(SampledBlock):  # type: ignore[misc]
            nin, nout = 1, 1

            def output(self, t: float, u: list[Any], x: Array) -> list[Any]:
                return [x]

            def next(self, t: float, u: list[Any], x: Array) -> Array:
                k, state = round(t / loop.T), np.asarray(u[0])
                if k <= ticks:
                    found[k] = state[2 * n : 3 * n]
                return law.step(k * loop.T, state[2 * n : 3 * n], state[3 * n :], state[:n])

        simulator = bdsim.BDSim(banner=False, quiet=True, graphics=False, animation=False, progress=False)
        diagram = simulator.blockdiagram()
        clock = diagram.clock(loop.T, unit="s")
        # The clock's first sample is at T, so the command from t = 0 on is the block's initial value.
        first = law.step(0.0, loop.start["q"], loop.start["dq"], loop.start["q_c"])
        found[0] = loop.start["q"]
        robot, sampled = Robot(), Sampled(clock=clock, x0=first)
        diagram.add_block(robot)
        diagram.add_block(sampled)
        diagram.connect(robot, sampled)
        diagram.connect(sampled, robot)
        diagram.compile(report=False)
        end = simulator.run(
            diagram, T=ticks * loop.T, solver="RK45", solver_args={"rtol": TOLERANCE, "atol": TOLERANCE * 1e-3}
        )
        found[-1] = end.x[-1, 2 * n : 3 * n]
        return found
