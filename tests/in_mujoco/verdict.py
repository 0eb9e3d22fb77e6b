"""Tuned controllers of a verdict on the hidden robot in MuJoCo that recorded its log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dmframe.race.plan import Race, Run, Values
from tests.exported_controller import ExportedController
from tests.framework.identify.plants import QUANTUM
from tests.in_mujoco.plant import Plant
from tests.in_mujoco.servos import Array


def true_error(race: Race, law: str, path: str, values: Values, plant: Plant, late: float, folder: Path) -> float:
    """RMS of the tool's error over the last eighth of a run [mm]; the plant's delay is `late` [s]."""
    cell = next(cell for cell in race.held_out if cell.path == path)
    graph = race.graph(Run(law, replace(cell, plant="best_fit"), values, race.file.seed + 1))
    made = {file.stem: file for file in graph.export(folder / law) if file.suffix == ".c"}
    controller = ExportedController(made[graph.name], folder)
    labels = [leaf.name for leaf in graph.diagram.loop.measured]
    start = np.asarray(graph.run(2 * float(graph.clock), progress=False).recording["arm.q"][0])
    T, tick = float(graph.clock), 0.002
    waiting, before, last = [np.zeros(len(start))] * round(late / tick), start, np.zeros(len(start))
    seconds = round(race.file.duration / T) * T

    def command(measured: dict[str, Array], t: float) -> Array:
        nonlocal before, last
        if round(t / tick) % round(T / tick) == 0:
            q = np.round(measured["arm.q"] / QUANTUM) * QUANTUM
            x = controller.tool(q)
            signals = {"encoder.q_m": q, "encoder.x_m": x, "encoder.dq_m": (q - before) / T, **measured}
            given, before = np.concatenate([signals[label] for label in labels]), q
            assert t > 0 or controller.reset(given, t)
            commanded = controller.step(given, t)
            assert commanded is not None
            last = commanded
        waiting.append(last)
        return waiting.pop(0)

    motion = plant.run(command, start, tick, seconds)
    every = slice(None, None, round(T / tick))
    size = 1e3 * np.linalg.norm(motion.x[every] - points(race.file.paths[path].parameters, motion.time[every]), axis=1)
    return float(np.sqrt(np.mean(size[-(size.size // 8) :] ** 2)))


def points(path: dict[str, Any], t: Array) -> Array:
    """The path by hand, (len(t), 3) [m]."""
    found = np.tile(np.asarray(path["center"], dtype=float), (len(t), 1))
    first, second = ("xyz".index(axis) for axis in path["plane"])
    circles: Sequence[tuple[float, float, float]] = list(zip(path["radius"], path["rate"], path["phase"], strict=True))
    for radius, rate, phase in circles:
        found[:, first] += radius * np.cos(rate * t + phase)
        found[:, second] += radius * np.sin(rate * t + phase)
    return found
