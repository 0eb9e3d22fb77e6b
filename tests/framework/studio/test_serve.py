"""``dmframe studio``: what it refuses to edit, and how it ends."""

from __future__ import annotations

import re
import signal
import socket
from http.client import HTTPConnection
from importlib import util
from pathlib import Path
from typing import Any

import pytest

from dmframe.common.errors import DmframeError
from dmframe.studio.serve import graph_file, listening


def test_ctrl_c_ends_the_server_and_its_worker_with_a_tab_open(started: Any, path: Path) -> None:
    before = path.read_bytes()
    with started(path) as (process, address):
        port, token = re.findall(r":(\d+)/\?token=(\S+)", address)[0]
        tab = HTTPConnection("127.0.0.1", int(port), timeout=30)
        tab.request("GET", "/events", headers={"Cookie": f"dmframe_studio_{port}={token}"})
        assert tab.getresponse().readline().startswith(b"data: ")
        assert len(workers(path)) == 1
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
        tab.close()
    assert (process.returncode, err) == (0, "")
    assert out.splitlines()[-1] == "ended"
    assert path.read_bytes() == before
    assert workers(path) == []


def workers(path: Path) -> list[str]:
    """Processes that examine this file."""
    lines = [entry.read_bytes() for entry in Path("/proc").glob("[0-9]*/cmdline") if entry.exists()]
    return [line.decode() for line in lines if b"dmframe.studio.worker" in line and str(path).encode() in line]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("pendulum", None, "pendulum is a packaged graph; copy it first: dmframe new pendulum mine.yaml"),
        ("none.yaml", None, "expected a graph file, found none"),
        ("binary.yaml", b"\0\1", "the file is binary"),
        ("bytes.yaml", b"\xff", "save the file as UTF-8"),
        ("huge.yaml", b"#" * 1_000_001, "more than 1000000 bytes"),
        (".", None, "expected a graph file, found a folder"),
    ],
)
def test_what_cannot_be_edited_is_refused_with_the_reason(
    name: str, content: bytes | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(name).write_bytes(content)
    with pytest.raises(DmframeError, match=re.escape(message)):
        graph_file(name)


def test_a_text_with_faults_can_be_edited(tmp_path: Path) -> None:
    path = tmp_path / "faulty.yaml"
    path.write_text("dmframe: [")
    assert graph_file(str(path)) == path


def test_it_listens_on_this_computer_alone_and_names_a_port_in_use() -> None:
    with listening(0) as first:
        host, port = first.getsockname()
        assert host == "127.0.0.1"
        with pytest.raises(DmframeError, match=f"--port {port}: address already in use; choose another"):
            listening(port)
    with pytest.raises(DmframeError, match="expected a number from 0 to 65535"):
        listening(70_000)
    listening(port).close()
    assert socket.gethostbyname("localhost") == "127.0.0.1"


def test_without_its_packages_it_names_the_extra(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    from dmframe.cli import studio

    def find(name: str, *_: Any) -> Any:
        return None if name == "uvicorn" else util.find_spec(name)

    monkeypatch.setattr(studio, "find_spec", find)
    with pytest.raises(DmframeError, match=re.escape("uvicorn not installed; pip install -e ")):
        studio.studio(str(path))
