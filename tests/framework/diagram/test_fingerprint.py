"""The fingerprint of a closed loop: equal for equal loops, and different for all others."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import casadi as ca
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.catalogue import find_graph
from dmframe.certify import verify
from dmframe.certify.summary import summary
from dmframe.common.errors import BlockError, DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.graph.graph import Graph
from dmframe.results.folder import write_run
from dmframe.results.run import Run
from dmframe.simulate import simulate


class Decay(AbstractBlock):
    """dy = -c y^k, with a constant and a structure chosen by the test."""

    states = (State("y"),)
    rate: Scalar = Positive(default=1.0)
    y: Scalar = Real(default=1.0)
    constant: float = 1.0
    twice: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        rate = -self.constant * p.rate * x.y
        return Equations(rates={"y": rate + rate if self.twice else rate})


def of(block: AbstractBlock) -> str:
    return Diagram.build({"block": block}).fingerprint


def test_a_loop_built_again_has_the_same_fingerprint_and_any_change_another() -> None:
    nearly = 1.0 + 2.0**-52
    kinds = [Decay(), Decay(rate=2), Decay(rate=nearly), Decay(constant=2), Decay(constant=nearly), Decay(twice=True)]
    found = [of(kind) for kind in kinds]
    assert found == [of(kind) for kind in kinds]
    assert len(set(found)) == len(kinds)
    assert all(len(item) == 64 for item in found)


@pytest.mark.parametrize(
    "override",
    [
        "inverse.w_box=[0, 0.11]",
        "path.rate=1",
        "servo.K_P=61",
        "arm.viscous=1.5",
        "robot.tool=[0.3, 0, 0]",
        "model.bias=true",
    ],
)
def test_a_graph_with_another_number_or_option_has_another(override: str) -> None:
    assert Graph.read("arm2_joint").diagram.fingerprint != Graph.read("arm2_joint", [override]).diagram.fingerprint


def test_clock_duration_and_solver_are_no_part_of_the_field() -> None:
    plain = Graph.read("arm2_joint").diagram.fingerprint
    for override in ("duration=3", "clock=4 ms", "solver.method=cvodes", "title=other"):
        assert Graph.read("arm2_joint", [override]).diagram.fingerprint == plain


def test_values_put_in_later_count() -> None:
    diagram = Graph.read("arm2_joint").diagram
    assert diagram.fingerprint == diagram.fingerprint
    other = with_values(diagram, {"servo.K_P": [61, 30]})
    assert other.fingerprint == Graph.read("arm2_joint", ["servo.K_P=[61, 30]"]).diagram.fingerprint
    assert other.fingerprint != diagram.fingerprint


def test_a_law_of_projection_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.diagram.projection import Box

    diagram = Graph.read("arm2_joint").diagram
    before = diagram.fingerprint
    for name, other in (("law", lambda self, s, v: 0 * v), ("held", lambda self, s: s)):
        with monkeypatch.context() as changed:
            changed.setattr(Box, name, other)
            assert Graph.read("arm2_joint").diagram.fingerprint != before


def test_another_process_finds_the_same() -> None:
    code = "from dmframe.graph.graph import Graph; print(Graph.read('ur10_full').diagram.fingerprint)"
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == Graph.read("ur10_full").diagram.fingerprint


def test_what_was_proved_is_what_ran(tmp_path: Path) -> None:
    graph = Graph.read("arm2_joint", ["duration=10 ms"])
    diagram = graph.diagram
    data = summary("arm2_joint", verify(diagram, trials=1))
    run = simulate(graph.diagram, 0.01, clock=graph.file.clock, start=graph.start)
    write_run(tmp_path / "out", [Run(graph, run)], plots=False)
    written = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert data["field_hash"] == written["field_hash"] == diagram.fingerprint
    again = Graph.read(tmp_path / "out" / "graph.yaml")
    assert again.diagram.fingerprint == diagram.fingerprint
    assert find_graph("arm2_joint") != tmp_path


class Fickle(AbstractBlock):
    """Its equations depend on the number of evaluations."""

    states = (State("y"), State("z", optional=True))
    outputs = (Output("out"),)
    how: str = ""
    calls: ClassVar[list[int]] = []

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        self.calls.append(1)
        n = len(self.calls)
        sign = -1 if self.how != "sign" else (-1) ** n
        constant = 1 + n * 1e-12 if self.how == "constant" else 1
        rates: dict[str, Any] = {"y": sign * constant * x.y}
        if self.how == "state" and n % 2:
            rates["z"] = ca.SX(0)
        return Equations(outputs={"out": x.y * n if self.how == "output" else x.y}, rates=rates)


@pytest.mark.parametrize(
    ("how", "what"),
    [("sign", "rate of y"), ("constant", "rate of y"), ("state", "rate of z"), ("output", "output of out")],
)
def test_equations_that_change_at_a_second_evaluation_are_refused(how: str, what: str) -> None:
    with pytest.raises(BlockError, match=f"block: equations\\(\\) state another {what} when evaluated again"):
        of(Fickle(how=how))
    assert of(Fickle())


def refused(kind: type[AbstractBlock]) -> str:
    with pytest.raises(DmframeError) as caught:
        Diagram.build({"goal": kind()})
    return str(caught.value)


def a_source(**changes: Any) -> type[AbstractBlock]:
    def equations(self: Any, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"g": ca.SX(1)}, rates={state.name: ca.SX(1) for state in self.states})

    space = {
        "__module__": __name__,
        "side": Side.SOURCE,
        "inputs": (TIME,),
        "outputs": (Output("g"),),
        "equations": equations,
        "__annotations__": {},
    }
    return type("Goal", (AbstractBlock,), space | changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"states": (State("s"),)}, "goal: has the state s; a source is a function of time alone"),
        ({"inputs": (TIME, Input("q"))}, "goal: has the input q; a source is a function of time alone"),
        ({"inputs": (Input("t", "", "rad"),)}, "goal: has the input t; a source is a function of time alone"),
        ({"truth": (Input("k"),)}, "goal: reads the truth k; a source is a function of time alone"),
        ({"certificate": lambda self, u, x, p, truth: None}, "goal: overrides certificate"),
        ({"start": lambda self, u, p, truth: {}}, "goal: overrides start"),
    ],
)
def test_a_source_that_is_more_than_a_function_of_time_is_refused(changes: dict[str, Any], text: str) -> None:
    assert Diagram.build({"goal": a_source()()}).loop.outputs
    assert text in refused(a_source(**changes))
