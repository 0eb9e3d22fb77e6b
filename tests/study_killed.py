"""A large study whose workers and client are killed, compared with the undisturbed study: ``make study``.

Two dask workers run it, by their own command lines. After a third of the runs one of them is killed with -9, after two
thirds the client; the same command then continues. The undisturbed one uses this machine's own processes. Both must
have every run once, with the same bits. Printed: times, runs per second, rows that were computed
although they existed, the client's memory.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import polars

STUDY = """\
dmframe-study: 1
title: UR10-like arms
graph: {graph}
set: {{duration: {duration}}}
sample:
  runs: {samples}
  seed: 7
  servo.K_D: {{scale: [0.8, 1.25]}}
  servo.K_P: {{scale: [0.8, 1.25], per: joint}}
  arm.coulomb: {{scale: [0.5, 2]}}
grid: {{dynamics.Gamma: [1, 10, 100, 1000]}}
"""
LOOK = 0.1
"""Interval of checks of the folder [s]."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--graph", default="ur10_fast_tuned")
    parser.add_argument("--duration", default="2 s")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        samples = -(-given.runs // 4)
        text = STUDY.format(graph=given.graph, duration=given.duration, samples=samples)
        (folder / "large.yaml").write_text(text, encoding="utf-8")
        calm, seconds, memory = undisturbed(folder)
        print(f"undisturbed: {4 * samples} runs in {seconds:.0f} s, {4 * samples / seconds:.0f} a second, ", end="")
        print(f"client {memory:.0f} MB", flush=True)
        hurt, seconds, memory, twice = disturbed(folder, 4 * samples)
        note = f"{twice} rows computed twice, client {memory:.0f} MB"
        print(f"killed: {4 * samples} runs in {seconds:.0f} s, {note}")
        whole = sorted(hurt["run"].to_list()) == list(range(4 * samples))
        equal = same_bits(calm, hurt)
        print(f"complete, each run once: {whole}; equal bit by bit: {equal}")
        return 0 if whole and equal else 1


def undisturbed(folder: Path) -> tuple[polars.DataFrame, float, float]:
    began = time.monotonic()
    process = client(folder, "calm")
    memory = ended(process)
    return frame(folder / "calm"), time.monotonic() - began, memory


def disturbed(folder: Path, runs: int) -> tuple[polars.DataFrame, float, float, int]:
    with ExitStack() as stack:
        port = free()
        place = f"tcp://127.0.0.1:{port}"
        here = ("--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        stack.enter_context(started(folder, "scheduler", *here))
        words = ("worker", place, "--nthreads", "1", "--no-dashboard", "--death-timeout", "60")
        workers = [stack.enter_context(started(folder, *words)) for _ in range(2)]
        began, out = time.monotonic(), folder / "hurt"
        first = client(folder, "hurt", "--scheduler", place)
        until(out, runs // 3, first)
        victim = child(workers[0].pid)
        os.kill(victim, signal.SIGKILL)
        print(f"a worker is killed after {kept(out)} runs", flush=True)
        until(out, 2 * runs // 3, first)
        first.kill()
        first.wait()
        before = kept(out)
        print(f"the client is killed after {before} runs", flush=True)
        memory = ended(client(folder, "hurt", "--scheduler", place))
        processes = [json.loads(line) for line in (out / "processes.jsonl").read_text().splitlines()]
        found = frame(out)
        return found, time.monotonic() - began, memory, before + processes[-1]["runs"] - runs


def client(folder: Path, out: str, *words: str) -> subprocess.Popen[bytes]:
    start = [sys.executable, "-c", "from dmframe.cli import main; main()"]
    return subprocess.Popen([*start, "study", "large.yaml", "--out", out, *words], cwd=folder)


def ended(process: subprocess.Popen[bytes]) -> float:
    """Its peak memory [MB]."""
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"the client ended with {process.returncode}")
    return used.ru_maxrss / 1000


@contextmanager
def started(folder: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words], cwd=folder, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def until(out: Path, runs: int, process: subprocess.Popen[bytes]) -> None:
    while kept(out) < runs:
        try:
            process.wait(LOOK)
        except subprocess.TimeoutExpired:
            continue
        sys.exit("the client ended before it was killed; take more --runs")


def kept(out: Path) -> int:
    """Number of rows on the disk, from the names of the files."""
    return sum(rows(file.stem) for file in (out / "runs").glob("*.parquet")) if out.is_dir() else 0


def rows(name: str) -> int:
    first, stop = (int(part) for part in name.partition("-s")[2].split("-"))
    points = [int(part) for part in name.partition("-p")[2].partition("-s")[0].split("-")]
    return (stop - first) * (points[-1] - points[0] if len(points) > 1 else 1)


def child(process: int) -> int:
    """The worker that a nanny has started: the child that is not a resource tracker."""
    found = subprocess.run(
        ["ps", "-o", "pid=,args=", "--ppid", str(process)], capture_output=True, text=True, check=True
    )
    lines = [line.split(maxsplit=1) for line in found.stdout.splitlines()]
    return next(int(pid) for pid, words in lines if "resource_tracker" not in words)


def free() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def frame(out: Path) -> polars.DataFrame:
    return polars.read_parquet(out / "runs" / "*.parquet").sort("run")


def same_bits(a: polars.DataFrame, b: polars.DataFrame) -> bool:
    """Equality with NaN equal to NaN."""

    def bits(table: polars.DataFrame) -> Sequence[Any]:
        return [column.to_numpy().tobytes() if column.dtype.is_numeric() else column.to_list() for column in table]

    return a.columns == b.columns and bits(a) == bits(b)


if __name__ == "__main__":
    sys.exit(main())
