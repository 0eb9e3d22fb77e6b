"""Processes that compile simultaneously, or are killed at any instant, leave a valid cache and no partial result."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dmframe.cli import main
from tests.framework.build.cached_libraries import libraries

MAIN = "from dmframe.cli import main; main()"
NEW = pytest.mark.usefixtures("cache")
RUN = ("run", "arm2_joint", "--no-plots", "--engine", "compiled", "--json")


def started(hook: str, words: tuple[str, ...], cwd: Path, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", hook + MAIN, *words],
        cwd=cwd,
        env=os.environ | {"DMFRAME_CACHE": str(cwd / "cache")} | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def read_line(process: subprocess.Popen[str]) -> dict[str, Any]:
    try:
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, err) == (0, "")
    found: dict[str, Any] = json.loads(out)
    assert found["engine"] == "compiled"
    assert notices_of(found) == []
    return found


def notices_of(found: dict[str, Any]) -> list[str]:
    """Notices of a run, except that on V, which increases at this graph's sampling period."""
    return [notice for notice in found["notices"] if not notice.startswith("V rose")]


def sound(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Another process, here this one with nothing loaded, finds the cache in a valid state."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["dmframe", *RUN, "--until", "0.2", "--out", "mine"])
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    assert (stopped.value.code or 0, err) == (0, "")
    found = json.loads(out)
    assert (found["engine"], notices_of(found)) == ("compiled", [])
    assert all(path.suffix == ".so" or path.name.startswith(".part-") for path in libraries(folder / "cache"))


def killed_when_ready(process: subprocess.Popen[str], pipe: Path) -> None:
    """SIGKILL to the process and its children as soon as one of them writes to the pipe."""
    try:
        with pipe.open(encoding="utf-8") as reader:
            assert reader.read(1) == "x"
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    assert process.returncode == -signal.SIGKILL


def test_two_processes_may_compile_the_same_at_once(tmp_path: Path) -> None:
    both = [started("", (*RUN, "--until", "0.2", "--out", name), tmp_path) for name in ("one", "two")]
    errors = [read_line(process)["error"] for process in both]
    assert errors[0] == errors[1]
    assert {path.suffix for path in libraries(tmp_path / "cache")} == {".so"}


@NEW
@pytest.mark.parametrize("moment", ["before", "half way", "after"])
def test_killed_while_it_compiles_a_process_leaves_no_entry(
    moment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe, compiler = tmp_path / "pipe", tmp_path / "cc"
    os.mkfifo(pipe)
    work = {
        "before": "",
        "half way": 'cc "$@"; for f in *.so; do head -c 1000 "$f" > half; mv half "$f"; done',
        "after": 'cc "$@"',
    }[moment]
    until_killed = "while kill -0 $PPID 2>/dev/null; do sleep 0.1; done"
    compiler.write_text(f"#!/bin/sh\n{work}\nprintf x > {pipe}\n{until_killed}\n", encoding="utf-8")
    compiler.chmod(0o755)
    process = started("", (*RUN, "--until", "0.2", "--out", "mine"), tmp_path, CC=str(compiler))
    killed_when_ready(process, pipe)
    assert [path.name[:6] for path in libraries(tmp_path / "cache")] == [".part-"]
    assert list((tmp_path / "mine").iterdir()) == []  # locked by a run that has ended, and free for the next
    sound(tmp_path, monkeypatch, capsys)


@NEW
@pytest.mark.parametrize("moment", ["run", "write"])
def test_killed_while_it_runs_or_writes_a_process_leaves_no_result(
    moment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    touch = f"    with open({str(pipe)!r}, 'w') as f:\n        f.write('x')\n    signal.pause()\n"
    hook = {
        "run": "import signal, dmframe.config.graph as run\nsimulate = run.simulate\n"
        f"def notify(time):\n{touch}"
        "run.simulate = lambda *a, **k: simulate(*a, **(k | {'progress': notify}))\n",
        "write": f"import signal, os\nrename = os.rename\ndef notify(*a):\n{touch}os.rename = notify\n",
    }[moment]
    process = started(hook, (*RUN, "--until", "2", "--out", "mine"), tmp_path)
    killed_when_ready(process, pipe)
    assert list((tmp_path / "mine").iterdir()) == []  # locked by a run that has ended, and free for the next
    sound(tmp_path, monkeypatch, capsys)
