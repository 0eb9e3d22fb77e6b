"""A drive writes its samples to the disk while it runs: memory is bounded, and a killed drive loses a few samples."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import pytest

import dmframe as dm
from dmframe.common.errors import MissingError
from dmframe.common.seal import FolderSeal, digest_of
from dmframe.drive import record
from dmframe.runtime.journal import BLOCK, Columns, Journal, Spool, _signed, read_samples
from dmframe.runtime.robot import Sample
from dmframe.runtime.simulated import SimulatedRobot

pytestmark = pytest.mark.usefixtures("without_v")

GRAPH = dm.load("arm2_joint")


class ScaledController:
    """The part of a diagram that a journal reads."""

    def __init__(self) -> None:
        self.command, self.states = np.zeros(2), {"task.z": np.zeros(3)}

    @property
    def controller(self) -> Any:
        return self


def fill(journal: Journal, count: int) -> None:
    scaled: Any = ScaledController()
    for k in range(count):
        scaled.states["task.z"][:] = k
        sample = Sample(0.1 * k, np.array([k, 1.0]), np.array([k, 2.0]), x=np.array([3.0]), missed=k % 2)
        journal.begin(sample, scaled, 0.1 * k, 0.2 * k, 1.0)
        journal.commanded(np.array([k, -k]), np.array([k, 0.5]))
        if k + 1 < count:
            journal.answered(1e-3 * k)
    journal.close()


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1, 3 * BLOCK + 7])
def test_a_file_holds_what_memory_holds(tmp_path: Path, count: int) -> None:
    inside, outside = Journal(), Journal(Spool(tmp_path / "samples.bin", {"graph": "x"}))
    for journal in (inside, outside):
        fill(journal, count)
    assert inside.rows().tobytes() == outside.rows().tobytes()
    assert inside.rows(7).tobytes() == inside.rows()[::7].tobytes() == outside.rows(7).tobytes()
    head, columns = read_samples(tmp_path / "samples.bin")
    assert head["graph"] == "x"
    np.testing.assert_array_equal(columns["state:task.z"][:, 1], np.arange(count))
    np.testing.assert_array_equal(columns["sent"], [[k, 0.5] for k in range(count)])
    assert "q_c" not in columns
    assert np.isnan(columns["answer"][-1, 0])
    assert outside["q"][-1, 0] == count - 1
    assert outside["q_c"].size == 0
    assert np.isnan(outside["age"][-1])
    assert outside["missed"][-1] == (count - 1) % 2


def test_a_row_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "samples.bin"
    fill(Journal(Spool(path, {})), 10)
    path.write_bytes(path.read_bytes()[:-5])
    assert len(read_samples(path)[1]["time"]) == 9
    for content in (b"", b"{}\n", b'{"dmframe-samples": 2}\n', b"\xff\n"):
        path.write_bytes(content)
        with pytest.raises(MissingError, match="expected a record of dmframe"):
            GRAPH.replay(path)


def test_a_damaged_first_line_is_no_other_record(tmp_path: Path) -> None:
    path = tmp_path / "samples.bin"
    GRAPH.drive("sim", until="0.02 s", engine="interpreted", record=path)
    assert GRAPH.replay(path, engine="interpreted").identical
    line, _, rows = path.read_bytes().partition(b"\n")
    head = json.loads(line)
    state = next(name for name in head["columns"] if name.startswith("state:"))
    for other in (
        line.replace(state.encode(), state[:-1].encode() + b"!"),  # a state that would not be compared
        line.replace(b'"ramp"', b'"rqmp"'),
        line.replace(b'"sent"', b'"sgnt"'),
        line.replace(b'"reference"', b'"ruference"'),
        json.dumps({**head, "columns": {}}).encode(),
        json.dumps({**head, "columns": dict.fromkeys(head["columns"], 0)}).encode(),
        json.dumps([head]).encode(),
    ):
        assert other != line
        path.write_bytes(other + b"\n" + rows)
        with pytest.raises(MissingError, match="or a damaged one"):
            GRAPH.replay(path, engine="interpreted")


@pytest.mark.parametrize("value", [np.nan, -1.0, 0.5, 1e300])
def test_a_count_of_lost_samples_is_a_count(tmp_path: Path, value: float) -> None:
    path = tmp_path / "samples.bin"
    GRAPH.drive("sim", until="0.02 s", engine="interpreted", record=path)
    line, _, rows = path.read_bytes().partition(b"\n")
    numbers = np.frombuffer(rows).copy()
    numbers[list(json.loads(line)["columns"]).index("missed")] = value
    path.write_bytes(line + b"\n" + numbers.tobytes())
    with pytest.raises(MissingError, match="expected a count of lost samples"):
        GRAPH.replay(path, engine="interpreted")


def test_a_state_that_the_record_lacks_is_named(tmp_path: Path) -> None:
    path = tmp_path / "samples.bin"
    GRAPH.drive("sim", until="0.02 s", engine="interpreted", record=path)
    line, _, rows = path.read_bytes().partition(b"\n")
    head = json.loads(line)
    head.pop("sha256")
    label = next(name for name in head["columns"] if name.startswith("state:"))
    head["columns"] = {name.replace(label, "state:other"): size for name, size in head["columns"].items()}
    head["columns"] = {"away" if name == "sent" else name: size for name, size in head["columns"].items()}
    path.write_bytes(_signed(head) + rows)
    with pytest.raises(MissingError, match="or a damaged one"):
        GRAPH.replay(path, engine="interpreted")
    head["columns"] = {"sent" if name == "away" else name: size for name, size in head["columns"].items()}
    path.write_bytes(_signed(head) + rows)
    found = GRAPH.replay(path, engine="interpreted")
    assert f"{label.partition(':')[2]} is not compared: not in the record" in str(found)


def test_a_new_record_is_not_judged_by_the_seal_of_an_older_one(tmp_path: Path) -> None:
    path = tmp_path / "samples.bin"
    path.write_bytes(b"older")
    (tmp_path / "seal.json").write_text(FolderSeal({path.name: digest_of(path)}, complete=True).text, encoding="utf-8")
    with pytest.raises(MissingError):
        GRAPH.replay(path, engine="interpreted")
    GRAPH.drive("sim", until="0.02 s", engine="interpreted", record=path)
    found = GRAPH.replay(path, engine="interpreted")
    assert found.identical
    assert "has no seal.json" in str(found)


def test_memory_does_not_grow_with_what_is_on_the_disk(tmp_path: Path) -> None:
    journal = Journal(Spool(tmp_path / "samples.bin", {}))
    fill(journal, 4 * BLOCK)
    assert journal._blocks == []
    assert journal._block.nbytes <= BLOCK * journal.columns.width * 8


def test_a_long_drive_is_thinned_out_and_its_samples_are_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "MOST_BYTES", 20_000)
    run = GRAPH.drive("sim:1", until="0.2 s", engine="interpreted", record=tmp_path / "samples.bin")
    every = run.recording.drive["every"]
    assert every > 1
    assert len(run.time) == -(-101 // every)
    assert f"signals and figures have one of {every} samples; samples.bin has all 101" in " ".join(run.notices)
    found = GRAPH.replay(tmp_path, engine="interpreted")
    assert (found.identical, len(found.time)) == (True, 101)
    whole = GRAPH.drive("sim:1", until="0.2 s", engine="interpreted").recording
    assert run.recording["task.dq_r"].tobytes() == np.ascontiguousarray(whole["task.dq_r"][::every]).tobytes()


def test_a_disk_that_fails_stops_the_robot_and_keeps_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool, stops = Spool(tmp_path / "none" / "samples.bin", {}), list[float]()
    read, stop = SimulatedRobot.read, SimulatedRobot.stop

    def slow(self: SimulatedRobot) -> Any:
        time.sleep(0.002)
        return read(self)

    def noted(self: SimulatedRobot, deceleration: float) -> None:
        stops.append(deceleration)
        stop(self, deceleration)

    monkeypatch.setattr(SimulatedRobot, "read", slow)
    monkeypatch.setattr(SimulatedRobot, "stop", noted)
    run = GRAPH.drive("sim", until="20 s", engine="interpreted", record=spool.path)
    assert stops == [20.0]
    assert "the robot was stopped: record: " in " ".join(run.notices)
    assert "no such file or directory; the record was written again" in " ".join(run.notices)
    found = GRAPH.replay(spool.path, engine="interpreted")
    assert found.identical
    assert len(found.time) == len(run.time)


def test_the_loop_does_not_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.runtime import journal as module

    def stalled(file: Any) -> None:
        time.sleep(0.3)

    monkeypatch.setattr(module, "forced", stalled)
    journal, scaled = Journal(Spool(tmp_path / "samples.bin", {})), ScaledController()
    longest, sample = 0.0, Sample(0.0, np.zeros(2), np.zeros(2))
    for k in range(4 * BLOCK):
        begun = time.perf_counter()
        journal.begin(sample, scaled, float(k), float(k), 1.0)  # type: ignore[arg-type]
        journal.commanded(scaled.command, scaled.command)
        journal.answered(0.0)
        longest = max(longest, time.perf_counter() - begun)
    journal.close()
    assert longest < 0.25
    assert len(journal.rows()) == 4 * BLOCK


def test_samples_that_wait_for_a_blocked_disk_stop_the_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.runtime import journal as module

    monkeypatch.setattr(module, "MOST_PENDING", 1000)
    spool = Spool(tmp_path / "samples.bin", {})
    spool.open(Columns({"time": 1}))
    spool.put(bytes(2000))
    assert spool.fault.endswith("samples.bin: the disk is too slow")
    spool.close()


KILLED = """
import time
import tracemalloc
from dmframe.runtime.simulated import SimulatedRobot
read = SimulatedRobot.read
def slow(self):
    time.sleep(0.002)
    return read(self)
