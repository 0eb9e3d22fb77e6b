"""Serve the studio on this computer until Ctrl-C."""

from __future__ import annotations

import os
import secrets
import socket
import sys
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import uvicorn

from dmframe.catalogue import find_graph, graphs
from dmframe.common.errors import DocumentError, MissingError, OutputError, nearest
from dmframe.common.files import expanded, is_file, reason
from dmframe.studio.file import File
from dmframe.studio.server import application

HOST: Final = "127.0.0.1"
GRACE: Final = 2
"""Time for open connections to end [s]."""


def graph_file(name: str) -> Path:
    """The file to edit. Raises `MissingError` or `DocumentError` if there is none that an editor can show."""
    path = expanded(name)
    if not is_file(path) and name in graphs():
        raise DocumentError(f"{name} is a packaged graph; copy it first: dmframe new {name} mine.yaml")
    if path.is_dir():
        raise DocumentError("expected a graph file, found a folder; name a file in it", location=str(path))
    path = find_graph(name)
    if not path.exists():
        folder = path.parent
        near = nearest(path.name, [each.name for each in folder.glob("*.y*ml")] if folder.is_dir() else [])
        raise MissingError(f"expected a graph file, found none; {near}", location=str(path))
    if problem := File(path).read().problem:
        raise DocumentError(problem, location=str(path))
    return path.absolute()


def listening(port: int) -> socket.socket:
    """A socket on this computer only; port 0 is a free one. Raises `OutputError` if the port is in use."""
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # a port of which old connections are closing is free
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((HOST, port))
        found.listen()
    except OSError as error:
        found.close()
        raise OutputError(f"--port {port}: {reason(error)}; choose another, or leave it out for a free one") from None
    except OverflowError:
        found.close()
        raise OutputError(f"--port {port}: expected a number from 0 to 65535") from None
    return found


def serve(path: Path, port: int, *, browser: bool, tell: Callable[[str], None]) -> None:
    """Serve a graph file until Ctrl-C, and print the address with its token."""
    with listening(port) as place:
        port, token = place.getsockname()[1], secrets.token_urlsafe(24)
        app, studio = application(path, token, port)
        address = f"http://{HOST}:{port}/?token={token}"
        config = uvicorn.Config(
            app, log_level="error", access_log=False, timeout_graceful_shutdown=GRACE, lifespan="on"
        )
        server = _Server(config, studio.end)
        tell(f"studio of {path.name}: {address}\nCtrl-C ends it; the file changes only when you save")
        if browser and _has_window():
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):  # raised again by uvicorn after its end
            server.run(sockets=[place])
        tell("ended")


class _Server(uvicorn.Server):
    """Ends open streams at a signal, for which it would wait."""

    def __init__(self, config: uvicorn.Config, end: Callable[[], None]) -> None:
        super().__init__(config)
        self._end = end

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams, then as usual."""
        self._end()
        await super().shutdown(sockets)


def _has_window() -> bool:
    """True if a browser with a window can be opened."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
