"""A graph from its file: its content, changes by `--set`, and blocks from other places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dmframe.catalogue import graphs
from dmframe.common.errors import DmframeError, Faults
from dmframe.config.document import read_file
from dmframe.config.grammar import GraphFile
from dmframe.config.overrides import overridden
from dmframe.config.places import placed
from dmframe.graph.graph import Graph
from dmframe.simulate import Solver, simulate

PENDULUM = graphs()["pendulum"].read_text()

LEAKY = '''\
from typing import ClassVar
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Input, Output, State


class Leaky(AbstractBlock):
    """A filtered measurement."""

    inputs = (Input("q", "n", "rad"),)
    outputs = (Output("q_slow", "n", "rad"),)
    states = (State("kept", "n", "rad"),)
    rate: Scalar = Positive("", "1/s")

    def equations(self, u, x, p):
        return Equations(outputs={"q_slow": 2 * x.kept}, rates={"kept": p.rate * (u.q - x.kept)})
'''


def test_a_file_states_robot_clock_duration_solver_start_and_blocks(tmp_path: Path) -> None:
    text = PENDULUM.replace("clock: continuous", "clock: 5 ms").replace(
        "blocks:", "solver: {method: cvodes, tolerance: 1e-6, output: 20 ms}\nstart: {q: 5 deg, dq: [0.25]}\nblocks:"
    )
    (tmp_path / "own.yaml").write_text(text)
    graph = Graph.read(tmp_path / "own.yaml")
    assert graph.name == "own"
    assert (graph.file.clock, graph.file.duration) == (0.005, 30.0)
    assert graph.solver == Solver("cvodes", None, 0.02, 1e-6)
    assert graph.start == {"q": pytest.approx(np.pi / 36), "dq": [0.25]}
    assert list(graph.blocks) == ["path", "task", "model", "dynamics", "inverse", "servo", "arm"]
    assert graph.robot.name == "pendulum"


def test_a_continuous_clock_is_no_period() -> None:
    assert Graph.read("pendulum").file.clock is None


def test_an_override_goes_before_the_file() -> None:
    graph = Graph.read(
        "pendulum", ["task.alpha_bar=3", "clock=4 ms", "blocks.servo.K_D=[25]", "robot.friction_velocity=0.01"]
    )
    assert graph.blocks["task"].alpha_bar == 3.0  # type: ignore[attr-defined]
    assert graph.blocks["servo"].K_D == (25.0,)  # type: ignore[attr-defined]
    assert graph.file.clock == 0.004
    assert graph.robot.friction_velocity == 0.01
    assert graph.data["blocks"]["task"]["alpha_bar"] == 3
    assert Graph.read("pendulum").data["blocks"]["task"]["alpha_bar"] == 2


def test_a_robot_requested_in_the_same_words_is_not_read_again() -> None:
    graph = Graph.read("ur10_fast")
    assert graph.set({"dynamics.Gamma": 3}).robot is graph.robot
    other = graph.set({"robot.friction_velocity": "1 mrad/s"})
    assert other.robot is not graph.robot
    assert other.robot.friction_velocity == 0.001


def test_the_last_override_of_a_value_holds() -> None:
    assert Graph.read("pendulum", ["task.alpha_bar=3", "task.alpha_bar=4"]).blocks["task"].alpha_bar == 4.0  # type: ignore[attr-defined]


def test_a_fault_that_an_override_brought_is_placed_there() -> None:
    with pytest.raises(DmframeError) as caught:
        _ = Graph.read("pendulum", ["servo.K_D=[1, 2]"]).diagram
    assert str(caught.value) == "--set servo.K_D=[1, 2]: servo.K_D: expected n = 1 (bound by robot pendulum), found 2"


def test_another_duration_leaves_the_graph_as_it_was() -> None:
    graph = Graph.read("pendulum")
    assert graph.until(1.5).file.duration == 1.5
    assert graph.file.duration == 30.0


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("start.qq=1", "start.qq: unknown state"),
        ("start.q=[1, 2]", "start.q: expected 1 numbers, found 2"),
        ("start.q=99", "start.q: expected joint1 between"),
        ('log.signals=["a"]', "log.signals: unknown signal"),
        ("solver.step=1e-9", "solver.step: expected at most 2000 steps in a tick of solver.output, 0.01 s"),
        ("duration=1e9", "duration: a run of 1e+11 ticks is too long"),
    ],
)
def test_a_diagram_is_refused_for_what_a_run_would_refuse(override: str, text: str) -> None:
    graph = Graph.read("pendulum", [override])
    with pytest.raises(DmframeError) as caught:
        _ = graph.diagram
    assert text in str(caught.value)
    assert str(caught.value).startswith("--set ")


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("uncertain={servo.K_D: [1, 2]}", "uncertain.servo.K_D: expected an interval that holds the graph's own"),
        ("uncertain.servo.K_D=nothing", "uncertain.servo.K_D: expected"),
        ("uncertain.servo.K_J=[1, 2]", "uncertain.servo.K_J: unknown parameter of the plant"),
    ],
)
def test_intervals_are_refused_where_a_proof_takes_them_and_leave_a_run_alone(override: str, text: str) -> None:
    graph = Graph.read("pendulum", [override])
    diagram = graph.diagram
    with pytest.raises(DmframeError) as caught:
        graph.intervals(diagram)
    assert text in str(caught.value)
    assert str(caught.value).startswith("--set ")


def test_everything_that_a_run_would_refuse_is_reported_at_once() -> None:
    with pytest.raises(Faults) as caught:
        _ = Graph.read("pendulum", ["start.qq=1", "log.signals=[a, b]"]).diagram
    assert len(caught.value.faults) == 3


def test_a_fault_of_the_duration_that_a_call_gave_is_placed_there() -> None:
    graph = Graph.read("pendulum").until(1e9)
    assert graph.data["duration"] == 1e9
    with pytest.raises(DmframeError) as caught:
        _ = graph.diagram
    assert str(caught.value).startswith("--until 1e+09: duration: a run of 1e+11 ticks is too long")


def test_a_fault_of_a_whole_block_states_which_overrides_changed_it() -> None:
    with pytest.raises(DmframeError) as caught:
        Graph.read("pendulum", ["path.times=[0, 0, 0, 0, 0]", "task.alpha_bar=1"])
    assert caught.value.location.endswith("pendulum.yaml:7:13 with --set path.times=[0, 0, 0, 0, 0]")


def test_labels_with_dots_are_set_as_one_key() -> None:
    given = ["uncertain.servo.K_D=[10, 30]", "start.arm.q=0.1", "wires.inverse.dq_r=task.dq_r", "robot.hold.a.b=1 deg"]
    document = overridden(read_file(graphs()["pendulum"]), given, list(GraphFile.model_fields))
    assert document.data["uncertain"] == {"servo.K_D": [10, 30]}
    assert document.data["start"] == {"arm.q": 0.1}
    assert document.data["wires"] == {"inverse.dq_r": "task.dq_r"}
    assert document.data["robot"] == {"model": "pendulum", "hold": {"a.b": "1 deg"}}


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("a#b", "a#b"),
        ('"a # b"', "a # b"),
        ("'# b'", "# b"),
        ("[1, # one\n 2]", [1, 2]),
        ("{a: '#'}", {"a": "#"}),
    ],
)
def test_an_override_keeps_all_of_its_one_value(written: str, value: object) -> None:
    document = overridden(read_file(graphs()["pendulum"]), [f"title={written}"], list(GraphFile.model_fields))
    assert document.data["title"] == value


def test_a_users_block_next_to_the_graph_runs_from_any_folder(tmp_path: Path) -> None:
    (tmp_path / "my_block.py").write_text(LEAKY)
    own = "  slow:     {type: my_block.py:Leaky, rate: 3}\n"
    (tmp_path / "own.yaml").write_text(PENDULUM + own)
    graph = Graph.read(tmp_path / "own.yaml")
    run = simulate(graph.diagram, 6.0, solver=graph.solver, start=graph.start)
    slow, q = run["slow.kept"].ravel(), run["arm.q"].ravel()
    np.testing.assert_allclose(run["slow.q_slow"].ravel(), 2 * slow)
    np.testing.assert_allclose(np.gradient(slow, run.time)[1:-1], (3 * (q - slow))[1:-1], atol=1e-3)


def test_a_users_block_that_reads_what_is_hidden_is_refused(tmp_path: Path) -> None:
    (tmp_path / "my_block.py").write_text(
        LEAKY.replace('Input("q", "n", "rad"),', 'Input("u", "n", "V"),').replace("u.q", "u.u")
    )
    (tmp_path / "own.yaml").write_text(PENDULUM + "  slow:     {type: my_block.py:Leaky, rate: 3}\n")
    graph = Graph.read(tmp_path / "own.yaml")
    with pytest.raises(DmframeError) as caught:
        _ = graph.diagram
    assert str(caught.value).endswith("servo.u is hidden: slow.u cannot read it (the robot's architecture is closed)")


def test_a_start_that_cannot_be_is_placed_in_the_file(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(PENDULUM.replace("blocks:", "start: {q: [9]}\nblocks:"))
    graph = Graph.read(tmp_path / "own.yaml")
    with pytest.raises(DmframeError) as caught:
        simulate(graph.diagram, 1.0, start=graph.start)
    fault = placed(caught.value, graph.document)
    assert fault.location.endswith("own.yaml:6:12")


def test_every_file_is_read_without_its_folder_being_the_current_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in graphs().values():
        assert Graph.read(path).diagram.loop.plant
