"""(g): a stiff loop with each method: its speed, and the distance of its joint angles from cvodes at 1e-12."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from tests.benchmarks.table import Row, Section

GRAPH = "panda_full"
FRICTION = "arm.coulomb=[6, 6, 6, 6, 1.3, 1.3, 1.34]"
"""With v_0 = 5 mrad/s, h |lambda| is 46 for steps of 1 ms."""

REPEATS = 3


class Way(NamedTuple):
    """A method with its step [s] or its tolerance, and its engine."""

    name: str
    method: Any
    step: float | None
    tolerance: float = 1e-9

    @property
    def engine(self) -> Any:
        return "interpreted" if self.method == "cvodes" else "compiled"


OURS = Way("ros34pw2, 500 µs", "ros34pw2", 5e-4)
EXACT = Way("cvodes, 1e-12", "cvodes", None, 1e-12)
WAYS = (
    OURS,
    Way("ros34pw2, 2 ms", "ros34pw2", 2e-3),
    Way("ros34pw2, 1 ms", "ros34pw2", 1e-3),
    Way("ros34pw2, 250 µs", "ros34pw2", 2.5e-4),
    Way("rk4, 1 ms", "rk4", 1e-3),
    Way("rk4, 48 µs", "rk4", 4.8e-5),
    Way("cvodes, 1e-6", "cvodes", None, 1e-6),
    Way("cvodes, 1e-9", "cvodes", None, 1e-9),
)


def section(seconds: float = 4.0, progress: Callable[[str], None] = lambda text: None) -> Section:
    """One loop with all methods, in one process."""
    from dmframe.graph.graph import Graph
    from dmframe.simulate import Recording, Solver, simulate

    graph = Graph.read(GRAPH, [FRICTION])
    diagram = graph.diagram

    def run(way: Way) -> Recording:
        progress(f"(g) {way.name}")
        solver = Solver(way.method, way.step, tolerance=way.tolerance)
        given: dict[str, Any] = {"clock": graph.file.clock, "solver": solver, "start": graph.start}
        runs = [
            simulate(diagram, seconds, engine=way.engine, **given)
            for _ in range(1 if way.engine == "interpreted" else REPEATS)
        ]
        return min(runs, key=lambda run: run.wall_time)

    exact, found = run(EXACT), {way: run(way) for way in WAYS}
    rows = list[Row]()
    for way, one in found.items():
        error = float(np.max(np.abs(one["arm.q"] - exact["arm.q"])))
        ratio = None if way is OURS else one.wall_time / found[OURS].wall_time
        rows.append(
            Row(
                "g", way.name, one.real_time_factor, "x real time", ratio, agreement=f"{error:.1e} rad", note=one.engine
            )
        )
    return Section(
        "g",
        f"{GRAPH} with Coulomb friction, v_0 = 5 mrad/s, {seconds:g} s: at 1 ms h |lambda| is 46",
        f"how many times as fast {OURS.name} is",
        tuple(rows),
        (
            "Agreement: the largest difference of a joint angle from cvodes at a tolerance of 1e-12. rk4 at 1 ms is "
            "unstable: friction is bounded, so that it chatters, and does not diverge.",
        ),
    )
