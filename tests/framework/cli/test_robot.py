"""``dmframe robot``: its output, its errors, and its end."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from dmframe.cli import main

FREE = [word for name in ("rtde", "dashboard", "primary", "secondary", "realtime") for word in ("--port", f"{name}=0")]


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["dmframe", "robot", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_it_prints_where_it_listens(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "ur10_fast", *FREE, "--series", "cb3", "--until", "20 ms") == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("ur10_fast: a virtual ur10 at 127.0.0.1, 125 cycles a second; rtde ")
    assert "no hardware" in second


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["panda_full"], "panda_full: expected a UR"),
        (["ur10_fast", "--port", "rtde"], "--port rtde: expected NAME=NUMBER"),
        (["ur10_fast", "--port", "rtde=70000"], "rtde: expected a port from 0 to 65535, found 70000"),
        (["ur10_fast", "--host", "192.0.2.1", *FREE], "rtde: cannot listen at 192.0.2.1:0"),
        (["ur10_fast", "--host", "no such name", *FREE], "rtde: cannot listen at no such name:0"),
        (["ur10_fast", "--series", "g"], "series: expected cb3 or e, found 'g'"),
        (["ur10_fast", "--slider", "2"], "slider: expected a number from 0 to 1, found 2.0"),
        (["ur10_fast", "--lost", "x"], "--lost x: "),
        (["ur10_fast", "--patience", "0"], "--patience 0: expected a time above zero"),
        (["ur10_fast", "--command-delay", "1.5"], "--command-delay 1.5: expected a whole number"),
    ],
)
def test_what_cannot_be_meant_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], text: str
) -> None:
    assert run(monkeypatch, *words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"dmframe: {text}")
    assert printed.err.count("\n") == 1


def test_ctrl_c_ends_it_with_one_line() -> None:
    words = [sys.executable, "-m", "dmframe", "robot", "ur10_fast", *FREE]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for _ in range(2):
            assert process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert process.stderr.read() == "dmframe: stopped\n"
