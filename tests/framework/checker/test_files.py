"""Files that cannot be read, and outputs that cannot be written, of both checkers as programs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.framework.checker.certificates import CHECKER, SCRIPT, node_path
from tests.framework.checker.written import stable

TEXT = json.dumps(stable().data)
CONTENTS = {
    "an empty file": b"",
    "null": b"null",
    "an empty object": b"{}",
    "another object": b'{"format": "dmframe-certificate"}',
    "deep lists": b"[" * 100_000 + b"]" * 100_000,
    "deep objects": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
    "30 MB": TEXT.encode() + b" " * 3 * 10**7,
    "zeros": bytes(1000),
    "no UTF-8": TEXT.encode()[:-1] + b"\xe9",
}
"""Contents of files; `readings.texts` has further ones, which are read without a process of their own."""


def commands() -> list[list[str]]:
    """Both programs."""
    return [[sys.executable, "-I", "-S", str(CHECKER)], [node_path(), str(SCRIPT)]]


def refused(command: list[str], path: Path | str) -> None:
    """The program ends with status 2, without a traceback, and gives one reason in one line."""
    done = subprocess.run([*command, str(path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, ""), (command, path)
    first, second = done.stdout.splitlines()
    assert first == "status: refused"
    assert second.startswith("reason: ")
    assert 10 < len(second) < 300
    assert second.isascii()


@pytest.mark.parametrize("what", CONTENTS)
def test_a_file_that_is_no_certificate_is_refused_with_one_reason(tmp_path: Path, what: str) -> None:
    path = tmp_path / "file.json"
    path.write_bytes(CONTENTS[what])
    for command in commands():
        refused(command, path)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    closed = tmp_path / "closed.json"
    closed.write_text(TEXT)
    closed.chmod(0)
    paths = [tmp_path, tmp_path / "none.json", "/dev/null", "/dev/zero", *[closed] * (os.getuid() != 0)]
    for command in commands():
        for path in paths:
            refused(command, path)
        for words in ([], [str(closed), str(closed)]):
            done = subprocess.run([*command, *words], capture_output=True, text=True, check=False)
            assert (done.returncode, done.stderr) == (2, "")
            assert "usage: " in done.stdout


def test_a_closed_pipe_does_not_change_the_outcome_and_a_full_disk_does(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text(TEXT)
    for command in commands():
        for words in ([], ["--json"]):
            own = [*command, str(path), *words]
            reader, writer = os.pipe()
            os.close(reader)
            done = subprocess.run(own, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
            os.close(writer)
            assert (done.returncode, done.stderr) == (0, "")
            with Path("/dev/full").open("w") as full:
                done = subprocess.run(own, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
            assert (done.returncode, done.stderr) == (2, "")


def test_both_programs_print_the_same_lines(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text(TEXT)
    first, second = (
        subprocess.run([*own, str(path)], capture_output=True, text=True, check=True) for own in commands()
    )
    lines = [done.stdout.splitlines() for done in (first, second)]
    assert len(lines[0]) > 10
    assert [x for x in lines[0] if "log2 error" not in x] == [x for x in lines[1] if "log2 error" not in x]
