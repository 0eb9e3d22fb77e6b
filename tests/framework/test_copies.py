"""Work that is divided between forked processes."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from functools import partial

import pytest

from dmframe.common.copies import Later, shared

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="no copies elsewhere")


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if no other test had left a thread in this process: with one there are no forks."""
    monkeypatch.setattr("dmframe.common.copies.threading.active_count", lambda: 1)


@pytest.mark.parametrize("cores", [1, 2, 3, 8])
def test_every_job_is_done_once_by_this_process_or_a_copy(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    with shared([lambda k=k: (k, os.getpid()) for k in range(40)]) as finished:  # type: ignore[misc]
        results = finished()
    assert [k for k, _ in results] == list(range(40))
    assert len({who for _, who in results}) <= min(4, cores)


@LINUX
def test_the_copy_works_while_this_process_does_something_else() -> None:
    reader, writer = os.pipe()

    def touch() -> int:
        os.write(writer, b"x")
        return os.getpid()

    with shared([touch, touch]) as finished:
        if len(os.sched_getaffinity(0)) > 1:
            assert os.read(reader, 1) == b"x"  # before the results are requested
            assert finished()[0] != os.getpid()


@LINUX
@pytest.mark.parametrize("cores", [1, 2])
def test_a_busy_process_forks_a_single_job(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    reader, writer = os.pipe()

    def work() -> int:
        os.write(writer, b"x")
        return os.getpid()

    with shared([work], busy=True) as finished:
        if cores > 1:
            assert os.read(reader, 1) == b"x"
        assert (finished()[0] == os.getpid()) == (cores == 1)


def test_a_job_that_fails_is_reported_from_any_process() -> None:
    def fail() -> None:
        raise ValueError("a name that no parser reads")

    with shared([fail, fail]) as finished, pytest.raises(ValueError, match="a name that no parser reads"):
        finished()


@LINUX
def test_what_fails_in_the_copy_alone_is_done_again_here() -> None:
    here = os.getpid()

    def job(k: int) -> int:
        if os.getpid() != here:
            os._exit(7)
        return k

    with shared([lambda k=k: job(k) for k in range(30)]) as finished:  # type: ignore[misc]
        assert finished() == list(range(30))


@LINUX
def test_a_fork_without_use_of_its_results_is_killed() -> None:
    reader, writer = os.pipe()

    def touch() -> None:
        os.write(writer, os.getpid().to_bytes(8, "little"))
        signal.pause()

    with suppress(ZeroDivisionError), shared([touch, touch]):
        if len(os.sched_getaffinity(0)) == 1:
            return
        copy = int.from_bytes(os.read(reader, 8), "little")
        raise ZeroDivisionError
    with pytest.raises(ProcessLookupError):
        os.kill(copy, 0)


def test_a_process_with_other_threads_has_no_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies.threading.active_count", lambda: 2)
    with shared([os.getpid, os.getpid]) as finished:
        assert finished() == [os.getpid()] * 2


def test_on_one_core_everything_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    done = list[int]()
    with shared([lambda k=k: done.append(k) for k in range(5)]) as finished:  # type: ignore[misc]
        assert not done
        finished()
    assert done == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("call", ["pipe", "write", "read", "fork", "memfd_create", "lseek"])
def test_where_the_system_fails_all_jobs_are_done_here(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object) -> None:
        raise OSError(5, "input/output error")

    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 3)
    monkeypatch.setattr(f"dmframe.common.copies.os.{call}", failing)
    jobs = [partial(pow, number, 2) for number in range(20)]
    with shared(jobs) as finished:
        assert finished() == [number**2 for number in range(20)]


@LINUX
def test_what_a_copy_did_before_it_ended_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def end() -> int:
        if os.getpid() != here:
            os._exit(7)
        return here

    here = os.getpid()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    with shared([os.getpid, end, os.getpid], busy=True) as finished:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)  # the forked process has ended
        first, second, third = finished()
    assert first != second == third == here


@LINUX
def test_a_program_that_ignores_the_end_of_its_children_has_their_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with shared([partial(pow, number, 2) for number in range(20)], busy=True) as finished:
            assert finished() == [number**2 for number in range(20)]
    finally:
        signal.signal(signal.SIGCHLD, before)


@LINUX
def test_a_copy_that_is_interrupted_does_not_return_from_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    here, fork, (reader, writer) = os.getpid(), os.fork, os.pipe()

    def interrupted() -> int:
        process = fork()
        if process == 0:
            os.kill(os.getpid(), signal.SIGINT)
        return process

    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    monkeypatch.setattr("dmframe.common.copies.os.fork", interrupted)
    try:
        with shared([os.getpid, os.getpid], busy=True) as finished:
            assert len(finished()) == 2
    finally:
        if os.getpid() != here:
            os.write(writer, b"returned")
            os._exit(0)
    os.close(writer)
    assert os.read(reader, 8) == b""
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.parametrize("cores", [1, 2, 4])
def test_jobs_that_start_before_their_input_is_known_wait_for_it(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: cores)
    first, second = Later[list[int]](), Later[int]()

    def add(number: int) -> tuple[int, bool]:
        return sum(first.take()) + second.take() + number, os.getpid() == here

    here, jobs = os.getpid(), [partial(add, number) for number in range(6)]
    with shared(jobs, busy=True, forks_only=True, later=(first, second)) as finished:
        first.give([1, 2])
        second.give(10)
        found = finished()
    assert [total for total, _ in found] == [13, 14, 15, 16, 17, 18]
    assert {mine for _, mine in found} == {cores == 1}


@LINUX
def test_a_value_that_cannot_be_given_leaves_the_jobs_to_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 3)
    value, here = Later[bytes](), os.getpid()
    with shared([lambda: (len(value.take()), os.getpid())] * 3, forks_only=True, later=(value,)) as finished:

        def full(*_: object, **__: object) -> None:
            raise OSError(28, "no space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("dmframe.common.copies.pickle.dump", full)
            value.give(b"abc")
        assert finished() == [(3, here)] * 3


@LINUX
def test_a_fork_whose_parent_has_ended_stops_to_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    reader, writer = os.pipe()
    middle = os.fork()
    if middle == 0:
        value = Later[int]()
        with suppress(BaseException), shared([value.take], busy=True, later=(value,)):
            os.kill(os.getpid(), signal.SIGKILL)
    os.close(writer)
    os.waitpid(middle, 0)
    assert os.read(reader, 1) == b""  # the forked process had the other end


def test_a_value_that_was_never_given_is_an_error() -> None:
    with pytest.raises(EOFError, match="not given"):
        Later[int]().take()


class Unreadable:
    """A result whose pickle raises where it is read."""

    def __reduce__(self) -> tuple[type[int], tuple[str]]:
        return int, ("no number",)


@LINUX
def test_a_result_that_cannot_be_read_is_computed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    here = os.getpid()
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    with shared([lambda: here if os.getpid() == here else Unreadable()], busy=True, forks_only=True) as finished:
        assert finished() == [here]
