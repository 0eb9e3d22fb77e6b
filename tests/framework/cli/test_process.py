"""`dmframe` as a process: streams, pipes, signals, no terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import dmframe

START = (sys.executable, "-c", "from dmframe.cli import main; main()")
QUICK = (
    "import dmframe.report.content as content\n"
    "from dmframe.report.linear import LinearView\n"
    "from dmframe.report.measured import Measured\n"
    "content.linear_view = lambda *_: LinearView('Not looked at.')\n"
    "content.measure = lambda *_: Measured('Not measured.')\n"
)
"""Runs before a report whose content is not tested: it omits its longest sections."""
LONG = ("run", "pendulum", "--until", "2000 s", "--no-plots", "--out", "mine")
FILES = {"graph.yaml", "provenance.json", "seal.json", "signals.nc", "summary.json"}


@pytest.fixture(autouse=True)
def listening() -> Iterator[None]:
    """Processes that a shell starts in the background, and their children, ignore signals of the terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler), signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    for number, handler in zip((signal.SIGINT, signal.SIGHUP), before, strict=True):
        signal.signal(number, handler)


def started(words: Sequence[str], cwd: Path, hook: str = "", **options: Any) -> subprocess.Popen[str]:
    streams: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    return subprocess.Popen([*START[:2], hook + START[2], *words], cwd=cwd, text=True, **(streams | options))


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    try:
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert "Traceback" not in (out or "") + (err or "")
    return process.returncode, out, err


def test_without_a_terminal_there_is_no_progress_bar_and_no_colour(tmp_path: Path) -> None:
    status, out, err = ended(started(("run", "arm2_joint", "--until", "1", "--no-plots"), tmp_path))
    assert (status, err) == (0, "")
    assert "\x1b" not in out
    assert "\r" not in out


