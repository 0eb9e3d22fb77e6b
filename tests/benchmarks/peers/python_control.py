"""The loop in python-control: two discrete-time NonlinearIOSystems, interconnected."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """It has no sampled controllers for continuous plants, so the plant's update is our RK4 over one period."""

    title: ClassVar[str] = "python-control"
    package: ClassVar[str] = "control"
    module: ClassVar[str] = "control"
    note: ClassVar[str] = (
        "has no hybrid systems: the plant is a discrete one with a hand-written RK4; right-hand side and controller "
        "are NumPy on Pinocchio"
    )

    def build(self) -> None:
        import control as ct

        from tests.benchmarks.controller import STATES, Controller, Plant

        loop, n, law, plant = self.loop, self.loop.n, Controller(self.loop), Plant(self.loop)
        substeps = loop.substeps(self.step)
        h = loop.T / substeps
        sizes = np.cumsum([loop.start[name].size for name in STATES])
        last: dict[str, Any] = {}

        def load(t: float, z: Array, y: Array) -> Array:
            """Output and next state; python-control's two calls at an instant share one computation."""
            if last.get("t") != t or not np.array_equal(last["z"], z) or not np.array_equal(last["y"], y):
                for name, part in zip(STATES, np.split(z, sizes[:-1]), strict=True):
                    setattr(law, name, part)
                dq_c = law.step(t, y[2 * n : 3 * n], y[3 * n :], y[:n])
                after = np.concatenate([getattr(law, name) for name in STATES])
                last.update(t=t, z=z.copy(), y=y.copy(), dq_c=dq_c, after=after)
            return np.concatenate([last["dq_c"], last["after"]])

        def advance(t: float, x: Array, u: Array, _: Any) -> Array:
            for _ in range(substeps):
                k1 = plant.rate(x, u)
                k2 = plant.rate(x + h / 2 * k1, u)
                k3 = plant.rate(x + h / 2 * k2, u)
                k4 = plant.rate(x + h * k3, u)
                x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
            return x

        labels = [f"x[{j}]" for j in range(4 * n)]
        robot = ct.nlsys(advance, None, inputs=n, outputs=labels, states=4 * n, dt=loop.T, name="robot")
        controller = ct.nlsys(
            lambda t, z, y, _: load(t, z, y)[n:],
            lambda t, z, y, _: load(t, z, y)[:n],
            inputs=4 * n,
            outputs=n,
            states=int(sizes[-1]),
            dt=loop.T,
            name="controller",
        )
        self.system = ct.InterconnectedSystem(
            [robot, controller],
            connections=[
                *([f"robot.u[{j}]", f"controller.y[{j}]"] for j in range(n)),
                *([f"controller.u[{j}]", f"robot.{label}"] for j, label in enumerate(labels)),
            ],
            inplist=[],
            inputs=0,
            outlist=[f"robot.x[{2 * n + j}]" for j in range(n)],
            outputs=n,
            dt=loop.T,
        )
        self.start = np.concatenate([plant.start, *(loop.start[name] for name in STATES)])

    def run(self, seconds: float) -> Array:
        import control as ct

        times = np.arange(self.loop.ticks(seconds) + 1) * self.loop.T
        found = ct.input_output_response(self.system, times, 0, self.start)
        return np.asarray(found.outputs).reshape(self.loop.n, -1).T
