"""(c): one step of the controller, in C and from Python, compared with the Pinocchio calls that it replaces."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tests.benchmarks.loop import Loop
from tests.benchmarks.peers.cpp_pinocchio import Loop as Cpp
from tests.benchmarks.table import Row, Section
from tests.benchmarks.worker import Failed, measure

GRAPHS = {"ur10_fast": "3 joints", "ur10_full": "6 joints"}
STEPS = 100_000
CALLS = {
    "regressor": "C++ Pinocchio, computeJointTorqueRegressor",
    "polarised in 5": "C++ Pinocchio, Slotine-Li regressor in 5 calls",
    "polarised in 2": "C++ Pinocchio, Slotine-Li regressor in 2 calls",
    "controller": "C++ Pinocchio, the whole controller by hand",
}
OURS_C, OURS_PYTHON, NUMPY = "dmframe, C", "dmframe, from Python", "NumPy + Pinocchio, from Python"
NOTES = {
    OURS_C: "reference, kinematics, regressor, adaptation, inverse, recorded outputs and the check for finite numbers",
    OURS_PYTHON: "one call a step, in and out through arrays that are there already",
    "regressor": "a part of what the step does: q, dq, ddq only, no polarisation",
    "polarised in 5": "the regressor alone, by the five-call identity",
    "polarised in 2": "the regressor alone, by half sum and half difference, the second without gravity",
    "controller": "the same work",
    NUMPY: "the same work",
}


def in_c(graph: str) -> dict[str, Any]:
    """Seconds of a dmframe step in the compiled loop: a run without steps of the plant that records one column only."""
    from dmframe.graph.graph import Graph
    from dmframe.simulate import start_state
    from dmframe.simulate.engine import Compiled
    from dmframe.simulate.keep import Log
    from dmframe.simulate.run import prepare

    loaded = Graph.read(graph)
    diagram = loaded.diagram
    duration = STEPS * float(loaded.file.clock)
    prepared = prepare(diagram, duration, clock=loaded.file.clock, solver=loaded.solver, log=Log(every=duration))
    engine = prepared.engine("compiled")
    if not isinstance(engine, Compiled):
        raise Failed("; ".join(engine.notices) or "no compiled engine")
    engine = replace(engine, step=replace(prepared.step, substeps=0))
    start, p = start_state(diagram, loaded.start), diagram.loop.p_values
    rows = np.empty((2, engine.kept.size))
    plant = sum(variable.symbol.numel() for variable in diagram.loop.plant)

    def steps() -> None:
        state = start.copy()
        # Without motion of the robot the adaptation winds up: short runs from the start keep it in its usual range.
        for first in range(0, STEPS, 1000):
            state[:] = start
            done = engine.advance(state, p, first + 1, 1000, rows)
            if done != 1000:
                raise Failed(f"not finite after {done} steps")
        if not np.array_equal(state[-plant:], start[-plant:]):
            raise Failed("the plant moved")

    return {"seconds": fastest(steps) / STEPS}


def in_python(graph: str) -> dict[str, Any]:
    """Seconds of a dmframe step called from Python, as in a real-time loop."""
    from dmframe.graph.graph import Graph
    from dmframe.runtime import Controller

    loaded = Graph.read(graph)
    diagram = loaded.diagram
    controller = Controller(diagram, float(loaded.file.clock), start=loaded.start, engine="compiled")
    q = Loop.read(graph).start["q"]
    for label, array in controller.measured.items():
        if label in ("arm.q", "servo.q_c"):
            array[:] = q

    def steps() -> None:
        controller.reset()
        for k in range(1000):
            controller.step(1e-3 * k)

    return {"seconds": fastest(steps, 20) / 1000}


def by_numpy(graph: str) -> dict[str, Any]:
    """Seconds of a step of the NumPy controller."""
    from tests.benchmarks.controller import Controller

    loop = Loop.read(graph)
    law, q, dq, q_c = Controller(loop), loop.start["q"], loop.start["dq"], loop.start["q_c"]
    return {"seconds": fastest(lambda: [law.step(1e-3 * k, q, dq, q_c) for k in range(1000)]) / 1000}


def by_cpp(graph: str) -> dict[str, Any]:
    """Seconds of Pinocchio's calls in C++."""
    return Cpp(Loop.read(graph), 1e-3).calls(STEPS)


def fastest(work: Callable[[], Any], repeats: int = 5) -> float:
    """Seconds of the fastest repeat; the first one is discarded."""
    work()
    best = np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return float(best)


def section(limit: float, progress: Callable[[str], None] = lambda text: None) -> Section:
    """All rows, for each number of joints."""
    rows: list[Row] = []
    for graph, joints in GRAPHS.items():
        progress(f"(c) {graph}")
        times, faults = dict[str, float](), dict[str, str]()
        for name, job in ((OURS_C, "in_c"), (OURS_PYTHON, "in_python"), (NUMPY, "by_numpy")):
            try:
                times[name] = measure(f"controller_step:{job}", limit, graph=graph)["seconds"]
            except Failed as failure:
                faults[name] = f"failed: {failure}"
        try:
            lacking = Cpp.missing()
            times |= {} if lacking else measure("controller_step:by_cpp", limit, graph=graph)
            faults |= dict.fromkeys(CALLS, lacking) if lacking else {}
        except Failed as failure:
            faults |= dict.fromkeys(CALLS, f"failed: {failure}")
        rows += [row(joints, name, times, faults) for name in (OURS_C, *CALLS, OURS_PYTHON, NUMPY)]
    return Section(
        "c",
        "one controller step, one core",
        "how many times as long as dmframe's in C; of NumPy, as dmframe's from Python, where that is there",
        tuple(rows),
    )


def row(joints: str, name: str, times: dict[str, float], faults: dict[str, str]) -> Row:
    """One row."""
    title = f"{joints}: {CALLS.get(name, name)}"
    if name not in times:
        kind, _, why = faults[name].partition(": ")
        return Row("c", title, status="failed" if kind == "failed" else "missing", agreement=why, note=NOTES[name])
    against = times.get(OURS_PYTHON if name == NUMPY and OURS_PYTHON in times else OURS_C)
    ratio = None if name in (OURS_C, OURS_PYTHON) or against is None else times[name] / against
    return Row("c", title, times[name] * 1e6, "us", ratio, note=NOTES[name])
