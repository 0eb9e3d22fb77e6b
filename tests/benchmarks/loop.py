"""The closed loop that every tool simulates, read from a packaged graph: numbers only, independent of the engine.

The loop is that of ``ur10_fast`` and ``ur10_full``: a tool that follows a circle, the Slotine-Li regressor with viscous
and Coulomb friction, gradient adaptation, the inverse of a PID servo; sampled, with the servo and the robot continuous.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATES = {
    "a_d_hat": "dynamics.a_d_hat",
    "q_r": "inverse.q_r",
    "z": "inverse.z",
    "w": "inverse.w",
    "w_P": "inverse.w_P",
    "w_I": "inverse.w_I",
    "q_c": "servo.q_c",
    "i": "servo.i",
    "q": "arm.q",
    "dq": "arm.dq",
}


TIMED = {"ur10_full": ("blocks.posture=null", "dynamics.Gamma=100", "dynamics.a_d_hat_box=null")}
"""Parts of a packaged graph that are removed or changed before the comparison: the other tools have no posture task."""


@dataclass(frozen=True)
class Loop:
    """One closed loop.

    Attributes
    ----------
    graph : the graph's name
    model, tool : the reduced `pin.Model`, and its tool frame
    v_0 : rad/s, where smooth Coulomb friction reaches tanh(1)
    T, duration : s
    center, radius, rate : the circle in the xy plane; m, m, rad/s
    gains : K_c, Lambda, Lambda_P, Lambda_I, Gamma, gamma of the controller
    K_D, K_P, K_I, B, D : the servo and the joints' friction
    boxes : lower and upper ends of a_d_hat, w, w_P, w_I; infinite where there are none
    start : every state at t = 0
    """

    graph: str
    model: Any
    tool: int
    v_0: float
    T: float
    duration: float
    center: Array
    radius: float
    rate: float
    gains: dict[str, Array]
    K_D: Array
    K_P: Array
    K_I: Array
    B: Array
    D: Array
    boxes: dict[str, tuple[Array, Array]]
    start: dict[str, Array]

    @property
    def n(self) -> int:
        """The number of joints."""
        return int(self.model.nv)

    @cached_property
    def links(self) -> list[dict[str, Array]]:
        """For each joint: rotation R and translation r from its parent, axis, mass m, lever c, inertia I about c."""
        from dmframe.robot.reduction import motion_subspace

        found = []
        for j in range(1, self.n + 1):
            place, body = self.model.jointPlacements[j], self.model.inertias[j]
            axis = motion_subspace(self.model.joints[j])[3:]
            found.append(
                {
                    "R": np.array(place.rotation),
                    "r": np.array(place.translation),
                    "axis": axis,
                    "m": np.array([body.mass]),
                    "c": np.array(body.lever),
                    "I": np.array(body.inertia),
                }
            )
        return found

    @cached_property
    def point(self) -> Array:
        """The tool point in the last link's frame [m]."""
        return np.array(self.model.frames[self.tool].placement.translation)

    def ticks(self, seconds: float) -> int:
        """Number of sampling instants in a time."""
        return round(seconds / self.T)

    def substeps(self, step: float) -> int:
        """Equal integrator steps of at most `step` [s] in a sample."""
        return max(1, int(np.ceil(round(self.T / step, 9))))

    def desired(self, t: float) -> tuple[Array, Array, Array]:
        """The path and its first two derivatives."""
        s, c, r, w = np.sin(self.rate * t), np.cos(self.rate * t), self.radius, self.rate
        x_d = self.center + np.array([r * s, r * c, 0.0])
        return x_d, np.array([r * w * c, -r * w * s, 0.0]), np.array([-r * w * w * s, -r * w * w * c, 0.0])

    @classmethod
    def read(cls, name: str | Path) -> Loop:
        """The loop of a packaged graph."""
        from dmframe.graph.graph import Graph
        from dmframe.simulate import start_state

        graph = Graph.read(name, TIMED.get(str(name), ()))
        diagram = graph.diagram
        values = {leaf.label: np.asarray(leaf.value, dtype=float) for leaf in diagram.loop.parameters}
        n = diagram.robot.n

        def joints(label: str) -> Array:
            return np.broadcast_to(values[label], (n,)).copy()

        def box(name: str) -> tuple[Array, Array]:
            ends, size = values.get(f"{STATES[name]}_box"), start[name].size
            if ends is None:
                return np.full(size, -np.inf), np.full(size, np.inf)
            return ends[:, 0].copy(), ends[:, 1].copy()

        column, start, first = start_state(diagram, graph.start), {}, 0
        labels = {label: key for key, label in STATES.items()}
        for variable in diagram.loop.variables:
            size = variable.symbol.numel()
            start[labels[variable.label]] = column[first : first + size].copy()
            first += size
        gains = {key: joints(f"inverse.{key}") for key in ("K_c", "Lambda", "Lambda_P", "Lambda_I")}
        gains["Gamma"] = np.broadcast_to(values["dynamics.Gamma"], (start["a_d_hat"].size,)).copy()
        gains["gamma"] = values["task.gamma"]
        return cls(
            graph=str(name),
            model=diagram.robot.model,
            tool=diagram.robot.model_tool,
            v_0=diagram.robot.friction_velocity,
            T=float(graph.file.clock),
            duration=float(graph.file.duration),
            center=values["path.center"],
            radius=float(values["path.radius"]),
            rate=float(values["path.rate"]),
            gains=gains,
            K_D=joints("servo.K_D"),
            K_P=joints("servo.K_P"),
            K_I=joints("servo.K_I"),
            B=joints("arm.viscous"),
            D=joints("arm.coulomb"),
            boxes={key: box(key) for key in ("a_d_hat", "w", "w_P", "w_I")},
            start=start,
        )
