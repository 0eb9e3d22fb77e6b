"""Pieces of long functions, which are compiled in parallel."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import numpy as np
import pytest

from dmframe.build import compiler as compilers
from dmframe.build.compiler import LIGHT, TUNED, CompileFailed, Compiler, find_compiler
from dmframe.codegen import function
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate

SOURCE = f"""\
{function.UNITS}
#if DM_HERE(0)
DM_PIECE void dm_piece0(double *x) {{ x[0] += 1; }}
#else
DM_PIECE void dm_piece0(double *x);
#endif
#if DM_HERE(1)
DM_PIECE void dm_piece1(double *x) {{ x[0] *= 10; }}
#else
DM_PIECE void dm_piece1(double *x);
#endif
static void dm_all(double *x) {{ dm_piece0(x); dm_piece1(x); }}
#if DM_UNIT == 0
double dm_run(double x) {{ dm_all(&x); return x; }}
#endif
"""

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def at(place: Path, *, cores: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    monkeypatch.setattr(compilers, "cores", lambda: cores)
    place.mkdir(exist_ok=True)
    (place / "loop.c").write_text(SOURCE, encoding="utf-8")
    return place / "loop.c", place / "loop.so"


def script(place: Path, text: str) -> Compiler:
    found = find_compiler()
    assert found is not None
    path = place / "cc"
    path.write_text(f'#!/bin/sh\n{text}\nexec {" ".join(found.command)} "$@"\n', encoding="utf-8")
    path.chmod(0o755)
    return Compiler((str(path),), "a script")


@needs_compiler
@pytest.mark.parametrize("cores", [1, 2, 7])
def test_the_units_make_one_library_that_exports_nothing_else(
    cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, library = at(tmp_path, cores=cores, monkeypatch=monkeypatch)
    script(tmp_path, "echo call >> calls").build(source, library)
    assert (tmp_path / "calls").read_text().count("call") == (1 if cores == 1 else 3)  # two units, and the linker
    loaded = ctypes.CDLL(str(library))
    loaded.dm_run.restype = ctypes.c_double
    assert loaded.dm_run(ctypes.c_double(2.0)) == 30
    assert not hasattr(loaded, "dm_piece1")


@needs_compiler
def test_a_loop_has_the_same_bits_in_one_unit_and_in_three(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(function, "PIECE", 60)
    diagram, calls = Graph.read("theorem_1").diagram, list[int]()
    called = compilers._called
    monkeypatch.setattr(compilers, "_called", lambda words, folder: calls.append(len(words)) or called(words, folder))

    def run(cores: int) -> Recording:
        monkeypatch.setattr(compilers, "cores", lambda: cores)
        monkeypatch.setenv("DMFRAME_CACHE", str(cache / str(cores)))
        return simulate(diagram, 0.05, engine="compiled", solver=Graph.read("theorem_1").solver)

    one, three = run(1), run(3)
    assert calls == [1, 3, 1]
    assert (one.engine, three.engine) == ("compiled", "compiled")
    for name, values in one.states.items():
        np.testing.assert_array_equal(values, three.states[name])


@needs_compiler
def test_the_error_of_a_unit_is_that_of_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, library = at(tmp_path, cores=2, monkeypatch=monkeypatch)
    failing = script(tmp_path, 'case "$*" in *DM_UNIT=1*) echo "error: no room" >&2; exit 1;; esac')
    with pytest.raises(CompileFailed, match=r"^error: no room$"):
        failing.build(source, library)
    assert not library.exists()


@needs_compiler
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes there")
def test_if_a_unit_hangs_all_are_stopped_with_what_they_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, library = at(tmp_path, cores=2, monkeypatch=monkeypatch)
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    monkeypatch.setattr(compilers, "LIMIT", 0.5)
    with pytest.raises(CompileFailed, match=r"took more than 0.5 s, and was stopped"):
        script(tmp_path, "sleep 1000 > pipe & wait").build(source, library)
    os.set_blocking(reader, True)
    assert os.read(reader, 1) == b""  # no child holds the other end
    os.close(reader)


@needs_compiler
@pytest.mark.parametrize(("long", "flags"), [(10**6, TUNED), (5, LIGHT)])
def test_long_sources_are_compiled_with_light_flags(
    long: int, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, library = at(tmp_path, cores=1, monkeypatch=monkeypatch)
    monkeypatch.setattr(compilers, "LONG", long)
    script(tmp_path, 'echo "$*" >> calls').build(source, library)
    assert f" {' '.join(flags)} " in (tmp_path / "calls").read_text()
