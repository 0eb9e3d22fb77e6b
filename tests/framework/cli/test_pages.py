"""The commands that print: graphs, new, check, draw, blocks, schema, regressor."""

from __future__ import annotations

import contextlib
import ctypes
import io
import json
import re
import shutil
import subprocess
import sys
import unicodedata
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pinocchio as pin
import pytest
import typer
from typer.testing import CliRunner

from dmframe.catalogue import block_types, graphs
from dmframe.cli import main
from dmframe.cli.app import app, app_for
from dmframe.cli.groups import GROUPS, GroupedCommands
from dmframe.config.document import read_document, read_file
from dmframe.report.linear import LinearView
from dmframe.robot.library import find_robot, robots

PRINTED: dict[tuple[str, int], Any] = {}

COMMANDS = (
    "graphs",
    "new",
    "check",
    "explain",
    "run",
    "verify",
    "draw",
    "page",
    "blocks",
    "learn",
    "schema",
    "regressor",
)


def test_help_lists_every_command_of_the_contract(dmframe: Any) -> None:
    reported = dmframe("-h")
    assert reported.status == 0
    assert reported.err == ""
    assert all(f"\n  {command} " in reported.out for command in COMMANDS)


def test_help_has_groups_and_whole_summaries(dmframe: Any) -> None:
    text = dmframe("--help").out
    groups = [line.rstrip(":") for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert groups == ["Options", *GROUPS]
    assert "..." not in text.partition("Start:")[2]
    for rows in GROUPS.values():
        assert all(f"\n  {name:10}  {summary}\n" in f"{text}\n" for name, summary in rows.items())


def test_a_command_of_no_group_is_listed_with_its_first_paragraph() -> None:
    more = typer.Typer(cls=GroupedCommands, rich_markup_mode=None)
    more.command("run")(lambda: None)

    @more.command()
    def mine() -> None:
        """Does something that takes a whole line to say and is not cut off at the width of the terminal.

        More.
        """

    text = CliRunner().invoke(more, ["--help"]).output
    assert "One graph:\n  run " in text
    assert "Other:\n  mine  Does something" in text
    assert "width of the terminal." in " ".join(text.split())
    assert "More." not in text


@pytest.mark.parametrize(
    "words",
    [("new", "pendulum", "a.yaml", "-o", "b.yaml"), ("export", "pendulum", "a", "-o", "b", "--c")],
)
def test_a_place_that_is_given_twice_is_refused(words: tuple[str, ...], dmframe: Any) -> None:
    reported = dmframe(*words)
    assert reported.status == 2
    assert "given twice; leave one out" in reported.err


def test_a_place_is_an_argument_or_an_option(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("new", "pendulum", "-o", "mine.yaml").status == 0
    assert tmp_path.joinpath("mine.yaml").is_file()
    assert "expected a new folder: dmframe export GRAPH OUT" in dmframe("export", "pendulum", "--c").err


def test_older_names_of_options_still_work(dmframe: Any) -> None:
    words = ("analyse", "pendulum", "--json")
    assert dmframe(*words, "--horizon", "1").out == dmframe(*words, "--until", "1").out
    for older in ("--seconds", "--until"):
        assert "--until 0: expected a time above zero" in dmframe("rehearse", "arm2_joint", older, "0").err


def test_each_command_alone_has_the_parameters_that_it_has_among_all() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]  # a group
    assert set(COMMANDS) < set(commands)
    for name, command in commands.items():
        alone = typer.main.get_command(app_for([name, "--help"])).commands  # type: ignore[attr-defined]
        assert list(alone) == [name]
        assert [vars(each)["name"] for each in alone[name].params] == [vars(each)["name"] for each in command.params]
    assert app_for(["nosuch"]) is app_for([]) is app


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help(command: str, dmframe: Any) -> None:
    reported = dmframe(command, "--help")
    assert reported.status == 0
    assert reported.out.startswith("Usage: ")
    assert reported.err == ""


def test_no_command_gives_help_and_status_2(dmframe: Any) -> None:
    assert dmframe().status == 2


def test_the_version_is_that_of_the_distribution(dmframe: Any) -> None:
    reported = dmframe("--version")
    assert (reported.status, reported.out) == (0, f"dmframe {version('dmframe')}\n")


def test_graphs_lists_every_packaged_graph_with_its_title_its_duration_and_its_clock(dmframe: Any) -> None:
    reported = dmframe("graphs")
    assert reported.status == 0
    lines = reported.out.splitlines()
    assert [line.split()[0] for line in lines] == list(graphs())
    for line, path in zip(lines, graphs().values(), strict=True):
        assert line.endswith(str(read_file(path).data["title"]))
    named = {line.split()[0]: line for line in lines}
    assert "  200 s  8 ms  " in named["ur10_fast"]
    assert "30 s   continuous" in named["pendulum"]


def test_what_there_is_to_choose_from_can_be_read_by_a_program(dmframe: Any) -> None:
    listed = {graph["name"]: graph for graph in json.loads(dmframe("graphs", "--json").out)}
    assert list(listed) == list(graphs())
    assert (listed["ur10_fast"]["duration"], listed["ur10_fast"]["clock"]) == (200.0, 0.008)
    assert listed["pendulum"]["clock"] == "continuous"
    kinds = {block["name"]: block["side"] for block in json.loads(dmframe("blocks", "--json").out)}
    assert (kinds["pid_servo"], kinds["circle"]) == ("plant", "source")
    assert {"name": "ur3", "description": "Universal Robots UR3, 6 revolute joints"} in json.loads(
        dmframe("robots", "--json").out
    )
    refused = dmframe("blocks", "circle", "--json")
    assert refused.err == "dmframe: --json: a block's page is text; leave the type out for a list\n"


def test_one_robot_is_printed_with_its_joints_masses_tool_source_and_known_errors(dmframe: Any) -> None:
    page = dmframe("robots", "arm2").out
    assert page.startswith("arm2: Planar arm with two revolute joints")
    assert "tool, at (0.4, 0, 0) m in the last joint's frame" in page
    assert "  joint2  revolute  -2.8 rad  2.8 rad  4 rad/s   50 N m   3.5 kg\n" in page
    assert "source\n  Origin: written for dmframe." in page
    assert page.endswith("known errors\n  None known. There is no friction and no rotor inertia.\n")
    data = json.loads(dmframe("robots", "arm2", "--json").out)
    assert [joint["mass"] for joint in data["joints"]] == [6.0, 3.5]  # as its SOURCE.md states them
    assert dmframe("robots", "ur1").err == f"dmframe: robot ur1: unknown robot; choose from {', '.join(robots())}\n"


def test_a_robot_of_ones_own_states_what_its_file_states(dmframe: Any, tmp_path: Path) -> None:
    joint = '<parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>'
    body = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = f'<joint name="rail" type="prismatic">{joint}<limit lower="0" upper="1" velocity="2" effort="3"/></joint>'
    (tmp_path / "own.urdf").write_text(
        f'<robot name="own"><link name="base"/><link name="slide">{body}</link>{text}</robot>'
    )
    (tmp_path / "SOURCE.md").write_text("# of something else\n\nnot read\n")
    page = dmframe("robots", "own.urdf").out
    assert "  rail  prismatic  0 m    1 m    2 m/s     3 N     2 kg\n" in page
    assert "not read" not in page


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (("verify", "pendulum", "--report=~/p.json"), "p.json"),
        (("draw", "pendulum", "--out=~/p.svg"), "p.svg"),
        (("run", "pendulum", "--until=0.1", "--no-plots", "--out=~/p"), "p/summary.json"),
        (("new", "pendulum", "~/p.yaml"), "p.yaml"),
        (("regressor", "arm2", "--python=~/p.py"), "p.py"),
    ],
)
def test_a_path_may_begin_at_home(
    dmframe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], written: str
) -> None:
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
    assert dmframe(*words).status == 0
    assert (tmp_path / "home" / written).is_file()
    assert not (tmp_path / "~").exists()


