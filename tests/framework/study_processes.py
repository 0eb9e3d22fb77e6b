"""Studies in processes that are then stopped: until then a gate blocks a worker in the middle of a chunk."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fake_study import FakeStudy

CLIENT = """
import sys
from pathlib import Path
from fake_study import FakeStudy
from dmframe.study.execute import run_study
out, gates, samples, options = sys.argv[1:]
state = run_study(FakeStudy(samples=int(samples), gates=Path(gates)), out, chunk=8, **eval(options))
print(state.kept, state.computed, state.lost, *state.failed.values(), sep="|")
"""
PATIENCE = 60.0
"""Timeout after which a test fails [s]."""


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)}


def client(out: Path, gates: Path, *, samples: int = 40, **options: Any) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", CLIENT, str(out), str(gates), str(samples), repr(options)]
    return subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(), cwd=out.parent
    )


def reported(process: subprocess.Popen[str]) -> str:
    try:
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, err
    return out.strip()


@contextmanager
def gate(gates: Path, place: str) -> Iterator[tuple[int, int]]:
    """Wait until a worker reaches a chunk; returns its process number, and a descriptor that is closed at its end."""
    pipe = gates / place
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        wait(reader)
        worker = int(os.read(reader, 100))
        pipe.unlink()  # the next one may pass
        yield worker, reader
    finally:
        os.close(reader)


def wait(reader: int) -> None:
    poll = select.poll()
    poll.register(reader, select.POLLIN | select.POLLHUP)
    assert poll.poll(PATIENCE * 1000), "nothing came"


def wait_for_end(reader: int) -> None:
    """Until every process that keeps the gate open has ended."""
    wait(reader)
    assert os.read(reader, 1) == b""


def close(gates: Path, *places: str) -> None:
    for place in places:
        os.mkfifo(gates / place)


def kill(process: int) -> None:
    os.kill(process, signal.SIGKILL)


def frame(out: Path) -> Any:
    import polars

    return polars.read_parquet(out / "runs" / "*.parquet").sort("run")


def expected(samples: int = 40) -> Any:
    """Content of an undisturbed study, computed here, one run after another."""
    import polars

    study = FakeStudy(samples=samples)
    rows = [study.rows(point, i, i + 1) for i in range(samples) for point in study.points]
    columns = {name: [value for row in rows for value in row[name]] for name in rows[0]}
    return polars.DataFrame({name: [getattr(v, "item", lambda v=v: v)() for v in columns[name]] for name in columns})


def files(out: Path) -> set[str]:
    """The files of rows that exist."""
    return {item.name for item in (out / "runs").glob("*.parquet")}


def written(out: Path) -> set[str]:
    """The files that have a line, except an incomplete one."""
    lines = (out / "chunks.jsonl").read_text().splitlines()
    return {json.loads(line)["file"] for line in lines if line.endswith("}")}


def check(out: Path, samples: int = 40) -> None:
    """Complete, without duplicates, and bit-identical to the undisturbed study."""
    found = frame(out)
    assert found["run"].to_list() == list(range(3 * samples))
    assert found.rows() == expected(samples).rows()
    assert written(out) == files(out)
