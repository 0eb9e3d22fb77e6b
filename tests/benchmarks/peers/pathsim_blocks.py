"""The loop in PathSim: an ODE block for servo and robot, a Wrapper for the sampled controller."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """Two blocks and a scope."""

    title: ClassVar[str] = "PathSim"
    package: ClassVar[str] = "pathsim"
    module: ClassVar[str] = "pathsim"
    note: ClassVar[str] = "has no robots: right-hand side and controller are NumPy on Pinocchio"

    def build(self) -> None:
        from tests.benchmarks.controller import Controller, Plant

        self.law, self.plant = Controller(self.loop), Plant(self.loop)

    def run(self, seconds: float) -> Array:
        from pathsim import Connection, Simulation
        from pathsim.blocks import ODE, Wrapper
        from pathsim.solvers import RK4

        loop, n, law, k = self.loop, self.loop.n, self.law, 0
        law.reset()
        ticks = loop.ticks(seconds)
        found = np.full((ticks + 1, n), np.nan)

        def control(*x: float) -> Array:
            nonlocal k
            state = np.array(x)
            if k <= ticks:
                found[k] = state[2 * n : 3 * n]
            dq_c = law.step(k * loop.T, state[2 * n : 3 * n], state[3 * n :], state[:n])
            k += 1
            return dq_c

        robot = ODE(lambda x, u, t: self.plant.rate(x, u), self.plant.start.copy())
        sampled = Wrapper(control, T=loop.T)
        simulation = Simulation(
            [robot, sampled],
            [Connection(robot[: 4 * n], sampled[: 4 * n]), Connection(sampled[:n], robot[:n])],
            dt=loop.T / loop.substeps(self.step),
            Solver=RK4,
            log=False,
        )
        simulation.run(ticks * loop.T)
        if k <= ticks:
            found[ticks] = robot.engine.state[2 * n : 3 * n]
        return found
