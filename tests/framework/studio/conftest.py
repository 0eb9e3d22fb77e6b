from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from dmframe.catalogue import find_graph

STUDIO = "import sys; from dmframe.cli import main; sys.argv = ['dmframe', 'studio', *sys.argv[1:]]; main()"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A graph file of the user's own."""
    made = tmp_path / "mine.yaml"
    made.write_bytes(find_graph("pendulum").read_bytes())
    return made


@contextmanager
def started(path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command for a file, and the address that it prints."""
    command = [sys.executable, "-c", STUDIO, str(path), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", process.stdout.readline())
        assert address is not None
        try:
            yield process, address[0]
        finally:
            process.terminate()


@pytest.fixture(scope="session", name="started")
def _started() -> Callable[[Path], object]:
    return started
