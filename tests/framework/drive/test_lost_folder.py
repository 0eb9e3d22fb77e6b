"""A folder of results that is moved, deleted or replaced, or a disk that fills: a clear message, and no lost record."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.cli import main
from dmframe.cli import run as cli_run
from dmframe.common.seal import seal_of
from dmframe.results import place as places
from dmframe.runtime.journal import BLOCK, Columns, Spool, read_samples
from dmframe.runtime.simulated import SimulatedRobot

pytestmark = pytest.mark.usefixtures("without_v")

GRAPH = dm.load("arm2_joint")
SAMPLES = 51


def moved(folder: Path) -> None:
    folder.rename(folder.with_name("elsewhere"))


def with_parent(folder: Path) -> None:
    shutil.rmtree(folder.parent)


def replaced(folder: Path) -> None:
    moved(folder)
    folder.mkdir()
    (folder / "mine.txt").write_text("of the user")


ACTIONS: dict[str, Callable[[Path], None]] = {
    "moved": moved,
    "deleted": shutil.rmtree,
    "deleted with its parent": with_parent,
    "replaced": replaced,
}


@pytest.fixture
def dmframe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Status and output of a command; temporary folders are in `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spare").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spare"))

    def call(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["dmframe", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0), " ".join(" ".join(capsys.readouterr()).split())

    return call


def drive(dmframe: Any) -> tuple[int, str]:
    found: tuple[int, str] = dmframe(
        *("drive", "arm2_joint", "--robot", "sim", "--seconds", "0.1 s", "--out", "in/log", "--no-plots")
    )
    return found


@pytest.mark.parametrize("what", ACTIONS)
def test_a_drive_keeps_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dmframe: Callable[..., tuple[int, str]], what: str
) -> None:
    log, read, count = tmp_path / "in" / "log", SimulatedRobot.read, [0]

    def acting(self: SimulatedRobot) -> Any:
        count[0] += 1
        if count[0] == 20:
            while not (log / "samples.bin").exists():
                pass
            ACTIONS[what](log)
        return read(self)

    monkeypatch.setattr(SimulatedRobot, "read", acting)
    status, reported = drive(dmframe)
    monkeypatch.undo()
    if what == "replaced":
        assert status == 2
        assert (
            "in/log: expected the folder that was reserved, found another one with files. The data are in " in reported
        )
        (results,) = (tmp_path / "spare").glob("dmframe-results-*")
        assert sorted(item.name for item in log.iterdir()) == ["mine.txt", "samples.bin"]
    else:
        assert status == 0
        assert "samples.bin: was moved or deleted during the drive; the record was written again" in reported
        results = log
        assert not (log / "samples.bin").exists()
    found = GRAPH.replay(results)
    assert found.identical
    assert len(found.time) == SAMPLES
    seal = seal_of(results)
    assert seal is not None
    assert seal.complete


@pytest.mark.parametrize("what", ACTIONS)
def test_a_run_keeps_its_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dmframe: Callable[..., tuple[int, str]], what: str
) -> None:
    log, run_all = tmp_path / "in" / "log", cli_run._run_all

    def acting(*given: Any) -> Any:
        found = run_all(*given)
        ACTIONS[what](log)
        return found

    monkeypatch.setattr(cli_run, "_run_all", acting)
    status, reported = dmframe(
        "run", "arm2_joint", "--until", "0.04", "--engine", "interpreted", "--out", "in/log", "--json"
    )
    monkeypatch.undo()
    assert status == (2 if what == "replaced" else 0)
    results = log
    if what == "replaced":
        assert "expected the folder that was reserved, found another one with files. The data are in " in reported
        (results,) = (tmp_path / "spare").iterdir()
        assert [item.name for item in log.iterdir()] == ["mine.txt"]
    assert {"signals.nc", "summary.json", "graph.yaml", "seal.json"} <= {item.name for item in results.iterdir()}


@pytest.mark.parametrize("again", [False, True])
def test_results_that_a_disk_does_not_take_are_on_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dmframe: Callable[..., tuple[int, str]], again: bool
) -> None:
    synced, count = places.sync_below, [0]

    def full(folder: Path) -> None:
        count[0] += 1
        if count[0] == 1 or again:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synced(folder)

    monkeypatch.setattr(places, "sync_below", full)
    status, reported = drive(dmframe)
    assert status == 2
    assert "in/log: the results cannot be written: no space left on device; free some space" in reported
    if again:
        assert "The data are in" not in reported
        assert list((tmp_path / "spare").iterdir()) == []
        results = tmp_path / "in" / "log"  # the samples are there
    else:
        (results,) = (tmp_path / "spare").iterdir()
        assert f"The data are in {results}, without figures" in reported
    monkeypatch.undo()
    assert len(GRAPH.replay(results).time) == SAMPLES


def filled(spool: Spool, rows: int) -> np.ndarray:
    spool.open(Columns({"time": 2}))
    values = np.arange(2.0 * rows).reshape(rows, 2)
    for first in range(0, rows, BLOCK):
        spool.put(values[first : first + BLOCK].tobytes())
    spool.close()
    return values


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_rows_that_a_full_disk_does_not_take_are_written_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    spool = Spool(Path("/dev/full"), {})
    values = filled(spool, 3 * BLOCK + 7)
    assert spool.fault == "/dev/full: no space left on device"
    np.testing.assert_array_equal(spool.rows(2, 1), values)
    np.testing.assert_array_equal(spool.rows(2, 5), values[::5])
    notice = spool.secured()
    (spare,) = tmp_path.iterdir()
    assert notice == f"/dev/full: no space left on device; the record is in {spare}"
    np.testing.assert_array_equal(read_samples(spare / "full")[1]["time"], values)


@pytest.mark.parametrize("fails", [1, 2, 3])
def test_a_disk_that_fails_on_the_way_has_a_whole_record_where_it_works_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: int
) -> None:
    from dmframe.runtime import journal

    count, forced = [0], journal.forced

    def failing(file: Any) -> None:
        count[0] += 1
        if count[0] == fails:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        forced(file)

    monkeypatch.setattr(journal, "forced", failing)
    spool = Spool(tmp_path / "samples.bin", {})
    spool.open(Columns({"time": 1}))
    for k in range(4):
        while spool._written < spool._handed and not spool.fault:
            pass  # each row by itself
        spool.put(np.array([float(k)]).tobytes())
    spool.close()
    assert spool.fault.endswith("input/output error")
    np.testing.assert_array_equal(spool.rows(1, 1).ravel(), np.arange(4.0))
    assert spool.secured().endswith("input/output error; the record was written again")
    np.testing.assert_array_equal(read_samples(spool.path)[1]["time"].ravel(), np.arange(4.0))
    assert spool.secured() == ""