def test_the_installed_script_is_the_same_command(tmp_path: Path) -> None:
    script = Path(sys.executable).with_name("dmframe")
    if not script.exists():
        pytest.skip("the distribution is not installed here")
    done = subprocess.run([script, "graphs"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("arm2_joint ")


def test_the_package_run_as_a_module_is_the_same_command(tmp_path: Path) -> None:
    def reported(*words: str) -> tuple[int, str, str]:
        command = [sys.executable, "-m", "dmframe", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr

    assert reported("--version") == (0, f"dmframe {dmframe.__version__}\n", "")
    status, out, err = reported("check", "nosuch")
    assert (status, out) == (2, "")
    assert err.startswith("dmframe: nosuch: ")


def test_a_reader_that_has_gone_is_no_fault(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    process = started(("blocks",), tmp_path, stdout=writer)
    os.close(writer)
    status, _, err = ended(process)
    assert (status, err) == (0, "")


SHORT = ("run", "arm2_joint", "--until", "0.1", "--no-plots", "--out", "mine")


def held(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_reader_that_has_gone_loses_no_results(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    process = started((*SHORT, "--json"), tmp_path, stdout=writer)
    os.close(writer)
    assert ended(process)[::2] == (0, "")
    assert held(tmp_path / "mine") == FILES


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_cannot_be_written_loses_no_report(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        status, _, err = ended(
            started(("verify", "pendulum", "--set", "duration=0.1", "--report", "r.md"), tmp_path, QUICK, stdout=full)
        )
    assert (status, err) == (2, "dmframe: cannot write the output: no space left on device\n")
    assert held(tmp_path) == {"r.md"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_cannot_be_written_loses_no_results(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        status, _, err = ended(started(SHORT, tmp_path, stdout=full, stderr=subprocess.PIPE))
    assert (status, err) == (2, "dmframe: cannot write the output: no space left on device\n")
    assert held(tmp_path / "mine") == FILES


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("words", [("run", "nosuch"), ("run", "--nosuch")])
def test_a_fault_that_cannot_be_printed_has_its_status(words: tuple[str, ...], tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        out = subprocess.PIPE if words[1] == "nosuch" else full
        assert ended(started(words, tmp_path, stdout=out, stderr=full))[0] == 2


@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)])
def test_streams_may_be_closed(closed: tuple[int, ...], tmp_path: Path) -> None:
    shut = " ".join(f"{number}>&-" for number in closed)
    words = ["sh", "-c", f'exec "$@" {shut}', "sh", *START]
    assert ended(subprocess.Popen([*words, *SHORT], cwd=tmp_path))[0] == 0
    assert held(tmp_path / "mine") == FILES
    if 2 in closed:  # where faults are printed
        assert ended(subprocess.Popen([*words, "run", "nosuch"], cwd=tmp_path))[0] == 2


def test_letters_that_the_terminal_has_not_are_escaped(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    status, out, err = ended(started((SHORT[0], "pendulum", *SHORT[2:]), tmp_path, env=environment))
    assert (status, err) == (0, "")
    assert "\\xb5rad" in out
    assert held(tmp_path / "mine") == FILES


def test_names_of_bytes_that_are_no_letters_are_escaped(tmp_path: Path) -> None:
    graph = os.fsencode(tmp_path) + b"/bad\xff.yaml"
    assert ended(started(("new", "pendulum", os.fsdecode(graph)), tmp_path))[0] == 0
    words = ("run", os.fsdecode(graph), "--until", "0.1", "--no-plots", "--out", os.fsdecode(b"o\xff"))
    status, out, err = ended(started(words, tmp_path))
    assert (status, err) == (0, "")
    assert out.splitlines()[-1] == "results: o\\udcff"
    data = json.loads(tmp_path.joinpath(os.fsdecode(b"o\xff"), "summary.json").read_text(encoding="utf-8"))
    assert (data["graph"], data["out"]) == ("bad\udcff", "o\udcff")
    words = ("verify", os.fsdecode(graph), "--set", "duration=0.1", "--report", "r.html")
    assert ended(started(words, tmp_path, QUICK))[::2] == (0, "")
    assert held(tmp_path) == {"r.html", "dmframe.schema.json", os.fsdecode(b"bad\xff.yaml"), os.fsdecode(b"o\xff")}


def test_no_signal_breaks_the_writing_of_results(tmp_path: Path) -> None:
    hook = (
        "import signal, dmframe.results.folder as folder\n"
        "write = folder.netcdf\n"
        "def hooked(*words):\n"
        "    for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT):\n"
        "        signal.raise_signal(number)\n"
        "    return write(*words)\n"
        "folder.netcdf = hooked\n"
        "from dmframe.cli import main\n"
        "main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", hook, *SHORT],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    status, out, err = ended(process)
    assert (status, err) == (130, "dmframe: stopped\n")
    assert out.splitlines()[-1] == "results: mine"
    assert held(tmp_path) == {"mine"}
    assert held(tmp_path / "mine") == FILES


def interrupted_while_running(words: Sequence[str], cwd: Path, number: int = signal.SIGINT) -> tuple[int, str, str]:
    """Ctrl-C at the first progress, which the process reports on a pipe, so no clock is needed."""
    received, sent = os.pipe()
    hook = (
        "import os, dmframe.simulate.run as run\n"
        "march = run.march\n"
        "def hooked(*args, **kw):\n"
        "    words = list(args)\n"
        "    progress = words[6]\n"
        "    def hook(time):\n"
        f"        os.write({sent}, b'x')\n"
        "        progress(time)\n"
        "    words[6] = hook\n"
        "    return march(*words, **kw)\n"
        "run.march = hooked\n"
        "from dmframe.cli import main\n"
        "main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", hook, *words],
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=(sent,),
    )
    os.close(sent)
    assert os.read(received, 1) == b"x"
    process.send_signal(number)
    os.close(received)
    return ended(process)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_leaves_a_complete_folder_with_what_was_computed(number: int, tmp_path: Path) -> None:
    status, out, err = interrupted_while_running(LONG, tmp_path, number)
    assert (status, err) == (130, "dmframe: stopped\n")
    assert "the results so far are kept" in out
    assert out.splitlines()[-1] == "results: mine"
    assert {path.name for path in tmp_path.joinpath("mine").iterdir()} == FILES
    data = json.loads(tmp_path.joinpath("mine", "summary.json").read_text(encoding="utf-8"))
    assert data["interrupted"] is True
    import xarray

    time = xarray.open_dataset(tmp_path / "mine" / "signals.nc", engine="h5netcdf")["time"]
    assert time.size > 1
    assert 0 < time[-1] < 1000
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("moment", ["dmframe.cli.run", "pinocchio"])
def test_ctrl_c_before_anything_was_computed_leaves_nothing(moment: str, tmp_path: Path) -> None:
    hook = (
        "import sys, signal\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {moment!r}:\n"
        "            signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from dmframe.cli import main\n"
        "main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", hook, *LONG],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert ended(process) == (130, "", "dmframe: stopped\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_in_the_second_graph_keeps_the_first(tmp_path: Path) -> None:
    hook = (
        "import signal, dmframe.config.graph as run\n"
        "simulate, count = run.simulate, []\n"
        "def hooked(*args, **kw):\n"
        "    count.append(1)\n"
        "    if len(count) == 2:\n"
        "        signal.raise_signal(signal.SIGINT)\n"
        "    return simulate(*args, **kw)\n"
        "run.simulate = hooked\n"
        "from dmframe.cli import main\n"
        "main()\n"
    )
    words = ("run", "arm2_joint", "pendulum", "--until", "0.1", "--no-plots", "--json", "--out", "mine")
    process = subprocess.Popen(
        [sys.executable, "-c", hook, *words],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    status, out, err = ended(process)
    assert (status, err) == (130, "dmframe: stopped\n")
    assert [data["graph"] for data in json.loads(out)] == ["arm2_joint"]
    assert {path.name for path in tmp_path.joinpath("mine").iterdir()} == FILES
