"""One flipped bit in any file of a folder of results is reported by each reader."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import MissingError, OutputError
from dmframe.common.files import hidden_name
from dmframe.common.seal import BrokenSeal, FolderSeal, faults, opened, seal_of, sealed
from dmframe.export.folder import write_all
from dmframe.results.place import built, complete, reserved
from dmframe.results.run import Run

pytestmark = pytest.mark.usefixtures("without_v")

GRAPH = dm.load("arm2_joint")


@pytest.fixture(scope="module")
def drive() -> Run:
    return GRAPH.drive("sim:1", until="0.04 s", ramp="0.02 s", engine="interpreted")


@pytest.fixture
def log(drive: Run, tmp_path: Path) -> Path:
    return drive.save(tmp_path / "log", formats=["svg"])


def again(log: Path) -> Any:
    return GRAPH.replay(log, engine="interpreted")


def flipped(content: bytes, bit: int) -> bytes:
    return content[: bit // 8] + bytes([content[bit // 8] ^ (1 << bit % 8)]) + content[bit // 8 + 1 :]


@pytest.mark.parametrize(("bits", "plots"), [(2, False), (8, True)], ids=["data", "data and figures"])
def test_one_flipped_bit_of_any_file_is_reported_with_the_files_name(
    bits: int, plots: bool, drive: Run, tmp_path: Path
) -> None:
    log = drive.save(tmp_path / "log", plots=plots, formats=["svg"])
    files, random = sorted(path for path in log.iterdir()), np.random.default_rng(0)
    names = {"signals.nc", "graph.yaml", "summary.json", "provenance.json", "seal.json"} | (
        {"error.svg"} if plots else set()
    )
    assert {path.name for path in files} >= names
    for path in files:
        whole = path.read_bytes()
        for bit in random.integers(0, 8 * len(whole), bits):
            path.write_bytes(flipped(whole, int(bit)))
            with pytest.raises(MissingError, match=f"expected unchanged files: {path.name}"):
                again(log)
        path.write_bytes(whole)
    assert again(log).identical


def test_a_file_that_is_gone_is_reported(log: Path) -> None:
    (log / "summary.json").unlink()
    with pytest.raises(MissingError, match=r"summary.json is missing or cannot be read"):
        again(log)


def test_without_a_seal_or_a_mark_of_its_end_a_record_is_called_incomplete(log: Path, tmp_path: Path) -> None:
    seal = seal_of(log)
    assert seal is not None
    assert seal.complete
    assert not again(log).notices
    (log / "seal.json").write_text(FolderSeal(seal.files, complete=False).text)
    assert "is incomplete: its writer was stopped before the last file" in str(again(log))
    (log / "seal.json").unlink()
    assert "has no seal.json: it is incomplete or older" in str(again(log))
    again_there = tmp_path / "log" / "other.nc"
    (log / "signals.nc").rename(again_there)
    (log / "seal.json").write_text(FolderSeal({}, complete=True).text)
    assert "other.nc is not among the files of seal.json" in str(again(again_there))


@pytest.mark.parametrize("label", ["inverse.dq_c", "robot.sent", "dynamics.a_d_hat"])
def test_a_replay_compares_each_signal_that_it_names(drive: Run, tmp_path: Path, label: str) -> None:
    recording = drive.recording
    values = np.array(recording[label])
    values[5:] = values[5]
    if label in recording.beside:
        series = {**recording.beside, label: replace(recording.beside[label], values=values)}
        changed = replace(recording, beside=series)
    elif label in recording.outputs:
        changed = replace(recording, outputs={**recording.outputs, label: values})
    else:
        changed = replace(recording, states={**recording.states, label: values})
    found = again(Run(drive.graph, changed).save(tmp_path / "log", plots=False))
    assert not found.identical
    assert found.differs == 6
    assert [name for name, item in found.summary["compared"].items() if not item["identical"]] == [label]
    assert f"  {label}: largest difference at t = " in str(found)


def test_a_replay_states_what_it_has_compared_and_by_which_engine(log: Path) -> None:
    found = again(log)
    states = sum(label in found.compared for label in (item.label for item in GRAPH.diagram.loop.controller))
    assert states >= 4
    assert str(found) == (
        f"arm2_joint: inverse.dq_c, robot.sent and {states} states of the controller of {len(found.time)} samples of "
        f"{log}, recomputed by the interpreted engine: identical, bit by bit"
    )
    assert found.summary["engine"] == found.summary["engine_of_record"] == "interpreted"
    assert set(found.summary["compared"]) == {"inverse.dq_c", "robot.sent"} | set(list(found.compared)[2:])


def test_another_limit_of_the_gate_is_seen_in_what_it_let_through(drive: Run, tmp_path: Path) -> None:
    limits = {**drive.recording.drive["limits"], "speed": ["0.01", "0.01"]}
    changed = replace(drive.recording, drive={**drive.recording.drive, "limits": limits})
    found = again(Run(drive.graph, changed).save(tmp_path / "log", plots=False))
    assert [label for label, item in found.compared.items() if item.rows.size] == ["robot.sent"]
    unknown = replace(drive.recording, drive={})
    found = again(Run(drive.graph, unknown).save(tmp_path / "older", plots=False))
    assert "robot.sent is not compared: the limits of the drive are not in the record" in str(found)


def test_a_graph_of_a_folder_that_was_edited_is_loaded_with_a_notice(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dm.load(log / "graph.yaml")
    assert capsys.readouterr().err == ""
    (log / "graph.yaml").write_text((log / "graph.yaml").read_text().replace("duration: ", "duration:  "))
    dm.load(log / "graph.yaml")
    assert "notice: graph.yaml was changed" in capsys.readouterr().err


def test_several_runs_share_a_seal(tmp_path: Path, drive: Run) -> None:
    from dmframe.results.folder import write_run

    write_run(tmp_path / "out", [drive, replace(drive, label="again")], plots=False)
    assert again(tmp_path / "out" / "again").identical
    summary = tmp_path / "out" / "again" / "summary.json"
    summary.write_text(summary.read_text() + " ")
    with pytest.raises(MissingError, match=r"again/summary.json was changed"):
        again(tmp_path / "out" / "again")


def test_figures_that_follow_are_sealed_and_a_lost_seal_is_reported(tmp_path: Path) -> None:
    with reserved(tmp_path / "out") as place:
        with built(place) as building:
            (building / "graph.yaml").write_text("dmframe: 1")
        assert faults(place.folder) == []
        (place.folder / "error.svg").write_text("<svg/>")
        (place.folder / "mine.txt").write_text("of the user")
        (place.folder / hidden_name()).write_text("half")
        complete(place)
        seal = seal_of(place.folder)
        assert seal is not None
        assert set(seal.files) == {"graph.yaml", "error.svg"}
        (place.folder / "seal.json").unlink()
        with pytest.raises(OutputError, match=r"seal.json, written with the data, is missing"):
            complete(place)


def test_an_export_takes_the_lock_of_a_run_and_writes_over_nothing(tmp_path: Path) -> None:
    with reserved(tmp_path / "out"), pytest.raises(OutputError, match="another process writes there"):
        write_all(tmp_path / "out", {"a.c": "1"})
    assert write_all(tmp_path / "out", {"a.c": "1", "b/c.h": "2"})[1].read_text() == "2"
    with pytest.raises(OutputError, match=r"a.c: exists already"):
        write_all(tmp_path / "out", {"new.c": "3", "a.c": "4"})
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.c", "b"]


def test_a_sealed_text_is_its_bytes() -> None:
    text = sealed({"a": 1, "b": [0.1, "ü"]})
    assert opened(text.encode()) == {"a": 1, "b": [0.1, "ü"]}
    for other in (text.replace("1,", "2,"), text.replace("\n", "\r\n"), text[:-1], text + " ", "[]", "{}", '{"a": 1}'):
        with pytest.raises(BrokenSeal):
            opened(other.encode())


KILLED = """
import os, signal
from dmframe.results import folder
folder.write_bytes = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)
from dmframe.cli import main
main()
"""


def test_a_run_that_was_killed_between_data_and_figures_is_called_incomplete(tmp_path: Path) -> None:
    words = ["run", "arm2_joint", "--until", "0.04", "--engine", "interpreted", "--out", "log"]
    found = subprocess.run([sys.executable, "-c", KILLED, *words], cwd=tmp_path, capture_output=True, check=False)
    assert found.returncode == -signal.SIGKILL
    files = {path.name for path in (tmp_path / "log").iterdir()}
    assert {"signals.nc", "seal.json"} <= files
    assert not any(name.endswith(".svg") for name in files)
    assert json.loads((tmp_path / "log" / "seal.json").read_text())["complete"] is False
    assert "is incomplete" in str(again(tmp_path / "log"))


def test_everything_is_forced_to_the_disk_before_it_has_its_name(
    tmp_path: Path, drive: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    forced, renames = list[str](), list[tuple[str, int]]()
    fsync, rename = os.fsync, os.rename

    def noted(descriptor: int) -> None:
        forced.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def named(source: Any, target: Any) -> None:
        renames.append((str(source), len(forced)))
        rename(source, target)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "rename", named)
    drive.save(tmp_path / "out", plots=False)
    ((building, count),) = [item for item in renames if ".part" in item[0]]
    names = {"signals.nc", "graph.yaml", "summary.json", "provenance.json", "seal.json"}
    assert {f"{building}/{name}" for name in names} <= set(forced[:count])
    assert str(tmp_path) in forced[count:]
