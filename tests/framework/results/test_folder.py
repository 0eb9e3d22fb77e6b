from __future__ import annotations

import errno
import hashlib
import json
import os
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import dmframe.results.folder as folder_module
import dmframe.results.run as run_module
from dmframe.common.errors import OutputError
from dmframe.common.files import hidden_name, write_bytes
from dmframe.common.seal import seal_of
from dmframe.config.resolved import resolved_text
from dmframe.graph.graph import Graph
from dmframe.results.folder import safe_name, write_data, write_run
from dmframe.results.place import reserved
from dmframe.results.run import Run
from dmframe.simulate import simulate


def reserve(path):
    """Lock a folder for a short time."""
    with reserved(path) as place:
        return place.path


def test_one_graph_leaves_data_summary_graph_and_provenance(tmp_path, ur10):
    (data,) = write_run(tmp_path / "out", [ur10], plots=False)
    names = {item.name for item in (tmp_path / "out").iterdir()}
    assert names == {"signals.nc", "summary.json", "graph.yaml", "provenance.json", "seal.json"}
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == data
    assert data["out"] == str(tmp_path / "out")


def test_signals_come_back_with_their_units(tmp_path, ur10):
    write_run(tmp_path / "out", [ur10], plots=False)
    import xarray

    with xarray.open_dataset(tmp_path / "out" / "signals.nc", engine="h5netcdf") as data:
        assert np.array_equal(data["arm.x"].values, ur10.recording["arm.x"])
        assert data["arm.x"].attrs["units"] == "m"
        assert data["arm.q"].encoding["zlib"]
        assert np.array_equal(data.time.values, ur10.recording.time)


@pytest.mark.parametrize("name", ["ur10_fast_tuned", "ur10_slow_kinematic", "pendulum", "arm2_joint"])
def test_the_resolved_graph_loads_again_and_gives_the_same_run(tmp_path, make_result, name):
    result = make_result(name, 0.2, "clock=10 ms")
    write_run(tmp_path / "out", [result], plots=False)
    again = Graph.read(tmp_path / "out" / "graph.yaml")
    run = simulate(again.diagram, again.file.duration, clock=again.file.clock, solver=again.solver, start=again.start)
    assert resolved_text(again) == resolved_text(result.graph)
    assert run.clock == 0.01
    for label in (*run.states, *run.outputs):
        assert np.array_equal(run[label], result.recording[label])


def test_overrides_and_defaults_are_in_the_resolved_graph(make_result):
    text = resolved_text(make_result("ur10_fast", 0.05, "dynamics.Gamma=7", "inverse.w_box=[0, 0.004]").graph)
    assert "Gamma: 7.0" in text
    assert "w_box: [0.0, 0.004]" in text
    assert "method: rk4" in text  # a default
    assert "plane: xy" in text


def test_a_graph_with_a_users_block_and_urdf_takes_them_along(tmp_path, make_result):
    source = Graph.read("pendulum")
    block = "from dmframe_blocks.joint_tracking import JointTracking\n\n\nclass MyTracking(JointTracking):\n    pass\n"
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "mine.py").write_text(block, encoding="utf-8")
    from dmframe.robot.library import find_robot

    (tmp_path / "sub" / "arm.urdf").write_bytes(find_robot("pendulum").urdf.read_bytes())
    text = resolved_text(source).replace("type: joint_tracking", "type: sub/mine.py:MyTracking")
    text = text.replace("model: pendulum", "model: sub/arm.urdf")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    result = make_result(tmp_path / "own.yaml", 0.1)
    write_run(tmp_path / "out", [result], plots=False)
    assert {"mine.py", "arm.urdf"} < {item.name for item in (tmp_path / "out").iterdir()}
    again = Graph.read(tmp_path / "out" / "graph.yaml")
    assert type(again.blocks["task"]).__name__ == "MyTracking"
    assert resolved_text(again) == resolved_text(result.graph)


def test_several_graphs_have_a_folder_each_with_distinct_names(tmp_path, kinematic, pendulum):
    summaries = write_run(tmp_path / "out", [kinematic, pendulum, kinematic], plots=False)
    names = ["ur10_fast_kinematic", "pendulum", "ur10_fast_kinematic_2"]
    assert [item["out"] for item in summaries] == [str(tmp_path / "out" / name) for name in names]
    assert all((tmp_path / "out" / name / "signals.nc").is_file() for name in names)


def test_provenance_has_versions_digests_command_time_and_seed(tmp_path, ur10, monkeypatch):
    before = datetime.now(UTC).replace(microsecond=0)
    monkeypatch.setattr(sys, "argv", ["dmframe", "run", "ur10_fast"])
    write_run(tmp_path / "out", [replace(ur10, graph=ur10.graph.set(seed=5))], plots=False)
    provenance = json.loads((tmp_path / "out" / "provenance.json").read_text())
    text = (tmp_path / "out" / "graph.yaml").read_bytes()
    assert provenance["graph_sha256"] == hashlib.sha256(text).hexdigest()
    assert before <= datetime.fromisoformat(provenance["time"]) <= datetime.now(UTC)
    assert provenance["seed"] == 5
    assert provenance["command"] == ["dmframe", "run", "ur10_fast"]
    assert provenance["versions"]["numpy"] == np.__version__
    assert len(provenance["urdf_sha256"]) == 64


def test_a_folder_with_files_is_refused_and_left_alone(tmp_path, ur10):
    (tmp_path / "kept.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="expected an empty or a new folder, found one with files; name another"):
        reserve(tmp_path)
    with pytest.raises(OutputError, match="found one with files"):
        write_run(tmp_path, [ur10])
    assert [item.name for item in tmp_path.iterdir()] == ["kept.txt"]


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "out").write_text("", encoding="utf-8")
    with pytest.raises(OutputError, match="expected a folder, found a file"):
        reserve(tmp_path / "out")
    with pytest.raises(OutputError, match="the results cannot be written"):
        reserve(tmp_path / "out" / "deeper")