def test_an_unknown_home_folder_is_reported(dmframe: Any) -> None:
    reported = dmframe("draw", "pendulum", "--out=~no_such_user/p.svg")
    expected = "~no_such_user/p.svg: unknown user; give the full path"
    assert (reported.status, reported.err) == (2, f"dmframe: {expected}\n")


def test_new_copies_a_graph_letter_by_letter_and_states_what_to_do(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("new", "pendulum", "mine.yaml")
    assert (reported.status, reported.out) == (0, "wrote mine.yaml; try: dmframe run mine.yaml\n")
    first, _, rest = tmp_path.joinpath("mine.yaml").read_text().partition("\n")
    assert first == "# yaml-language-server: $schema=dmframe.schema.json"
    assert rest == graphs()["pendulum"].read_text()


def test_new_names_the_file_after_the_graph(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("new", "pendulum").status == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dmframe.schema.json", "pendulum.yaml"]


def test_new_never_overwrites_a_file(dmframe: Any, tmp_path: Path) -> None:
    tmp_path.joinpath("mine.yaml").write_text("precious", encoding="utf-8")
    reported = dmframe("new", "pendulum", "mine.yaml")
    assert (reported.status, reported.out) == (2, "")
    assert reported.err == "dmframe: mine.yaml: exists already; choose a new file\n"
    assert tmp_path.joinpath("mine.yaml").read_text() == "precious"


def test_new_states_where_it_cannot_write(dmframe: Any) -> None:
    reported = dmframe("new", "pendulum", "no/mine.yaml")
    expected = "dmframe: no/mine.yaml: the folder no does not exist; create it first, or choose another\n"
    assert (reported.status, reported.err) == (2, expected)


def test_check_names_each_block_wire_size_and_derived_signal(dmframe: Any) -> None:
    reported = dmframe("check", "ur10_fast")
    assert (reported.status, reported.err) == (0, "")
    assert "clock     every 8 ms, for 200 s" in reported.out
    assert "p = 36 (model)" in reported.out
    wires = {line.split()[0]: line for line in reported.out.splitlines() if "<-" in line}
    assert wires["servo.dq_c"].split()[2] == "inverse.dq_c"
    assert wires["model.ddq_ref"].split()[2:] == ["d/dt", "model.dq_ref", "3", "rad/s^2"]
    assert "0 (not driven)" in wires["dynamics.tau_task"]


def test_check_takes_overrides(dmframe: Any) -> None:
    assert "continuous time" in dmframe("check", "ur10_fast", "--set", "clock=continuous").out
    assert "every 4 ms" in dmframe("check", "ur10_fast", "--set", "clock=4 ms").out


def test_check_leaves_no_file(dmframe: Any, tmp_path: Path) -> None:
    dmframe("check", "pendulum")
    assert list(tmp_path.iterdir()) == []


def test_blocks_lists_every_type(dmframe: Any) -> None:
    reported = dmframe("blocks")
    assert (reported.status, reported.err) == (0, "")
    listed = {line.split()[0] for line in reported.out.splitlines() if line.startswith("  ")}
    assert listed == set(block_types())


@pytest.fixture
def page_of(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """`dmframe blocks kind` in so many columns: computed once for several tests that read a page."""

    def made(kind: str, columns: int = 80) -> Any:
        if (kind, columns) not in PRINTED:
            monkeypatch.setenv("COLUMNS", str(columns))
            PRINTED[kind, columns] = dmframe("blocks", kind)
        return PRINTED[kind, columns]

    return made


@pytest.mark.parametrize("kind", block_types())
def test_a_blocks_page_has_its_ports_states_and_parameters(kind: str, page_of: Callable[..., Any]) -> None:
    reported = page_of(kind)
    block = block_types()[kind]
    assert (reported.status, reported.err) == (0, "")
    named = [*block.inputs, *block.outputs, *block.states]
    assert all(f"\n  {item.name} " in reported.out for item in named)
    assert all(f"\n  {name} " in reported.out for name in block.model_fields)
    assert ":math:" not in reported.out
    assert "]_" not in reported.out


@pytest.mark.parametrize("kind", block_types())
@pytest.mark.parametrize("columns", [80, 120])
def test_a_page_keeps_to_the_terminal_and_breaks_no_norm(kind: str, columns: int, page_of: Callable[..., Any]) -> None:
    lines = page_of(kind, columns).out.splitlines()
    shown = ["".join(letter for letter in line if not unicodedata.combining(letter)) for line in lines]
    law = shown[: shown.index("inputs")]
    assert all(len(line) <= columns for line in law)
    if columns == 120:  # in 80 columns some norms are too long for one line
        assert all(line.count("|") % 2 == 0 for line in law)


def test_a_page_is_of_120_columns_where_nothing_states_how_wide_it_may_be(
    dmframe: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    widths = [len(line) for line in dmframe("blocks", "pid_inverse").out.splitlines()]
    assert 112 < max(widths) <= 130  # with its accents


@pytest.mark.parametrize("kind", block_types())
def test_a_page_has_no_pythonisms_and_no_marks(kind: str, page_of: Callable[..., Any]) -> None:
    page = page_of(kind).out
    assert re.search(r"\\[a-z]+|\$|``|\b(True|False)\b|\('", page) is None
    assert re.search(r"[\w)]\[\d*:?\d*\]", page) is None


def test_the_list_of_blocks_has_no_marks_either(dmframe: Any) -> None:
    assert "\n  friction      option  [viscous]\n" in dmframe("blocks", "regressor").out
    listed = dmframe("blocks").out
    assert "so that q_r of the inverse is the path itself" in listed
    assert ":math:" not in listed


def test_a_page_states_where_sizes_are_those_of_an_example_and_what_its_operations_are(
    dmframe: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    page = dmframe("blocks", "mass_estimate").out
    assert "law; the sizes that show are those of an example, a robot of three joints" in page
    assert "M(q, (â_d)_(1…30))" in page
    assert "counted from 1, both ends included" in page
    page = dmframe("blocks", "dynamic_compensator").out
    assert "three joints" not in page
    assert "\n  clip(vector, width)    each element limited to [-width, width]\n" in page
    assert "\ntrue values, which its certificate alone reads\n  a_d  a_d  (p)  -\n" in page


def test_what_a_block_states_for_others_is_separate_from_its_law(dmframe: Any) -> None:
    law, stated = dmframe("blocks", "filtered_regulation").out.split("true values that it states")
    assert "task_weight" not in law
    assert "\n  task_weight = α\n" in stated
    assert "task_weight is the weight of the task level in V" in " ".join(stated.split())


def test_a_users_own_block_has_a_page(dmframe: Any, tmp_path: Path) -> None:
    source = block_types()["kinematic_command"]
    text = Path(__import__(source.__module__, fromlist=["x"]).__file__).read_text(encoding="utf-8")
    tmp_path.joinpath("mine.py").write_text(text, encoding="utf-8")
    assert dmframe("blocks", "mine.py:KinematicCommand").out.startswith("kinematic_command (controller)")


def test_draw_prints_mermaid_and_writes_svg(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("draw", "pendulum")
    assert (reported.status, reported.err) == (0, "")
    assert "flowchart" in reported.out
    reported = dmframe("draw", "pendulum", "-o", "p.svg")
    assert (reported.status, reported.out) == (0, "wrote p.svg\n")
    texts = "".join(ElementTree.parse(tmp_path / "p.svg").getroot().itertext())
    assert all(name in texts for name in ("path", "task", "model", "dynamics", "inverse", "servo", "arm"))
    assert dmframe("draw", "pendulum", "-o", "p.mmd").status == 0
    assert "flowchart" in tmp_path.joinpath("p.mmd").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    """Validator with the output of `dmframe schema`, which describes every block."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["dmframe", "schema"])
        with pytest.raises(SystemExit) as stopped:
            main()
    assert (stopped.value.code or 0, err.getvalue()) == (0, "")
    loaded = json.loads(out.getvalue())
    jsonschema.Draft202012Validator.check_schema(loaded)
    return jsonschema.Draft202012Validator(loaded)


def test_the_schema_accepts_every_packaged_graph(schema: jsonschema.Draft202012Validator) -> None:
    for path in graphs().values():
        schema.validate(read_file(path).data)


BAD = {
    "unknown parameter": ("  task:     {type: joint_tracking, alfa: 2}", "alfa"),
    "missing parameter": ("  task:     {type: joint_tracking}", "alpha_bar"),
    "unknown type": ("  task:     {type: joint_trackin, alpha_bar: 2}", "joint_trackin"),
    "no type": ("  task:     {alpha_bar: 2}", "type"),
    "wrong kind of value": ("  task:     {type: joint_tracking, alpha_bar: {a: 2}}", "a"),
}


@pytest.mark.parametrize("case", BAD)
def test_the_schema_refuses_a_bad_block(case: str, schema: jsonschema.Draft202012Validator) -> None:
    line, culprit = BAD[case]
    good = graphs()["pendulum"].read_text(encoding="utf-8")
    bad = good.replace("  task:     {type: joint_tracking, alpha_bar: 2}", line)
    assert bad != good
    faults = list(schema.iter_errors(read_document(bad, "bad.yaml").data))
    assert any(culprit in fault.message for fault in faults)


@pytest.mark.parametrize("change", [("dmframe: 1", "dmframe: 2"), ("clock:", "clok:"), ("duration: 30 s\n", "")])
def test_the_schema_refuses_a_bad_file(change: tuple[str, str], schema: jsonschema.Draft202012Validator) -> None:
    bad = graphs()["pendulum"].read_text(encoding="utf-8").replace(*change)
    assert not schema.is_valid(read_document(bad, "bad.yaml").data)


def test_the_schema_accepts_a_robot_by_name_or_in_full_and_a_users_block(
    schema: jsonschema.Draft202012Validator,
) -> None:
    good = read_file(graphs()["pendulum"]).data
    schema.validate({**good, "robot": {"model": "ur10", "hold": {"wrist_2_joint": "-90 deg"}, "tool": [0, 0, 0.1]}})
    schema.validate({**good, "blocks": {**good["blocks"], "mine": {"type": "mine.py:Mine", "anything": 1}}})
    assert not schema.is_valid({**good, "robot": {"model": "ur10", "holt": {}}})


def test_the_regressor_names_its_parameters_and_agrees_with_pinocchio(dmframe: Any) -> None:
    reported = dmframe("regressor", "arm2", "--friction", "viscous")
    assert (reported.status, reported.err) == (0, "")
    assert reported.out.startswith("arm2: 22 parameters: m_1, mc_x1,")
    assert "B_1, B_2\n" in reported.out
    differences = reported.out.split("Pinocchio: ")[1].replace(",", "").split()
    assert float(differences[1]) < 1e-10
    assert float(differences[3]) < 1e-10


UR10 = ("--free", "shoulder_pan_joint,shoulder_lift_joint,elbow_joint", "--hold", "wrist_2_joint=-90 deg")


@pytest.mark.parametrize(("friction", "count"), [("", 15), ("viscous", 18), ("viscous,coulomb", 21)])
def test_the_ur10_with_three_joints_has_the_known_number_of_base_parameters(
    friction: str, count: int, dmframe: Any
) -> None:
    reported = dmframe("regressor", "ur10", "--base", *UR10, "--friction", friction)
    assert reported.out.startswith(f"ur10: {count} base parameters of ")


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_regressors_c_compiles_without_a_warning_and_computes_pinocchios_torque(
    dmframe: Any, tmp_path: Path
) -> None:
    reported = dmframe("regressor", "arm2", "--c", "y.c")
    assert (reported.status, reported.out.splitlines()[-1]) == (0, "wrote y.c")
    subprocess.run(
        ["gcc", "-std=c99", "-Wall", "-Werror", "-O1", "-fPIC", "-shared", "y.c", "-o", "y.so", "-lm"],
        cwd=tmp_path,
        check=True,
    )
    library = ctypes.CDLL(str(tmp_path / "y.so"))
    model = pin.buildModelFromUrdf(str(find_robot("arm2").urdf))
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 2))
    Y_d = np.zeros((2, 20))
    library.dmframe_regressor(*(np.ascontiguousarray(a).ctypes.data_as(ctypes.c_void_p) for a in (q, dq, dq, ddq, Y_d)))
    wanted = pin.rnea(model, model.createData(), q, dq, ddq)
    a_d = np.concatenate([model.inertias[joint].toDynamicParameters() for joint in (1, 2)])
    np.testing.assert_allclose(Y_d @ a_d, wanted, rtol=1e-10, atol=1e-10)
