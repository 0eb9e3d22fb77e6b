"""Worker processes on this machine: if any process is stopped, rows are neither lost nor computed twice."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import final

import pytest
from fake_study import FakeStudy
from study_processes import check, client, close, files, gate, kill, reported, wait_for_end

from dmframe.study import execute
from dmframe.study.chunks import Chunk
from dmframe.study.execute import AHEAD, State, run_study
from dmframe.study.executor import Computed, Failed, compute
from dmframe.study.pool import Pool


@pytest.fixture
def gates(tmp_path: Path) -> Path:
    folder = tmp_path / "gates"
    folder.mkdir()
    return folder


def test_a_study_has_each_run_once_and_computes_nothing_a_second_time(
    tmp_path: Path, finish: Callable[..., State]
) -> None:
    out = tmp_path / "out"
    assert run_study(FakeStudy(), out, workers=2, chunk=8).computed == 120
    check(out)
    again = run_study(FakeStudy(), out, workers=2)
    assert (again.computed, again.kept, again.complete) == (0, 120, True)
    assert finish(FakeStudy(samples=60), out).computed == 60
    check(out, samples=60)


def test_a_worker_that_is_killed_costs_its_chunk_alone(tmp_path: Path, gates: Path) -> None:
    out = tmp_path / "out"
    close(gates, "1-8")
    running = client(out, gates, workers=2)
    with gate(gates, "1-8") as (worker, _):
        kill(worker)
        assert reported(running) == "120|120|"
    check(out)


def test_workers_end_with_a_client_that_is_killed_and_the_next_goes_on(
    tmp_path: Path, gates: Path, finish: Callable[..., State]
) -> None:
    out = tmp_path / "out"
    close(gates, "1-8")
    running = client(out, gates, workers=1)
    with gate(gates, "1-8") as (_, reader):
        running.kill()
        wait_for_end(reader)
        running.communicate()
    before = files(out)
    assert len(before) > 6 - AHEAD  # six came before the gate
    assert finish(FakeStudy(), out).computed == 120 - 8 * len(before)
    check(out)


def test_at_ctrl_c_no_process_stays_and_rows_do(tmp_path: Path, gates: Path, finish: Callable[..., State]) -> None:
    out = tmp_path / "out"
    close(gates, "1-8", "1-16")
    running = client(out, gates, workers=2)
    with gate(gates, "1-8") as (_, first), gate(gates, "1-16") as (_, second):
        running.send_signal(signal.SIGINT)
        wait_for_end(first)
        wait_for_end(second)
    _, errors = running.communicate(timeout=60)
    assert "KeyboardInterrupt" in errors
    assert finish(FakeStudy(), out).kept == 120
    check(out)


def test_a_chunk_that_fails_three_times_is_named_and_the_rest_goes_on(
    tmp_path: Path, gates: Path, finish: Callable[..., State]
) -> None:
    out = tmp_path / "out"
    (gates / "poison-0-8").touch()
    (gates / "fault-2-32").touch()
    state = run_study(FakeStudy(gates=gates), out, workers=2, chunk=8)
    assert state.kept == 120 - 16
    assert {str(chunk): why for chunk, why in state.failed.items()} == {
        "point 0, samples 8 to 15": "its process was ended: killed, possibly because memory ran out",
        "point 2, samples 32 to 39": "ArithmeticError: no number",
    }
    (gates / "poison-0-8").unlink()
    (gates / "fault-2-32").unlink()
    assert finish(FakeStudy(gates=gates), out).computed == 16
    check(out)


def test_a_study_that_no_worker_can_read_ends_in_one_sentence(tmp_path: Path) -> None:
    from dmframe.common.errors import EngineError

    with pytest.raises(EngineError, match=r"a worker process could not be started: \w+Error"):
        run_study(Unreadable(), tmp_path / "out", workers=1)


class Unreadable(FakeStudy):
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return int, ("no study",)


def test_chunks_wait_in_a_short_queue_however_many_there_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, most = set[Chunk](), 0
    submit, ended = Pool.submit, Pool.ended

    def counted(pool: Pool, chunk: Chunk) -> None:
        nonlocal most
        out.add(chunk)
        most = max(most, len(out))
        submit(pool, chunk)

    def counting(pool: Pool, timeout: float) -> tuple[Chunk, Computed | Failed] | None:
        answer = ended(pool, timeout)
        out.discard(answer[0] if answer else Chunk(0, 0, 0, 0))
        return answer

    monkeypatch.setattr(Pool, "submit", counted)
    monkeypatch.setattr(Pool, "ended", counting)
    run_study(FakeStudy(samples=200), tmp_path / "out", workers=1, chunk=8)
    assert 1 < most <= AHEAD


@final
class Blaming:
    """Workers that end with all waiting chunks, as those of a scheduler do, which cannot determine the cause."""

    count = 1

    def __init__(self, study: FakeStudy, poison: Chunk) -> None:
        self._study, self._poison = study, poison
        self._waiting = list[Chunk]()
        self._ended = list[tuple[Chunk, Computed | Failed]]()

    def submit(self, chunk: Chunk) -> None:
        self._waiting.append(chunk)

    def ended(self, timeout: float) -> tuple[Chunk, Computed | Failed] | None:
        if not self._ended:
            blamed = Failed("ended", alone=True)
            harmed = self._poison in self._waiting
            self._ended = [(each, blamed if harmed else compute(self._study, each)) for each in self._waiting]
            self._waiting.clear()
        return self._ended.pop()

    def __enter__(self) -> Blaming:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_chunk_that_waited_next_to_a_deadly_one_is_not_blamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poison = Chunk(0, 1, 8, 16)
    monkeypatch.setattr(execute, "Pool", lambda study, _: Blaming(study, poison))
    state = run_study(FakeStudy(), tmp_path / "out", chunk=8)
    assert state.failed == {poison: "ended"}
    assert state.kept == 120 - 8
