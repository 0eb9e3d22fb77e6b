"""``dmframe run``: figures, files, JSON, statuses."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from dmframe.common.errors import ValueFault
from dmframe.graph.graph import Graph
from dmframe.results.place import FIGURES, OF_EACH

CONTRACT = {"graph", "duration", "clock", "diverged", "error", "engine", "wall_time", "real_time_factor", "out"}
EXTRAS = {
    "bounds", "bounds_missing", "divergence", "interrupted", "notices", "rank", "shown", "solver", "storage", "turn"
}  # fmt: skip
FILES_END = (".yaml", ".json", ".nc")
FILES = {"graph.yaml", "provenance.json", "seal.json", "signals.nc", "summary.json"}
SHORT = ("--until", "0.5 s", "--no-plots")
UNBOXED = ("--set", "dynamics.a_d_hat_box=null", "--set", "inverse.w_box=null")
UNSTABLE = ("run", "arm2_joint", "--no-plots", *UNBOXED, "--set", "dynamics.Gamma=1e9")


def strict(text: str) -> Any:
    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


def names_of(figure: object, name: str, about: str, formats: Sequence[str]) -> dict[str, bytes]:
    """The files of a figure if only names matter."""
    return {f"{name}.{ending}": b"" for ending in formats}


@pytest.mark.usefixtures("without_v")
def test_a_run_prints_a_table_and_writes_a_folder(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "mine")
    assert (reported.status, reported.err) == (0, "")
    lines = reported.out.splitlines()
    assert lines[0].split()[:3] == ["graph", "clock", "error"]
    assert lines[1].startswith("arm2_joint")
    assert lines[-1] == "results: mine"
    assert {path.name for path in tmp_path.joinpath("mine").iterdir()} == FILES


@pytest.mark.usefixtures("without_v")
def test_results_go_to_a_folder_of_their_own_below_runs(dmframe: Any, tmp_path: Path) -> None:
    for _ in range(2):
        assert dmframe("run", "arm2_joint", *SHORT).status == 0
    assert len(list(tmp_path.joinpath("runs").glob("*_arm2_joint"))) == 2


def test_json_is_one_object_with_the_keys_of_the_contract_and_nothing_else(dmframe: Any) -> None:
    reported = dmframe("run", "arm2_joint", *SHORT, "--json", "--out", "mine")
    assert (reported.status, reported.err) == (0, "")
    data = strict(reported.out)
    assert set(data) == CONTRACT | EXTRAS
    assert set(data["error"]) == {"signal", "unit", "rms_by_eighth", "rms_final"}
    assert len(data["error"]["rms_by_eighth"]) == 8
    assert data["error"]["rms_final"] == data["error"]["rms_by_eighth"][-1]
    assert data["error"]["unit"] == "rad"
    assert (data["graph"], data["clock"], data["out"]) == ("arm2_joint", 0.002, "mine")
    assert data["duration"] == pytest.approx(0.5)
    assert data["engine"] in ("compiled", "interpreted")
    assert data["diverged"] is False


@pytest.mark.usefixtures("without_v")
def test_json_states_continuous_for_a_continuous_clock(dmframe: Any) -> None:
    assert strict(dmframe("run", "pendulum", *SHORT, "--json").out)["clock"] == "continuous"


@pytest.mark.usefixtures("without_v")
def test_json_of_several_graphs_is_a_list_in_their_order(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "pendulum", "arm2_joint", *SHORT, "--json", "--out", "two")
    assert [data["graph"] for data in strict(reported.out)] == ["pendulum", "arm2_joint"]
    assert {path.name for path in tmp_path.joinpath("two").iterdir()} == {"pendulum", "arm2_joint", "seal.json"}
    assert {path.name for path in tmp_path.joinpath("two", "pendulum").iterdir()} == FILES - {
        "seal.json"
    }  # one for both


def test_json_is_what_the_folder_holds(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "arm2_joint", *SHORT, "--json", "--out", "mine")
    assert strict(reported.out) == strict(tmp_path.joinpath("mine", "summary.json").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("without_v")
def test_the_same_graph_twice_gives_two_results(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("run", "arm2_joint", "arm2_joint", *SHORT, "--out", "two").status == 0
    assert {path.name for path in tmp_path.joinpath("two").iterdir()} == {"arm2_joint", "arm2_joint_2", "seal.json"}


@pytest.mark.usefixtures("without_v")
def test_until_replaces_the_duration(dmframe: Any, tmp_path: Path) -> None:
    assert strict(dmframe("run", "arm2_joint", "--until", "200 ms", "--no-plots", "--json").out)["duration"] == 0.2
    dmframe("run", "arm2_joint", "--until", "0.2", "--no-plots", "--out", "mine")
    import xarray

    signals = xarray.open_dataset(tmp_path / "mine" / "signals.nc", engine="h5netcdf")
    assert float(signals["time"][-1]) == pytest.approx(0.2)


@pytest.mark.usefixtures("without_v")
def test_set_changes_the_run_and_is_written_to_its_graph(dmframe: Any, tmp_path: Path) -> None:
    plain = strict(dmframe("run", "arm2_joint", *SHORT, "--json").out)
    data = strict(
        dmframe(
            "run", "arm2_joint", *SHORT, "--json", "--out", "mine", "--set", "task.alpha_bar=8", "--set", "clock=2 ms"
        ).out
    )
    assert data["clock"] == 0.002
    assert data["error"]["rms_final"] < plain["error"]["rms_final"]
    kept = Graph.read(tmp_path / "mine" / "graph.yaml")
    assert kept.blocks["task"].alpha_bar == 8  # type: ignore[attr-defined]
    assert kept.file.clock == 0.002


@pytest.mark.usefixtures("without_v")
def test_the_resolved_graph_gives_the_same_run(dmframe: Any) -> None:
    first = strict(dmframe("run", "arm2_joint", *SHORT, "--json", "--out", "one").out)
    again = strict(dmframe("run", "one/graph.yaml", "--no-plots", "--json", "--out", "two").out)
    assert again["error"] == first["error"]


def test_figures_are_drawn_by_default(dmframe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("dmframe.common.plotting", "dmframe.results.estimate_figure"):
        monkeypatch.setattr(f"{module}.settle", lambda figure: None)
    assert dmframe("run", "pendulum", "--until", "0.5", "--out", "mine").status == 0
    names = {path.name for path in tmp_path.joinpath("mine").iterdir()}
    assert {"error.svg", "commands.svg"} <= names
    monkeypatch.setattr("dmframe.results.drawing_process.files_of", names_of)
    assert dmframe("run", "pendulum", "--until", "0.5", "--figures", "png,pdf", "--out", "other").status == 0
    names = {path.name for path in tmp_path.joinpath("other").iterdir() if path.suffix not in FILES_END}
    assert names == {f"{name}.{ending}" for name in (*FIGURES, *OF_EACH) for ending in ("png", "pdf")}


def test_a_loop_that_is_unstable_on_its_clock_has_its_notice_in_print_and_in_the_summary(dmframe: Any) -> None:
    reported = dmframe("run", "ur10_slow", "--until", "12", "--no-plots", "--engine", "interpreted", "--out", "mine")
    data = strict(Path("mine", "summary.json").read_text(encoding="utf-8"))
    assert data["storage"]["start"] > 0
    assert [text in reported.out for text in data["notices"]] == [True] * len(data["notices"])
    assert "unstable near its set-point with a clock of 90 ms" in " ".join(data["notices"])


def test_the_numbers_are_printed_before_v_is_computed(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = list[str]()

    def refuse(*_: Any) -> Any:
        shown.append(sys.stdout.getvalue())  # type: ignore[attr-defined]
        raise ValueFault("no V today")

    monkeypatch.setattr("dmframe.results.run.storage_of", refuse)
    assert dmframe("run", "pendulum", "--until", "0.5", "--no-plots", "--out", "mine").status == 0
    assert "q - q_d" in shown[0]
    assert strict(Path("mine", "summary.json").read_text(encoding="utf-8"))["storage"]["reason"] == "no V today"


def test_a_format_that_there_is_not_is_refused_before_the_run(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "pendulum", "--until", "0.5", "--figures", "svg,jpg", "--out", "mine")
    assert reported.status == 2
    assert "--figures: unknown format of figures" in reported.err
    assert not tmp_path.joinpath("mine").exists()


@pytest.mark.usefixtures("without_v")
def test_a_folder_with_files_is_refused_before_the_run(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("run", "arm2_joint", *SHORT, "--out", "mine").status == 0
    before = {path: path.stat().st_mtime_ns for path in tmp_path.joinpath("mine").iterdir()}
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "mine")
    assert (reported.status, reported.out) == (2, "")
    assert reported.err == (
        "dmframe: mine: expected an empty or a new folder, found one with files; name another folder, or use --force\n"
    )
    assert {path: path.stat().st_mtime_ns for path in tmp_path.joinpath("mine").iterdir()} == before


def test_a_file_is_refused_as_a_folder(dmframe: Any, tmp_path: Path) -> None:
    tmp_path.joinpath("mine").write_text("", encoding="utf-8")
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "mine")
    assert (reported.status, reported.err) == (
        2,
        "dmframe: mine: expected a folder, found a file; name another folder\n",
    )


def test_a_folder_that_cannot_be_written_is_reported_before_the_run(dmframe: Any) -> None:
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "/proc/mine")
    assert (reported.status, reported.out) == (2, "")
    assert reported.err == (
        "dmframe: /proc/mine: the results cannot be written: no such file or directory; choose another folder\n"
    )


def test_a_folder_without_the_right_to_write_is_reported(dmframe: Any, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    tmp_path.joinpath("closed").mkdir(mode=0o500)
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "closed/mine")
    assert reported.status == 2
    assert "closed/mine: the results cannot be written: permission denied" in reported.err


def test_a_fault_in_one_of_two_graphs_stops_both(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "arm2_joint", "pendulm", *SHORT, "--out", "mine")
    assert (reported.status, reported.out) == (2, "")
    assert not tmp_path.joinpath("mine").exists()


def test_a_graph_that_has_no_page_is_reported_before_the_first_run(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe("run", "arm2_joint", *SHORT, "--page", "--set", "jitter=0.1 ms", "--out", "mine")
    assert reported.status == 2
    assert reported.err.startswith("dmframe: page: expected a deterministic loop")
    assert reported.out == ""
    assert not tmp_path.joinpath("mine").exists()


def test_a_page_with_a_default_name_replaces_only_an_older_page(dmframe: Any, tmp_path: Path) -> None:
    page = tmp_path / "pendulum.html"
    page.write_text("mine", "utf-8")
    reported = dmframe("page", "pendulum")
    assert (reported.status, page.read_text("utf-8")) == (2, "mine")
    assert "pendulum.html: expected no file or an older live page, found another file" in reported.err
    page.unlink()
    for _ in range(2):
        assert dmframe("page", "pendulum").out == "wrote pendulum.html\n"
    page.write_text("mine", "utf-8")
    assert dmframe("page", "pendulum", "--out", "pendulum.html").status == 0


@pytest.mark.usefixtures("without_v")
def test_divergence_gives_status_1_names_the_culprit_and_keeps_what_was_computed(dmframe: Any, tmp_path: Path) -> None:
    reported = dmframe(*UNSTABLE, "--out", "mine")
    assert (reported.status, reported.err) == (1, "")
    (line,) = (line for line in reported.out.splitlines() if "diverged" in line)
    data = strict(tmp_path.joinpath("mine", "summary.json").read_text(encoding="utf-8"))
    assert line == f"arm2_joint: diverged: {data['divergence']}"
    block, rest = data["divergence"].split(".", 1)
    state, rest = rest.split("[", 1)
    element, rest = rest.split("]", 1)
    words, unit = rest.rsplit(" ", 1)
    import xarray

    signals = xarray.open_dataset(tmp_path / "mine" / "signals.nc", engine="h5netcdf")
    kept = signals[f"{block}.{state}"]
    assert 0 <= int(element) < kept.shape[1]
    assert (words.rsplit(" ", 1)[0], unit) == (" is no longer finite at t =", "s")
    assert float(words.rsplit(" ", 1)[1]) == pytest.approx(float(signals["time"][-1]) + 0.002)
    assert bool(kept.notnull().all())
    assert data["diverged"] is True


@pytest.mark.usefixtures("without_v")
def test_divergence_is_valid_json_with_null_where_the_run_never_came(dmframe: Any) -> None:
    reported = dmframe(*UNSTABLE, "--json")
    assert reported.status == 1
    data = strict(reported.out)
    assert data["diverged"] is True
    assert data["error"]["rms_final"] is None


@pytest.mark.usefixtures("without_v")
def test_one_diverged_graph_of_two_gives_status_1_and_both_results(dmframe: Any, tmp_path: Path) -> None:
    good = tmp_path / "good.yaml"
    assert dmframe("run", "arm2_joint", *SHORT, "--set", "dynamics.a_d_hat_box=null", "--out", "one").status == 0
    good.write_text(tmp_path.joinpath("one", "graph.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    bad = tmp_path / "bad.yaml"
    bad.write_text(good.read_text(encoding="utf-8").replace("Gamma: 100.0", "Gamma: 1.0e+300"), encoding="utf-8")
    reported = dmframe("run", "bad.yaml", "good.yaml", "--no-plots", "--json")
    assert reported.status == 1
    assert [data["diverged"] for data in strict(reported.out)] == [True, False]


@pytest.mark.usefixtures("without_v")
def test_a_stiff_plant_is_noticed(dmframe: Any) -> None:
    reported = dmframe("run", "ur10_fast_kinematic", *SHORT, "--set", "solver.step=2 ms")
    assert reported.status == 0
    assert "ur10_fast_kinematic: notice: the plant is stiff" in reported.out


@pytest.mark.usefixtures("without_v")
def test_sundials_can_be_chosen(dmframe: Any) -> None:
    fixed = strict(dmframe("run", "arm2_joint", *SHORT, "--json").out)
    other = strict(dmframe("run", "arm2_joint", *SHORT, "--json", "--set", "solver.method=cvodes").out)
    assert other["error"]["rms_final"] == pytest.approx(fixed["error"]["rms_final"], rel=1e-4)


@pytest.mark.usefixtures("without_v")
def test_a_name_is_never_taken_for_markup(dmframe: Any, tmp_path: Path) -> None:
    assert dmframe("new", "arm2_joint", "[red]x.yaml").status == 0
    reported = dmframe("run", "[red]x.yaml", *SHORT)
    assert reported.status == 0
    assert reported.out.splitlines()[1].startswith("[red]x ")
    (folder,) = tmp_path.joinpath("runs").iterdir()
    assert folder.name.endswith("_red_x")


@pytest.mark.usefixtures("without_v")
def test_a_message_is_never_taken_for_markup(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    notice = "ld: [/usr/lib/crt1.o]: [bold]undefined[/bold] :smile:"
    monkeypatch.setattr("dmframe.simulate.engine._compiled", lambda step: (None, notice))
    reported = dmframe("run", "arm2_joint", *SHORT, "--engine", "compiled")
    assert reported.status == 0
    assert f"arm2_joint: notice: {notice}\n" in reported.out


@pytest.mark.usefixtures("without_v")
def test_a_full_disk_at_the_end_leaves_the_numbers(dmframe: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("dmframe.results.folder.netcdf", full)
    reported = dmframe("run", "arm2_joint", *SHORT, "--out", "mine")
    assert reported.status == 2
    assert reported.out.splitlines()[1].startswith("arm2_joint")
    assert reported.err.startswith("dmframe: mine: the results cannot be written: no space left on device; free some")


@pytest.mark.usefixtures("without_v")
def test_results_go_to_the_given_folder_whatever_is_there(dmframe: Any, tmp_path: Path) -> None:
    for name in ("here", "far"):
        tmp_path.joinpath(name).mkdir()
    tmp_path.joinpath("link").symlink_to("far")
    long = "a" * 250
    for out in ("link", long):
        assert dmframe("run", "arm2_joint", *SHORT, "--out", out).status == 0
        assert {path.name for path in tmp_path.joinpath(out).iterdir()} == FILES
    assert tmp_path.joinpath("link").is_symlink()
    os.chdir(tmp_path / "here")
    assert dmframe("run", "arm2_joint", *SHORT, "--out", ".").status == 0
    assert {path.name for path in tmp_path.joinpath("here").iterdir()} == FILES


@pytest.mark.usefixtures("without_v")
def test_graphs_of_any_name_are_next_to_their_figures(
    dmframe: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.results.drawing_process.files_of", names_of)
    for module in ("dmframe.common.plotting", "dmframe.results.estimate_figure"):
        monkeypatch.setattr(f"{module}.settle", lambda figure: None)
    names = ("error.png.yaml", "..yaml", "new\nline.yaml", "Error_PNG.yaml")
    for name in names:
        assert dmframe("new", "arm2_joint", name).status == 0
    assert dmframe("run", *names, "--until", "0.1", "--figures", "png, svg", "--out", "mine").status == 0
    held = {path.name: path.is_dir() for path in tmp_path.joinpath("mine").iterdir()}
    assert {name for name, folder in held.items() if folder} == {"error_png", "graph", "new_line", "Error_PNG_2"}
    assert {"error.png", "estimates_new_line.svg"} <= set(held)


def test_an_unknown_engine_is_refused_without_a_place_in_the_graph(dmframe: Any) -> None:
    reported = dmframe("run", "pendulum", *SHORT, "--engine", "fast")
    assert (reported.status, reported.err) == (
        2,
        "dmframe: engine: expected auto, compiled, interpreted, found 'fast'\n",
    )
