"""The aggregation with a robot's channel in MuJoCo: delay, ramp and encoder by hand; the error is that of `run`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from tests.exported_controller import ExportedController
from tests.in_mujoco.closed_loop import error, plant_of
from tests.in_mujoco.plant import needs_mujoco
from tests.in_mujoco.servos import Array, Cascade, Servo

pytestmark = needs_mujoco

STEP = 47.94e-6  # [rad] of a 17-bit encoder
ACCELERATION, LAG = 1.4, 0.008  # [rad/s^2], [s] of the ramp
STIFF = {"k_p": 20, "K_v": [800, 800, 400], "K_i": [8000, 8000, 4000], "velocity_filter": "2 ms", "torque_lag": "1 ms"}
WANDER = {
    "path": {
        "type": "epicycles",
        "center": [-0.4, 0.5, 0.5],
        "radius": [0.06, 0.04, 0.03, 0.02],
        "rate": [0.5, -0.809017, 1.161895, -1.51486],
        "phase": [0, 1, 2, 3],
    },
    "start": {"near": [2.02, -1.17, 1.34]},
}
CASES: dict[str, tuple[str, float, bool, dict[str, Any]]] = {
    "90 ms, ur, never repeats": ("ur10_slow_best", 200.0, True, WANDER),
    "90 ms, stiff cascade": ("ur10_slow_best", 200.0, False, {"servo": {"type": "p_pi_servo", **STIFF}}),
    "8 ms, ur": ("ur10_fast_best", 100.0, True, {}),
}


@dataclass(frozen=True)
class Ramped(Servo):
    """A servo with a ramp: its command follows the sent one, with a lag and a limited acceleration."""

    inner: Servo

    @property
    def rows(self) -> int:  # type: ignore[override]
        """One more than the servo."""
        return self.inner.rows + 1

    def start(self, q: Array, held: Array) -> Array:
        return np.vstack([self.inner.start(q, held), 0 * q])

    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        tau, rates = self.inner.law(q, dq, x[:-1], x[-1])
        return tau, [*rates, np.clip((dq_c - x[-1]) / LAG, -ACCELERATION, ACCELERATION)]


def in_mujoco(graph: Any, channel: bool, seconds: float, folder: Path) -> Array:
    """Positions of the tool at the samples, with the exported controller."""
    made = {file.stem: file for file in graph.export(folder / "made") if file.suffix == ".c"}
    controller = ExportedController(made[graph.name], folder)
    labels = [leaf.name for leaf in graph.diagram.loop.measured]
    changes = {
        "servo": Cascade(np.full(3, 20.0), *(np.array(STIFF[k], dtype=float) for k in ("K_v", "K_i")), 1, 2e-3, 1e-3)
    }
    plant = plant_of(graph, **({} if graph.blocks.facts["servo"]["type"] == "pid_servo" else changes))
    if channel:
        plant = plant_of(graph, servo=Ramped(plant.servo))
    T, waiting = float(graph.clock), [np.zeros(3)]
    start = np.asarray(graph.run(2 * T, progress=False).recording["arm.q"][0])

    def command(measured: dict[str, Array], t: float) -> Array:
        if channel:
            q = STEP * np.floor(measured["arm.q"] / STEP + 0.5)
            measured = {**measured, "encoder.q_m": q, "encoder.x_m": controller.tool(q)}
        given = np.concatenate([measured[label] for label in labels])
        assert t > 0 or controller.reset(given, t)
        commanded = controller.step(given, t)
        assert commanded is not None
        waiting.append(commanded)
        return waiting.pop(0) if channel else waiting.pop()

    return plant.run(command, list(start), T, seconds).x


@pytest.mark.parametrize("case", CASES)
def test_its_error_is_that_of_a_run_within_a_tenth(case: str, tmp_path: Path) -> None:
    name, seconds, channel, settings = CASES[case]
    graph = dm.load(name).set({**settings, **({"reality": "ur"} if channel else {})})
    run = graph.run(seconds, progress=False).recording
    expected = error(run["arm.x"], run["path.x_d"])
    assert 0.005 < expected < 0.06
    assert error(in_mujoco(graph, channel, seconds, tmp_path), run["path.x_d"]) == pytest.approx(expected, rel=0.1)
