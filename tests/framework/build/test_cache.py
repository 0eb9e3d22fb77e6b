"""The cache of compiled code: entries are stored, found again, and checked before use."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dmframe.build import cache as keeping
from dmframe.build import compiler as compilers
from dmframe.build import library
from dmframe.build.cache import find, make
from dmframe.build.compiler import CompileFailed, Compiler, find_compiler
from dmframe.common.errors import ValueFault
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate
from tests.framework.build.cached_libraries import libraries

Runner = Callable[..., Recording]

needs_permissions = pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() == 0, reason="root may write to any folder"
)


def forget() -> None:
    """State that a new process does not have."""
    library._kept.clear()
    library._reported.clear()


def test_a_loop_is_compiled_once(cache: Path, pendulum: Runner) -> None:
    first = pendulum()
    (entry,) = libraries(cache)
    before = entry.stat().st_ino
    forget()
    again = pendulum()
    (entry,) = libraries(cache)
    assert entry.stat().st_ino == before
    np.testing.assert_array_equal(first["arm.q"], again["arm.q"])


def test_gains_true_parameters_starts_clock_and_step_need_no_new_compilation(cache: Path) -> None:
    changes = [
        [],
        ["dynamics.Gamma=3"],
        ["servo.K_P=[50, 20]", "arm.viscous=[2, 2]"],
        ["clock=4 ms", "solver.step=0.5 ms"],
        ["path.amplitude=[10 deg, 10 deg]", "inverse.w_box=[0, 0.2]"],
    ]
    found = list[np.ndarray]()
    for overrides in changes:
        graph = Graph.read("arm2_joint", overrides)
        start = {**graph.start, "dq": 0.01 * len(overrides)}
        run = simulate(graph.diagram, 0.2, clock=graph.file.clock, solver=graph.solver, start=start, engine="compiled")
        assert run.engine == "compiled"
        found.append(run["arm.q"][-1])
    assert len(libraries(cache)) == 1
    assert len({tuple(last) for last in found}) == len(changes)


@pytest.mark.parametrize("harm", ["empty", "truncated", "one byte", "text", "another's"])
def test_a_broken_entry_is_thrown_away_and_made_again(harm: str, cache: Path, pendulum: Runner) -> None:
    sound = pendulum()["arm.q"]
    (entry,) = libraries(cache)
    content = entry.read_bytes()
    middle = len(content) // 2
    entry.unlink()  # this process has it mapped
    entry.write_bytes(
        {
            "empty": b"",
            "truncated": content[:middle],
            "one byte": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
            "text": b"not a library\n",
            "another's": content,
        }[harm]
    )
    if harm == "another's":
        entry.chmod(0o777)  # another user may have written it
    forget()
    np.testing.assert_array_equal(pendulum()["arm.q"], sound)
    (again,) = libraries(cache)
    assert again.read_bytes() == content
    assert not again.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def test_a_link_in_the_place_of_an_entry_is_not_followed(cache: Path, tmp_path: Path, pendulum: Runner) -> None:
    pendulum()
    (entry,) = libraries(cache)
    elsewhere = tmp_path / "elsewhere.so"
    entry.rename(elsewhere)
    entry.symlink_to(elsewhere)
    forget()
    pendulum()
    (again,) = libraries(cache)
    assert not again.is_symlink()


def test_without_a_compiler_one_notice_is_given_and_the_numbers_are_the_same(
    cache: Path, pendulum: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = pendulum()
    monkeypatch.setattr("dmframe.simulate.engine.WORTH", 0)
    monkeypatch.setattr(compilers, "NAMES", ())
    monkeypatch.setattr(compilers.importlib.util, "find_spec", lambda name: None)
    monkeypatch.delenv("CC", raising=False)
    forget()
    first, second = pendulum("auto"), pendulum("auto")
    assert (first.engine, second.engine) == ("interpreted", "interpreted")
    assert [notice for notice in first.notices if "no C compiler was found" in notice]
    assert not [notice for notice in second.notices if "compiler" in notice]
    assert [notice for notice in pendulum("compiled").notices if "no C compiler was found" in notice]
    np.testing.assert_allclose(first["arm.q"], sound["arm.q"], rtol=1e-10)


def test_cc_names_the_compiler_and_its_options(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc -DX=1")
    found = find_compiler()
    assert found is not None
    assert found.command[1:] == ("-DX=1",)
    assert found.identity.endswith("-DX=1")


def test_ziglang_is_taken_where_nothing_else_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compilers, "NAMES", ())
    monkeypatch.setattr(compilers.importlib.util, "find_spec", lambda name: name)
    monkeypatch.setattr("importlib.metadata.version", lambda name: "0.13")
    assert find_compiler() == Compiler((sys.executable, "-m", "ziglang", "cc"), "ziglang 0.13")


@pytest.mark.parametrize("name", ["gcc", "clang", "ziglang"])
def test_each_compiler_gives_the_interpreters_numbers(
    name: str, cache: Path, pendulum: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compilers, "NAMES", () if name == "ziglang" else (name,))
    found = find_compiler()
    if found is None or (name == "ziglang") != ("ziglang" in found.identity):
        pytest.skip(f"{name} is not installed")
    compiled, interpreted = pendulum("compiled"), pendulum("interpreted")
    assert (compiled.engine, compiled.notices) == ("compiled", ())
    assert len(list(cache.glob("*.so"))) == 1
    np.testing.assert_allclose(compiled["arm.q"], interpreted["arm.q"], rtol=1e-10)


def script(path: Path, text: str) -> Compiler:
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return Compiler((str(path),), "a script")


def test_flags_that_a_compiler_refuses_are_left_out(tmp_path: Path) -> None:
    refuses = 'case "$*" in *-march*) echo "error: unknown flag" >&2; exit 1;; esac; exec cc "$@"'
    compiler = script(tmp_path / "cc", refuses)
    entry = make(tmp_path / "cache", "key", "int dm_x(void) { return 3; }", compiler)
    assert entry == find(tmp_path / "cache", "key")


def test_a_compiler_that_fails_states_its_first_complaint_and_leaves_nothing(tmp_path: Path) -> None:
    compiler = script(tmp_path / "cc", 'echo "loop.c:1: error: no space left" >&2; echo "error: more" >&2; exit 1')
    with pytest.raises(CompileFailed, match=r"^loop.c:1: error: no space left$"):
        make(tmp_path / "cache", "key", "int x;", compiler)
    assert libraries(tmp_path / "cache") == []


def test_a_compiler_that_fails_leaves_the_interpreter_with_a_notice(
    cache: Path, pendulum: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script(tmp_path / "cc", 'echo "error: broken" >&2; exit 1')
    monkeypatch.setenv("CC", str(tmp_path / "cc"))
    run = pendulum()
    assert run.engine == "interpreted"
    assert any("the compiled engine is not available: error: broken" in notice for notice in run.notices)


def test_a_cache_that_cannot_be_written_is_reported_and_the_run_is_compiled_all_the_same(
    cache: Path, pendulum: Runner
) -> None:
    shutil.rmtree(cache, ignore_errors=True)
    cache.write_text("a file where the folder should be", encoding="utf-8")
    run, again = pendulum(), pendulum("compiled")
    assert (run.engine, again.engine) == ("compiled", "compiled")
    assert any("cannot be used (file exists): compiled for this process only" in notice for notice in run.notices)


@needs_permissions
def test_a_read_only_cache_is_reported(cache: Path, pendulum: Runner) -> None:
    cache.mkdir(mode=0o500)
    assert any("permission denied" in notice for notice in pendulum().notices)


def test_the_least_recently_used_go_first_when_the_cache_is_full(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    compiler = find_compiler()
    assert compiler is not None
    made = [make(folder, f"key{k}", f"int dm_x(void) {{ return {k}; }}", compiler) for k in range(3)]
    for k, entry in enumerate(made):
        os.utime(entry, (1000 + k, 1000 + k))
    assert find(folder, "key0") == made[0]  # used now
    size = made[0].stat().st_size
    last = make(folder, "key3", "int dm_x(void) { return 3; }", compiler, most=int(2.5 * size))
    assert set(libraries(folder)) == {made[0], last}


def test_what_a_killed_process_left_is_cleared_away_after_a_while(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    compiler = find_compiler()
    assert compiler is not None
    for name, age in (("old", 2 * keeping.STALE), ("new", 0)):
        place = folder / f"{keeping._PART}{name}"
        place.mkdir(parents=True)
        place.joinpath("loop.c").write_text("int x;", encoding="utf-8")
        modified = place.stat().st_mtime - age
        os.utime(place, (modified, modified))
    make(folder, "key", "int dm_x(void) { return 1; }", compiler)
    assert [path.name for path in libraries(folder) if path.is_dir()] == [f"{keeping._PART}new"]


@pytest.mark.skipif(sys.platform != "linux", reason="each platform has a place of its own")
def test_the_cache_lies_where_the_platform_keeps_caches(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("DMFRAME_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert keeping.cache_folder() == tmp_path / "dmframe"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert keeping.cache_folder() == tmp_path / ".cache" / "dmframe"


def test_variables_that_are_invalid_are_reported(
    monkeypatch: pytest.MonkeyPatch, cache: Path, pendulum: Runner
) -> None:
    forget()
    monkeypatch.setenv("CC", 'gcc "')
    with pytest.raises(ValueFault, match=r'^CC=gcc ": expected a command, found an invalid one: no closing'):
        pendulum()
    monkeypatch.delenv("CC")
    monkeypatch.setenv("DMFRAME_CACHE", "~no_such_user/x")
    with pytest.raises(ValueFault, match=r"^DMFRAME_CACHE=~no_such_user/x: expected a folder, found the home"):
        pendulum()


def test_a_user_without_a_home_compiles_for_this_process(
    monkeypatch: pytest.MonkeyPatch, cache: Path, pendulum: Runner
) -> None:
    def no_user(_: int) -> None:
        raise KeyError

    for name in ("DMFRAME_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", no_user)
    run = pendulum()
    assert run.engine == "compiled"
    assert "the cache cannot be used (this user has no home): compiled for this process only" in run.notices


def test_another_compiler_than_the_requested_one_is_reported(
    monkeypatch: pytest.MonkeyPatch, cache: Path, pendulum: Runner
) -> None:
    monkeypatch.setenv("CC", "no_such_compiler -O3")
    run = pendulum()
    assert run.engine == "compiled"
    (notice,) = (text for text in run.notices if "$CC" in text)
    assert notice.startswith("$CC, no_such_compiler, was not found: compiled by /")