def test_an_empty_folder_is_taken_and_parents_are_made(tmp_path, kinematic):
    (tmp_path / "empty").mkdir()
    write_run(tmp_path / "empty", [kinematic], plots=False)
    write_run(tmp_path / "a" / "b", [kinematic], plots=False)
    assert (tmp_path / "empty" / "signals.nc").is_file()
    assert (tmp_path / "a" / "b" / "signals.nc").is_file()


def test_reserving_leaves_nothing_behind(tmp_path):
    assert reserve(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fault", [RuntimeError("from a figure"), KeyboardInterrupt()])
def test_a_fault_in_the_middle_leaves_nothing(tmp_path, ur10, monkeypatch, fault):
    def fail(*_):
        raise fault

    monkeypatch.setattr(folder_module, "netcdf", fail)
    with pytest.raises(type(fault)):
        write_run(tmp_path / "new" / "out", [ur10])
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_reported_with_the_folder_and_a_remedy_and_leaves_nothing(tmp_path, ur10, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "_write_json", full)
    with pytest.raises(OutputError, match="out: the results cannot be written: no space left on device; free some"):
        write_run(tmp_path / "out", [ur10])
    assert list(tmp_path.iterdir()) == []


def test_figures_that_cannot_be_drawn_lose_no_data(tmp_path, ur10, monkeypatch):
    for fault, text in (
        (OSError(errno.ENOSPC, "No space left on device"), "written, the figures cannot be written: no space left"),
        (ValueError("a name that no parser reads"), "the figures are not: ValueError: a name that no parser reads"),
    ):

        def fail(*_, fault=fault):
            raise fault

        place = tmp_path / type(fault).__name__
        monkeypatch.setattr("dmframe.results.drawing_process.files_of", fail)
        with pytest.raises(OutputError, match="signals and summary are written") as caught:
            write_run(place, [ur10])
        assert text in caught.value.text
        assert {item.name for item in place.iterdir()} == {
            "signals.nc",
            "summary.json",
            "graph.yaml",
            "provenance.json",
            "seal.json",
        }


def test_v_is_computed_once_for_notices_data_and_its_figure(tmp_path, make_result, monkeypatch):
    computed, storage_of = [], run_module.storage_of
    monkeypatch.setattr(run_module, "storage_of", lambda *given: computed.append(given) or storage_of(*given))
    (data,) = write_run(tmp_path / "out", [make_result("pendulum", 0.2)])
    assert data["storage"]["start"] > 0
    assert (tmp_path / "out" / "storage.svg").is_file()
    assert len(computed) == 1


def test_hdf5_never_meets_the_disk_itself(tmp_path, ur10, monkeypatch):
    """On a full disk it would print tracebacks and could end the process."""

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(OutputError, match="no space left on device; free some space"):
        write_run(tmp_path / "out", [ur10], plots=False)
    assert list(tmp_path.iterdir()) == []


def test_results_of_a_diverged_run_are_written(tmp_path, ur10, blow_up):
    write_run(tmp_path / "out", [Run(ur10.graph, blow_up(ur10.recording, 0.4))], plots=False)
    data = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert data["diverged"]
    assert data["error"]["rms_by_eighth"][4:] == [None] * 4


def test_a_locked_folder_cannot_be_written_by_another_run(tmp_path, kinematic):
    with reserved(tmp_path / "out") as place:
        with pytest.raises(OutputError, match="out: another process writes there; name another folder"):
            reserve(tmp_path / "out")
        write_run(place, [kinematic], plots=False)
    with pytest.raises(OutputError, match="found one with files"):
        reserve(tmp_path / "out")


def test_a_folder_is_held_until_figures_are_there_too(tmp_path, kinematic):
    with reserved(tmp_path / "out") as place:
        write_data(place, [kinematic])
        with pytest.raises(OutputError, match="another process writes there"):
            write_run(tmp_path / "out", [kinematic], plots=False, force=True)
    write_run(tmp_path / "out", [kinematic], plots=False, force=True)


def test_results_in_a_folder_that_cannot_be_read_keep_their_seal(tmp_path, kinematic, monkeypatch):
    opened = os.open

    def denied(path, flags, *rest, **more):
        if flags & os.O_DIRECTORY and Path(path) == tmp_path:
            raise PermissionError(13, "Permission denied")
        return opened(path, flags, *rest, **more)

    monkeypatch.setattr(os, "open", denied)
    write_run(tmp_path / "out", [kinematic], plots=False)
    seal = seal_of(tmp_path / "out")
    assert seal is not None
    assert seal.complete
    write_bytes(tmp_path / "page.html", b"x")
    assert (tmp_path / "page.html").read_bytes() == b"x"


def test_what_a_killed_run_left_is_in_nobodys_way(tmp_path, kinematic):
    left = tmp_path / "out" / hidden_name()
    left.mkdir(parents=True)
    (left / "signals.nc").write_text("", encoding="utf-8")
    write_run(tmp_path / "out", [kinematic], plots=False)
    assert len(list((tmp_path / "out").iterdir())) == 5


@pytest.mark.parametrize(
    ("name", "safe"), [("a.b", "a_b"), (".", "graph"), ("-x", "x"), ("größe", "größe"), ("é" * 200, "é" * 75)]
)
def test_names_of_folders_are_safe(name, safe):
    assert safe_name(name) == safe
