"""Shared code of the tests of drivers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import dmframe as dm
from dmframe.runtime.driving import DriveResult, Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.robot import Robot, Sample
from dmframe.runtime.scaled import ScaledController
from dmframe.runtime.simulated import SimulatedRobot


def limits(graph: dm.Graph, **changed: Any) -> Limits:
    joints = graph.robot.joints
    columns = [np.array([getattr(joint, key) for joint in joints]) for key in ("lower", "upper", "velocity")]
    return replace(Limits([joint.name for joint in joints], *columns), **changed)


def simulated(graph: dm.Graph, engine: Any = "interpreted", **options: Any) -> SimulatedRobot:
    file, settings = graph.file, graph.settings
    own = {key: settings[key] for key in ("start", "solver", "seed", "jitter")}
    assert graph.clock is not None
    return SimulatedRobot(graph.diagram, graph.clock, **{"duration": file.duration, "engine": engine, **own, **options})


def driven(
    graph: dm.Graph,
    robot: Robot,
    ticks: int,
    *,
    engine: Any = "interpreted",
    stop_requested: Any = lambda: "",
    held: Limits | None = None,
    **plan: Any,
) -> DriveResult:
    assert graph.clock is not None
    scaled = ScaledController(graph.diagram, graph.controller(engine=engine))
    gate = Gate(held or limits(graph), graph.clock)
    return drive(scaled, robot, gate, Plan(ticks * graph.clock, **plan), stop_requested)


class Script:
    """A robot that answers at once with samples from a list, and records its calls."""

    name, period = "script", 0.008

    def __init__(self, samples: Sequence[Sample | BaseException]) -> None:
        self.samples, self.calls = list(samples), list[Any]()

    def connect(self) -> None:
        self.calls.append("connect")

    def read(self) -> Sample:
        sample = self.samples.pop(0)
        if isinstance(sample, BaseException):
            raise sample
        self.last = sample
        return sample

    def begin(self) -> None:
        self.samples.insert(0, self.last)

    def command(self, dq: np.ndarray) -> None:
        self.calls.append(dq.copy())

    def move(self, q: np.ndarray, speed: float, acceleration: float, watched: Callable[[Sample], bool]) -> None:
        self.calls.append(("move", q.tolist()))

    def stop(self, deceleration: float) -> None:
        self.calls.append(("stop", deceleration))

    def close(self) -> None:
        self.calls.append("close")
