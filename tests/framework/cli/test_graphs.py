"""``--set`` with several graphs and several values; completion in a shell and an editor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from dmframe.cli import run as run_module
from dmframe.cli.graphs import alternatives, graphs_of
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_file

pytestmark = pytest.mark.usefixtures("without_v")

SHORT = ("--until", "0.05 s", "--no-plots")


@pytest.mark.parametrize(
    ("text", "each"),
    [
        ("a.b=1", ["a.b=1"]),
        ("a.b=1,10, 100", ["a.b=1", "a.b=10", "a.b=100"]),
        ("clock=2 ms,4 ms", ["clock=2 ms", "clock=4 ms"]),
        ("a.b=[1, 2]", ["a.b=[1, 2]"]),
        ("a.b=[1, 2],[3, 4]", ["a.b=[1, 2]", "a.b=[3, 4]"]),
        ("start={q: [1, 2]}", ["start={q: [1, 2]}"]),
        ('a.b="x, y"', ['a.b="x, y"']),
        ("a.b='x, y',z", ["a.b='x, y'", "a.b=z"]),
        ("title=slow, then fast", ["title=slow, then fast"]),
    ],
)
def test_commas_outside_of_brackets_and_quotes_part_values(text: str, each: list[str]) -> None:
    assert alternatives(text) == each


def test_an_empty_value_between_commas_is_refused() -> None:
    with pytest.raises(DmframeError, match="expected a value between commas"):
        alternatives("a.b=1,,2")


def test_several_values_make_a_graph_each_in_a_folder_of_its_own(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "pendulum", "--set", "dynamics.Gamma=1,10", *SHORT, "--out", "o")
    assert (reported.status, reported.err) == (0, "")
    assert [line.split("  ")[0] for line in reported.out.splitlines()[1:3]] == ["pendulum Gamma=1", "pendulum Gamma=10"]
    for gamma in (1, 10):
        data = read_file(tmp_path / "o" / f"pendulum_Gamma_{gamma}" / "graph.yaml").data
        assert data["blocks"]["dynamics"]["Gamma"] == gamma


def test_every_combination_of_several_values_is_run() -> None:
    found = graphs_of(["arm2_joint"], ["clock=2 ms,4 ms", "dynamics.Gamma=1,2"])
    assert [(graph.clock, graph.blocks["dynamics"].Gamma) for graph in found] == [  # type: ignore[attr-defined]
        (0.002, 1.0),
        (0.002, 2.0),
        (0.004, 1.0),
        (0.004, 2.0),
    ]


def test_a_value_may_be_for_one_graph_of_several(tmp_path: Path, dmframe: Any) -> None:
    assert dmframe("new", "pendulum", "mine.yaml").status == 0
    found = graphs_of(["mine.yaml", "arm2_joint"], ["mine.yaml:dynamics.Gamma=3", "duration=0.1"])
    gains = [graph.blocks["dynamics"].Gamma for graph in found]  # type: ignore[attr-defined]
    assert gains[0] == 3.0
    assert gains[1] == graphs_of(["arm2_joint"], [])[0].blocks["dynamics"].Gamma  # type: ignore[attr-defined]
    assert [graph.duration for graph in found] == [0.1, 0.1]
    assert graphs_of(["mine.yaml"], ["mine:dynamics.Gamma=3"])[0].blocks["dynamics"].Gamma == 3.0  # type: ignore[attr-defined]
    both = (
        graphs_of(["pendulum", "./pendulum.yaml"], ["pendulum:dynamics.Gamma=3"]) if dmframe("new", "pendulum") else []
    )
    assert [graph.blocks["dynamics"].Gamma == 3.0 for graph in both] == [True, False]  # type: ignore[attr-defined]
    with pytest.raises(DmframeError, match=r"--set mien:clock: unknown graph; choose from mine\.yaml"):
        graphs_of(["mine.yaml"], ["mien:clock=1"])


@pytest.mark.parametrize("words", [("check",), ("analyse",), ("draw",)])
def test_a_command_for_one_graph_refuses_several_values(dmframe: Any, words: tuple[str, ...]) -> None:
    reported = dmframe(*words, "pendulum", "--set", "dynamics.Gamma=1,2")
    assert reported.status == 2
    assert "several values make 2 graphs, expected one" in reported.err


def test_robots_are_listed(dmframe: Any) -> None:
    reported = dmframe("robots")
    assert reported.status == 0
    assert [line.split()[0] for line in reported.out.splitlines()][:2] == ["arm2", "arm3"]


def test_a_new_graph_has_its_schema_next_to_it(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("new", "ur10_fast").status == 0
    first = (tmp_path / "ur10_fast.yaml").read_text(encoding="utf-8").splitlines()[0]
    name = first.removeprefix("# yaml-language-server: $schema=")
    schema = json.loads((tmp_path / name).read_text(encoding="utf-8"))
    jsonschema.validate(read_file(tmp_path / "ur10_fast.yaml").data, schema)
    compensator = schema["$defs"]["block_dynamic_compensator"]["properties"]
    assert "Adaptation gain" in compensator["Gamma"]["description"]
    assert "ur10" in str(schema["properties"]["robot"])
    assert dmframe("check", "ur10_fast.yaml").status == 0


def test_a_file_is_written_over_only_by_force(dmframe: Any, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("precious")
    assert dmframe("new", "pendulum", "mine.yaml").status == 2
    assert (tmp_path / "mine.yaml").read_text() == "precious"
    assert dmframe("new", "pendulum", "mine.yaml", "--force").status == 0
    assert "pendulum" in (tmp_path / "mine.yaml").read_text()


def test_results_are_written_to_a_folder_with_files_only_by_force(dmframe: Any, tmp_path: Path) -> None:
    words = ("run", "pendulum", *SHORT, "--out", "o")
    assert dmframe(*words).status == 0
    (tmp_path / "o" / "notes.txt").write_text("mine")
    reported = dmframe(*words)
    assert reported.status == 2
    assert "name another folder, or use --force" in reported.err
    assert dmframe(*words, "--set", "dynamics.Gamma=7", "--force").status == 0
    assert read_file(tmp_path / "o" / "graph.yaml").data["blocks"]["dynamics"]["Gamma"] == 7
    assert (tmp_path / "o" / "notes.txt").read_text() == "mine"


def test_two_runs_of_one_millisecond_have_a_folder_each(
    dmframe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime(2026, 1, 2, 3, 4, 5)

    monkeypatch.setattr(run_module, "datetime", Stopped)
    for _ in range(3):
        assert dmframe("run", "pendulum", *SHORT).status == 0
    first = "2026-01-02_03-04-05_000_pendulum"
    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == [first, f"{first}_2", f"{first}_3"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("dmframe run ur10_f", "ur10_fast"),
        ("dmframe check mi", "mine.yaml"),
        ("dmframe blocks dyn", "dynamic_compensator"),
        ("dmframe regressor pend", "pendulum"),
    ],
)
def test_a_shell_completes_graphs_blocks_and_robots(tmp_path: Path, words: str, expected: str) -> None:
    (tmp_path / "mine.yaml").write_text("")
    request = {"_DMFRAME_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": "2"}
    done = subprocess.run(
        [str(Path(sys.executable).with_name("dmframe"))],
        cwd=tmp_path,
        env={**os.environ, **request},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert expected in done.stdout.split()


def test_force_leaves_no_figure_of_another_run_and_touches_no_folder_or_link_of_others(
    dmframe: Any, tmp_path: Path
) -> None:
    out, elsewhere = tmp_path / "o", tmp_path / "elsewhere.png"
    out.mkdir()
    elsewhere.write_text("precious")
    (out / "error.png").symlink_to(elsewhere)
    (out / "estimates_old.svg").write_text("old")
    (out / "notes.txt").write_text("mine")
    assert dmframe("run", "pendulum", *SHORT, "--out", "o", "--force").status == 0
    assert elsewhere.read_text() == "precious"
    assert {item.name for item in out.iterdir()} == {
        "graph.yaml", "provenance.json", "seal.json", "signals.nc", "summary.json", "notes.txt"
    }  # fmt: skip
    (out / "signals.nc").unlink()
    (out / "signals.nc" / "deep").mkdir(parents=True)
    reported = dmframe("run", "pendulum", *SHORT, "--out", "o", "--force")
    assert reported.status == 2
    assert "signals.nc is a folder, but a file has to be written" in reported.err
    assert (out / "signals.nc" / "deep").is_dir()


@pytest.mark.parametrize(
    ("stranger", "reason"),
    [
        ("pendulum/notes.txt", "the folder pendulum contains no results; move it, or name another folder"),
        ("pendulum", "pendulum is a file, but a folder has to be created; move it, or name another folder"),
    ],
)
def test_force_checks_before_the_run_whether_what_it_would_replace_is_ours(
    dmframe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stranger: str, reason: str
) -> None:
    (tmp_path / "o" / stranger).parent.mkdir(parents=True)
    (tmp_path / "o" / stranger).write_text("precious")
    monkeypatch.setattr("dmframe.graph.graph.Graph.run", lambda *_, **__: pytest.fail("it ran"))
    reported = dmframe("run", "pendulum", "arm2_joint", *SHORT, "--out", "o", "--force")
    assert (reported.status, reported.err) == (2, f"dmframe: o: {reason}\n")
    assert (tmp_path / "o" / stranger).read_text() == "precious"


def test_force_replaces_the_folders_of_results_of_before(dmframe: Any, tmp_path: Path) -> None:
    words = ("run", "pendulum", "arm2_joint", *SHORT, "--out", "o")
    assert dmframe(*words).status == 0
    (tmp_path / "o" / "next").mkdir()
    (tmp_path / "o" / "next" / "notes.txt").write_text("mine")
    assert dmframe(*words, "--set", "pendulum:dynamics.Gamma=7", "--force").status == 0
    assert read_file(tmp_path / "o" / "pendulum" / "graph.yaml").data["blocks"]["dynamics"]["Gamma"] == 7
    assert (tmp_path / "o" / "next" / "notes.txt").read_text() == "mine"


def test_each_new_graph_has_its_own_copy_of_a_repaired_robot(dmframe: Any, tmp_path: Path) -> None:
    limit, moments = '<limit lower="-2" upper="2"/>', 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    links = "".join(
        f'<link name="l{k}"><inertial><mass value="1"/><inertia {moments}/></inertial></link><joint name="j{k}" '
        f'type="revolute"><parent link="{f"l{k - 1}" if k else "base"}"/><child link="l{k}"/><origin xyz="0.3 0 0.1"/>'
        f'<axis xyz="{axis}"/>{limit}</joint>'
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0"))
    )
    Path("cell.urdf").write_text(f'<robot name="cell"><link name="base"/>{links}</robot>')
    assert dmframe("new", "cell.urdf").status == 0
    first = Path("cell_arm.urdf").read_bytes()
    Path("cell.urdf").write_text(Path("cell.urdf").read_text().replace('mass value="1"', 'mass value="2"'))
    assert dmframe("new", "cell.urdf", "c2.yaml").status == 0
    assert Path("cell_arm.urdf").read_bytes() == first != Path("c2_arm.urdf").read_bytes()
    assert "model: c2_arm.urdf" in Path("c2.yaml").read_text()
    Path("c2_arm.urdf").unlink()
    assert dmframe("new", "cell.urdf", "c2.yaml").err == "dmframe: c2.yaml: exists already; choose a new file\n"
    assert not Path("c2_arm.urdf").exists()
