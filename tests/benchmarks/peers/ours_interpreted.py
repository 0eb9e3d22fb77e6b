"""dmframe, with CasADi's virtual machine."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

from tests.benchmarks.loop import TIMED, Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """The graph itself."""

    title: ClassVar[str] = "dmframe, interpreted"
    package: ClassVar[str] = "dmframe"
    note: ClassVar[str] = "keeps the joint angles, as the others, and the error"
    engine: ClassVar[Literal["interpreted", "compiled"]] = "interpreted"

    def build(self) -> None:
        from dmframe.graph.graph import Graph

        self.graph = Graph.read(self.loop.graph, TIMED.get(self.loop.graph, ()))
        self.diagram = self.graph.diagram
        self.wall: float | None = None

    def run(self, seconds: float) -> Array:
        from dmframe.simulate import Log, simulate

        solver = replace(self.graph.solver, step=self.step)
        found = simulate(
            self.diagram,
            seconds,
            clock=self.graph.file.clock,
            solver=solver,
            start=self.graph.start,
            engine=self.engine,
            log=Log(signals=("arm.q",)),
        )
        if found.engine != self.engine:
            raise RuntimeError(f"expected the engine {self.engine}, found {found.engine}")
        self.wall = found.wall_time
        q: Array = found["arm.q"]
        return q
