"""The key `baseline`: the graph to be compared with."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from dmframe.catalogue import graphs
from dmframe.common.errors import DmframeError, MissingError
from dmframe.config.resolved import resolved_text
from dmframe.graph.graph import Graph

GRAPH = """\
dmframe: 1
robot: arm2
clock: 8 ms
duration: 1 s
blocks:
  path:     {type: setpoint, q_d: [0.5, 0.3]}
  task:     {type: joint_tracking, alpha_bar: 5}
  model:    {type: regressor}
  dynamics: {type: dynamic_compensator, Gamma: 10}
  inverse:  {type: pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 1}
  servo:    {type: pi_servo, K_P: 60, K_I: 120}
  arm:      {type: manipulator}
wires:
  dynamics.Y_d: model.Y_d
"""
KINEMATIC = "baseline: {inverse: {type: kinematic_command}, model: null, dynamics: null}\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_baseline_has_its_own_blocks_and_none_that_is_left_out(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH + KINEMATIC)).baseline()
    assert graph.name == "mine_baseline"
    assert list(graph.blocks) == ["path", "task", "inverse", "servo", "arm"]
    assert graph.file.blocks["inverse"] == {"type": "kinematic_command"}
    assert graph.file.wires == {}
    assert not graph.file.baseline
    _ = graph.diagram


def test_an_override_changes_both(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH + KINEMATIC), ["task.alpha_bar=3"])
    assert graph.file.blocks["task"]["alpha_bar"] == graph.baseline().file.blocks["task"]["alpha_bar"] == 3


def test_a_baseline_stays_one_when_it_is_changed_cut_or_pickled(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH + KINEMATIC), ["task.alpha_bar=3"]).baseline()
    blocks = ["path", "task", "inverse", "servo", "arm"]
    changed = graph.set({"servo.K_P": 50})
    for other in (changed, graph.until(2.0), pickle.loads(pickle.dumps(graph))):
        assert list(other.blocks) == blocks
        assert (other.name, other.swapped) == ("mine_baseline", ("inverse",))
        assert other.overrides[0] == "task.alpha_bar=3"
    assert changed.file.blocks["servo"]["K_P"] == 50
    again = Graph.read(written(tmp_path, resolved_text(changed)))
    assert list(again.blocks) == blocks


def test_a_block_of_the_baseline_is_set_at_its_place_in_the_file(tmp_path: Path) -> None:
    own = "baseline: {dynamics: {type: dynamic_compensator, Gamma: 5}}\n"
    path = written(tmp_path, GRAPH + own)
    changed = Graph.read(path).baseline().set({"dynamics.Gamma": 7, "task.alpha_bar": 2})
    assert changed.overrides == ("baseline.dynamics.Gamma=7", "task.alpha_bar=2")
    again = Graph.read(path, changed.overrides)
    assert (again.file.blocks["dynamics"]["Gamma"], again.baseline().file.blocks["dynamics"]["Gamma"]) == (10, 7)


def test_the_resolved_graph_keeps_its_baseline(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH + KINEMATIC))
    again = Graph.read(written(tmp_path, resolved_text(graph)))
    assert again.file.baseline == graph.file.baseline


def test_the_resolved_graph_keeps_what_is_uncertain(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH + "uncertain: {servo.K_P: [50, 70]}\n"))
    again = Graph.read(written(tmp_path, resolved_text(graph)))
    assert again.file.uncertain == {"servo.K_P": [50, 70]}


def test_without_the_key_there_is_nothing_to_compare_with(tmp_path: Path) -> None:
    graph = Graph.read(written(tmp_path, GRAPH))
    with pytest.raises(MissingError, match="mine: expected a key baseline, with the blocks to compare with"):
        graph.baseline()


@pytest.mark.parametrize(
    ("baseline", "text"),
    [
        ("{inverse: {type: kinematic_comand}}", "baseline.inverse.type: kinematic_comand: unknown block type"),
        ("{inverse: {type: pi_inverse}}", "baseline.inverse"),
        ("{invers: null}", "mine.yaml:15:12: baseline.invers: unknown block; did you mean inverse?"),
        ("{inverse: {Lambda: 1}}", "baseline.inverse: expected a key type"),
        ("[1]", "baseline: expected keys with values, found [1]"),
        ("{inverse: 3}", "baseline.inverse: expected keys with values, found 3"),
    ],
)
def test_a_bad_baseline_is_reported_when_the_graph_is_read(tmp_path: Path, baseline: str, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        Graph.read(written(tmp_path, f"{GRAPH}baseline: {baseline}\n"))
    assert text in str(caught.value)


@pytest.mark.parametrize("name", sorted(graphs()))
def test_each_packaged_baseline_is_the_kinematic_controller_before_the_same_robot(name: str) -> None:
    graph = Graph.read(name)
    if not graph.file.baseline:
        paired = ("ur10_fast", "ur10_slow", "ur10_full", "arm2_joint", "pendulum")  # they have baselines of their own
        assert "servo" not in graph.file.blocks or name.startswith(paired), f"{name} has a servo and no baseline"
        return
    other = graph.baseline()
    assert other.file.blocks["inverse"] == {"type": "kinematic_command"}
    assert all(other.file.blocks[block] == graph.file.blocks[block] for block in ("path", "servo", "arm"))
    assert "a_d_hat" not in {state.name for state in other.diagram.loop.controller}
