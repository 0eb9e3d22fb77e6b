"""Work that two processes share."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from dmframe.two import by_two


def test_every_job_is_done_once_by_one_of_two(tmp_path: Path) -> None:
    def job(k: int) -> None:
        with (tmp_path / str(k)).open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()}\n")

    by_two([lambda k=k: job(k) for k in range(40)])  # type: ignore[misc]
    told = [(tmp_path / str(k)).read_text().split() for k in range(40)]
    assert all(len(who) == 1 for who in told)
    assert len({who[0] for who in told}) <= 2


def test_a_job_that_fails_is_told_whoever_did_it(tmp_path: Path) -> None:
    def fail() -> None:
        raise ValueError("a name that no parser reads")

    with pytest.raises(ValueError, match="a name that no parser reads"):
        by_two([fail, fail])


@pytest.mark.skipif(sys.platform != "linux", reason="no copies elsewhere")
def test_what_fails_in_the_copy_alone_is_done_again_here(tmp_path: Path) -> None:
    here = os.getpid()

    def job(k: int) -> None:
        if os.getpid() != here:
            os._exit(7)
        (tmp_path / str(k)).touch()

    by_two([lambda k=k: job(k) for k in range(30)])  # type: ignore[misc]
    assert len(list(tmp_path.iterdir())) == 30


def test_on_one_core_everything_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    done = list[int]()
    by_two([lambda k=k: done.append(k) for k in range(5)])  # type: ignore[misc]
    assert done == [0, 1, 2, 3, 4]
