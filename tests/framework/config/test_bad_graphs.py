"""Bad graphs and their messages, word for word: `bad_graphs.txt`, and `bad_blocks.txt` for a user's own blocks.

In those files ``== name`` begins a case; ``- old`` and ``+ new`` change `GOOD`, ``$`` is an override, ``|`` a line of a
graph of its own, ``> file`` begins a file next to it whose lines follow after a colon (``> Mine``: the body of a block
class Mine in mine.py), and what remains is the whole message, in which ``{block types}`` lists the packaged ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from dmframe.common.errors import DmframeError, Faults
from dmframe.config.places import placed
from dmframe.graph.graph import Graph
from dmframe.simulate import simulate

GOOD = """\
dmframe: 1
title: A planar arm
robot: arm2
clock: 4 ms
duration: 1 s
start: {near: [0.5, 0.5]}
solver: {method: rk4}
blocks:
  path:     {type: circle, center: [0.5, 0.3], radius: 0.1, rate: 1 rad/s}
  geometry: {type: kinematics}
  task:     {type: known_tracking, gamma: 0.8}
  model:    {type: regressor, friction: [viscous]}
  dynamics: {type: dynamic_compensator, Gamma: 1}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 2}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator, viscous: [1, 0.5]}
"""

MINE = """\
from typing import ClassVar
import casadi as ca
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Scalar, Real, Interval, Box, Rows, Table
from dmframe.block.port import Access, Input, Output, Side, State, TIME

class Mine(AbstractBlock):
"""

HERE = Path(__file__).parent
PACKAGED = HERE.parents[2] / "blocks" / "dmframe_blocks"
TYPES = ", ".join(sorted(file.stem for file in PACKAGED.glob("[a-z]*.py")))


@dataclass
class Case:
    name: str
    old: list[str] = field(default_factory=list)
    new: list[str] = field(default_factory=list)
    overrides: list[str] = field(default_factory=list)
    text: list[str] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    message: list[str] = field(default_factory=list)

    def graph(self) -> str:
        text = GOOD
        for old, new in zip(self.old, self.new, strict=True):
            assert text.count(old) >= 1, f"{old} is not in the good graph"
            text = text.replace(old, new, 1)
        return "\n".join(self.text) + "\n" if self.text else text


def cases(file: str) -> Iterator[Case]:
    case, name = Case(""), ""
    for line in (HERE / file).read_text(encoding="utf-8").splitlines():
        sign, rest = line[:2].strip(), line[2:].replace("\\n", "\n")
        match sign:
            case "==":
                case = Case(rest.strip())
            case "-":
                case.old.append(rest)
            case "+":
                case.new.append(rest)
            case "$":
                case.overrides.append(rest)
            case "|":
                case.text.append(rest)
            case ">":
                name = "mine.py" if rest == "Mine" else rest
                case.files[name] = MINE if rest == "Mine" else ""
            case ":":
                case.files[name] += rest + "\n"
            case "":
                yield case
            case _:
                case.message.append(line.replace("{block types}", TYPES))
    yield case


GRAPHS, BLOCKS = list(cases("bad_graphs.txt")), list(cases("bad_blocks.txt"))


def complaint(text: str, overrides: list[str] | None = None) -> str:
    """The error for a graph file g.yaml in the current folder."""
    Path("g.yaml").write_text(text, encoding="utf-8")
    graph: Graph | None = None
    try:
        graph = Graph.read("g.yaml", overrides or ())
        diagram = graph.diagram
        graph.intervals(diagram)
        simulate(diagram, graph.file.duration, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    except DmframeError as error:
        return str(placed(error, graph.document) if graph else error)
    return "nothing"


@pytest.mark.parametrize("case", [*GRAPHS, *BLOCKS], ids=lambda case: case.name)
def test_a_bad_graph_is_refused_with_fault_place_and_remedy(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in case.files.items():
        Path(name).write_text(text, encoding="utf-8")
    assert complaint(case.graph(), case.overrides).splitlines() == case.message


def test_there_are_cases_and_no_two_have_one_name() -> None:
    names = [case.name for case in (*GRAPHS, *BLOCKS)]
    assert len(GRAPHS) > 90
    assert len(BLOCKS) > 20
    assert len(set(names)) == len(names)


def test_a_graph_of_ten_megabytes_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert complaint(GOOD + "#" + "x" * 10_000_000) == "g.yaml: a graph is at most 1 MB; is this the right file?"


def test_the_good_graph_is_good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("g.yaml").write_text(GOOD, encoding="utf-8")
    graph = Graph.read("g.yaml")
    assert simulate(graph.diagram, 0.02, clock=graph.file.clock, start=graph.start).divergence is None


def test_several_faults_are_reported_in_the_order_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bad = GOOD.replace("arm2", "amr2").replace("gamma", "gama").replace("4 ms", "4 kg").replace("[60, 30]", "[60, -3]")
    Path("g.yaml").write_text(bad, encoding="utf-8")
    with pytest.raises(Faults) as caught:
        Graph.read("g.yaml")
    assert [fault.location for fault in caught.value.faults] == [
        "g.yaml:3:8",
        "g.yaml:4:8",
        "g.yaml:11:36",
        "g.yaml:15:35",
    ]