SimulatedRobot.read = slow
from dmframe.cli import main
main()
"""


def test_a_drive_that_is_killed_leaves_all_but_its_last_second(tmp_path: Path) -> None:
    words = ["drive", "arm2_joint", "--robot", "sim", "--seconds", "60 s", "--out", "log", "--no-plots"]
    path = tmp_path / "log" / "samples.bin"
    with subprocess.Popen([sys.executable, "-c", KILLED, *words], cwd=tmp_path, stdout=subprocess.DEVNULL) as process:
        try:
            begun = time.monotonic()
            while not path.exists() or path.stat().st_size < 100_000:
                assert time.monotonic() < begun + 60
                assert process.poll() is None
                time.sleep(0.05)
            first, seen = len(read_samples(path)[1]["time"]), time.monotonic()
            time.sleep(1.5)
        finally:
            process.send_signal(signal.SIGKILL)
        lasted = time.monotonic() - seen
    _, columns = read_samples(path)
    gained = len(columns["time"]) - first
    assert gained > first * (lasted - 1.0) / (seen - begun) / 4  # as fast as before, except in the last second
    assert {item.name for item in (tmp_path / "log").iterdir()} == {"samples.bin"}
    found = GRAPH.replay(tmp_path / "log")
    assert found.identical
    assert len(found.time) == len(columns["time"])
    assert "samples.bin has no seal.json: it is incomplete" in str(found)


def test_a_short_drive_leaves_every_sample_in_its_signals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dmframe.cli import main

    monkeypatch.chdir(tmp_path)
    words = ["dmframe", "drive", "arm2_joint", "--robot", "sim", "--seconds", "0.04 s", "--out", "log", "--no-plots"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        main()
    assert not Path("log/samples.bin").exists()
    with h5netcdf.File("log/signals.nc", "r") as file:
        assert file.variables["time"].shape == (21,)
    assert json.loads(Path("log/seal.json").read_text())["complete"] is True


def test_thinned_rows_hold_no_others(tmp_path: Path) -> None:
    journal = Journal(Spool(tmp_path / "samples.bin", {}))
    fill(journal, 64 * BLOCK)
    whole = 64 * BLOCK * journal.columns.width * 8
    tracemalloc.start()
    rows = journal.rows(64)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(rows) == BLOCK
    assert most < whole / 8
