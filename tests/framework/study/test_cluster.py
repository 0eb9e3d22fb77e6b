"""Workers of a dask scheduler, by their own command lines: after a kill no result is lost or computed twice."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from fake_study import FakeStudy
from study_processes import check, client, close, environment, files, gate, kill, reported, wait_for_end

from dmframe.study import cluster
from dmframe.study.chunks import Chunk
from dmframe.study.execute import State, run_study
from dmframe.study.executor import Computed, Failed, versions
from dmframe.study.packing import packed

QUIET = {"DASK_DISTRIBUTED__DASHBOARD__LINK": "", "DASK_DISTRIBUTED__WORKER__DAEMON": "False"}


@contextmanager
def started(*words: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A dask command line; at the end it and its children are stopped."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        env=environment() | QUIET,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def free() -> str:
    """A free port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return str(found.getsockname()[1])


def test_workers_client_and_scheduler_are_killed_one_after_another(
    tmp_path: Path, finish: Callable[..., State]
) -> None:
    out, gates = tmp_path / "out", tmp_path / "gates"
    gates.mkdir()
    close(gates, "0-8", "1-24", "2-0")
    with ExitStack() as stack:
        port = free()
        place = f"tcp://127.0.0.1:{port}"
        here = ("--host", "127.0.0.1", "--port", port, "--no-dashboard")
        scheduler = stack.enter_context(started("scheduler", *here, folder=tmp_path))
        words = ("worker", place, "--nthreads", "1", "--nworkers", "2", "--no-dashboard", "--death-timeout", "60")
        stack.enter_context(started(*words, folder=tmp_path))
        first = client(out, gates, scheduler=place)
        with gate(gates, "0-8") as (worker, _):
            kill(worker)  # its nanny starts another one
        with gate(gates, "1-24") as (worker, reader):
            first.kill()
            first.communicate()
            before = files(out)
            kill(worker)
            wait_for_end(reader)
        assert before
        second = client(out, gates, scheduler=place)
        with gate(gates, "2-0") as (worker, _):
            kill(scheduler.pid)
            kept, computed, lost = reported(second).split("|")
        assert lost == f"--scheduler {place}: the scheduler has gone"
    assert int(computed) + 8 * len(before) == int(kept) < 120
    last = finish(FakeStudy(), out)  # without a scheduler: the folder is the same
    assert last.computed == 120 - int(kept)
    check(out)


def test_where_no_scheduler_is_one_sentence_reports_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT", 0.2)
    state = run_study(FakeStudy(), tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    assert state.lost.startswith("--scheduler tcp://127.0.0.1:9: no scheduler answers there")
    assert len(state.lost.splitlines()) == 1
    assert state.kept == 0


def test_a_worker_of_other_versions_or_another_study_is_refused() -> None:
    study, chunk = FakeStudy(), Chunk(0, 1, 0, 8)
    parcel = packed(study)
    assert isinstance(cluster.work(parcel, study.key, versions(), chunk), Computed)
    other = cluster.work(parcel, study.key, {**versions(), "numpy": "1.0"}, chunk)
    assert isinstance(other, cluster.Refused)
    assert "where the client has 1.0; install the same versions there" in other.text
    strange = cluster.work(packed(FakeStudy(meaning="two")), study.key, versions(), chunk)
    assert isinstance(strange, cluster.Refused)
    unread = cluster.work(b"none", study.key, versions(), chunk)
    assert isinstance(unread, Failed)
    assert unread.final


@pytest.mark.parametrize(
    ("address", "warns"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("localhost:8786", False),
        ("tcp://[::1]:8786", False),
        ("tls://10.0.0.5:8786", False),
        ("tcp://10.0.0.5:8786", True),
        ("node7:8786", True),
    ],
)
def test_a_scheduler_that_other_machines_can_reach_gives_a_warning(address: str, warns: bool) -> None:
    assert bool(cluster.exposed(address)) is warns
