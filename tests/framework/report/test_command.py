"""The command line for a graph on a page or in an explanation."""

from __future__ import annotations

import shlex
import shutil

import dmframe as dm
from dmframe.catalogue import graphs
from dmframe.report.command import command
from dmframe.report.verification import Verification


def test_a_packaged_graph_is_called_by_its_name_and_overrides_are_printed():
    graph = dm.load("arm2_joint").set({"path.center": [0.5, 1]})
    words = shlex.split(command(graph, "run").text)
    assert words[:4] == ["dmframe", "run", "arm2_joint", "--set"]
    assert words[4].startswith("path.center=")


def test_a_file_of_any_name_is_one_word_of_a_shell(tmp_path):
    file = tmp_path / 'it\'s; echo $HOME "x" <b>.yaml'
    shutil.copy(graphs()["arm2_joint"], file)
    assert shlex.split(command(dm.load(file), "run").text) == ["dmframe", "run", str(file)]


def test_the_text_of_a_graph_without_a_file_is_given_a_file_name():
    graph = dm.load(dm.load("arm2_joint").text, name="mine").set({"task.alpha_bar": 3})
    assert command(graph, "run")[:2] == ("dmframe run mine.yaml", "the graph's text in mine.yaml")


def test_a_file_without_an_ending_is_called_by_its_own_name(tmp_path):
    file = tmp_path / "mine"
    shutil.copy(graphs()["arm2_joint"], file)
    assert command(dm.load(file), "verify")[:2] == (f"dmframe verify {file}", "")


def test_a_baseline_is_run_together_with_its_graph_and_verified_as_a_file_of_its_own():
    graph = dm.load("theorem_3").set({"servo.K_P": 50}).baseline()
    found = command(graph, "run")
    assert found == ("dmframe run theorem_3 --baseline --set servo.K_P=50", "", ("inverse",))
    verified = ("dmframe verify theorem_3_baseline.yaml", "the graph's text in theorem_3_baseline.yaml", ())
    assert command(graph, "verify") == verified


def test_a_twin_without_a_proof_names_the_graph_next_to_it_that_has_one(tmp_path):
    lines = graphs()["pendulum"].read_text().splitlines()
    kept = [line for line in lines if not line.strip().startswith(("model:", "dynamics:", "inverse:"))]
    twin, adaptive = tmp_path / "twin.yaml", tmp_path / "adaptive.yaml"
    twin.write_text("\n".join([*kept, "  inverse:  {type: kinematic_command}"]) + "\n")
    assert "adaptive" not in str(Verification(dm.load(twin), dm.load(twin).verdict()))
    shutil.copy(graphs()["pendulum"], adaptive)
    graph = dm.load(twin)
    text = str(Verification(graph, graph.verdict()))
    assert "twin: not applicable" in text
    assert f"dmframe verify {adaptive}" in text
    adaptive.write_text(adaptive.read_text().replace("robot: pendulum", "robot: arm2"))
    assert "adaptive" not in str(Verification(graph, graph.verdict()))
    assert "dmframe verify" not in str(Verification(dm.load("pendulum"), dm.load("pendulum").verdict()))
