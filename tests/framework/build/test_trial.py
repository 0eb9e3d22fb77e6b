"""A compiler that succeeds with a faulty library: detected before the library is loaded or stored."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dmframe.build import compiler as compilers
from dmframe.build.trial import called
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate
from dmframe.simulate.engine import alike
from tests.framework.build.cached_libraries import libraries

Runner = Callable[..., Recording]


@pytest.fixture(scope="module")
def positions() -> np.ndarray:
    """Functions of the pendulum from a correct library."""
    graph = Graph.read("pendulum")
    return simulate(graph.diagram, 0.2, clock=graph.file.clock, solver=graph.solver, start=graph.start)["arm.q"]


def compiler(path: Path, text: str) -> str:
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


LATER = 'for a in "$@"; do case "$a" in *.so) {};; esac; done'
FAULTS = {
    "cut off": 'cc "$@" || exit 1; ' + LATER.format('head -c 9000 "$a" > part; mv part "$a"'),
    "a text": LATER.format('echo "no library" > "$a"'),
    "empty": LATER.format(': > "$a"'),
    "without the function": 'echo "int x;" > other.c; cc -shared -fPIC other.c -o loop.so',
    "crashes": "sed -i 's/dm_constants(p, k.c);/*(volatile int *)0 = 0;/' loop.c; cc \"$@\"",
    "wrong by a seventh": "sed -i 's/h \\/ 6/h \\/ 7/' loop.c; cc \"$@\"",
    "logs another column": "sed -i 's/row\\[j\\] = /row[columns - 1 - j] = /' loop.c; cc \"$@\"",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_library_that_does_not_work_is_neither_loaded_nor_kept(
    fault: str, cache: Path, pendulum: Runner, positions: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler(tmp_path / "badcc", FAULTS[fault]))
    run = pendulum()
    assert run.engine == "interpreted"
    (notice,) = run.notices
    assert notice.startswith("the compiled engine is not available: ")
    assert "badcc built a library that does not work" in notice
    assert libraries(cache) == []
    np.testing.assert_allclose(run["arm.q"], positions, rtol=1e-9)


def test_a_sound_library_is_tested_once_and_kept(
    cache: Path, pendulum: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    tested = list[Path]()

    def counted(library: Path, *words: object) -> object:
        tested.append(library)
        return called(library, *words)  # type: ignore[arg-type]

    monkeypatch.setattr("dmframe.simulate.engine.called", counted)
    assert [pendulum().engine, pendulum().engine] == ["compiled", "compiled"]
    assert len(tested) == 1
    assert len(libraries(cache)) == 1


def test_a_compiler_that_hangs_is_stopped_with_what_it_has_started(
    cache: Path, pendulum: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    monkeypatch.setenv("CC", compiler(tmp_path / "cc", f"sleep 1000 > {pipe} & wait"))
    monkeypatch.setattr(compilers, "LIMIT", 0.5)
    run = pendulum()
    assert run.engine == "interpreted"
    assert "took more than 0.5 s, and was stopped" in run.notices[0]
    os.set_blocking(reader, True)
    assert os.read(reader, 1) == b""  # its child, which held the other end, has ended
    os.close(reader)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no users there")
def test_a_folder_in_which_others_may_write_is_no_cache(cache: Path, pendulum: Runner) -> None:
    cache.mkdir(exist_ok=True)
    cache.chmod(0o777)
    run = pendulum()
    assert run.engine == "compiled"
    assert f"the cache {cache} cannot be used (others may write there)" in run.notices[0]
    assert libraries(cache) == []


def test_what_rounding_alone_moves_counts_for_no_fault_and_nothing_else_is_let_through() -> None:
    def evaluated(state: np.ndarray) -> list[ca.DM]:
        x, y = state
        return [ca.DM([x + 1e12 * x * x - (1e6 * x) ** 2, 3 * y])]  # the first has lost all but four digits

    state = np.array([0.7, 1.1])
    first, second = evaluated(state)[0].full().ravel()
    assert alike([[first + 2e-5, second]], evaluated, state)
    assert not alike([[first + 1.0, second]], evaluated, state)
    assert not alike([[first, second * (1 + 1e-5)]], evaluated, state)
    assert not alike([[np.nan, second]], evaluated, state)
    assert alike([[np.nan]], lambda _: [ca.DM([np.nan])], state)
    assert alike([[np.inf]], lambda _: [ca.DM([np.inf])], state)
