from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dmframe.graph.graph import Graph
from dmframe.results.run import Run
from dmframe.simulate import Divergence, Recording, simulate


def result(name, duration, *overrides):
    graph = Graph.read(name, overrides).until(duration)
    file = graph.file
    run = simulate(graph.diagram, duration, clock=file.clock, solver=graph.solver, start=graph.start)
    return Run(graph, run)


def blown_up(run: Recording, time: float) -> Recording:
    """The run as if it had left the finite numbers at `time`, its last sample near the largest double."""
    count = int(np.searchsorted(run.time, time))
    states = {label: rows[:count].copy() for label, rows in run.states.items()}
    outputs = {label: rows[:count].copy() for label, rows in run.outputs.items()}
    for rows in (*states.values(), *(outputs[label] for label in outputs if not label.startswith("path."))):
        rows[-1] = 1e305
    where = Divergence("arm", "q", 0, float(run.time[count]))
    return replace(run, time=run.time[:count], states=states, outputs=outputs, divergence=where)


@pytest.fixture(scope="session")
def ur10():
    return result("ur10_fast", 1.0)


@pytest.fixture(scope="session")
def kinematic():
    return result("ur10_fast_kinematic", 1.0)


@pytest.fixture(scope="session")
def pendulum():
    return result("pendulum", 0.5)


@pytest.fixture(scope="session")
def arm2():
    return result("arm2_joint", 0.5)


@pytest.fixture(scope="session")
def planar():
    """A task in a plane, m = 2."""
    overrides = [
        "robot.axes=xy",
        "path.center=[-0.07, 0.67]",
        "start={near: [1.46, -1.02, 0.98]}",
    ]
    return result("ur10_fast_kinematic", 1.0, *overrides)


@pytest.fixture(scope="session")
def make_result():
    return result


@pytest.fixture(scope="session")
def blow_up():
    return blown_up
