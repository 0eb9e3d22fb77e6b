"""Firefox, through WebDriver BiDi: JSON over a web socket of this machine."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from threading import Thread
from typing import Any, Final, final

import pytest
from in_browser import Browser

PREFERENCES: Final = {"ui.prefersReducedMotion": 1}
"""A stationary robot leaves computing time for the rest."""
LISTENS: Final = re.compile(r"WebDriver BiDi listening on ws://127\.0\.0\.1:(\d+)")
PATIENCE: Final = 60.0
"""Timeout of an answer of the browser [s]."""
FINAL, TEXT, MASKED, PING, PONG = 0x80, 0x1, 0x80, 0x9, 0xA
BUTTON: Final = {"moves": [], "pressed": ["pointerDown"], "released": ["pointerUp"]}
LEFT_ARROW: Final = "\ue012"


@final
class WebSocket:
    """A client of RFC 6455 for texts, limited to what the tests need."""

    def __init__(self, port: int, path: str) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE)
        self._stream = self._socket.makefile("rb")
        key = base64.b64encode(os.urandom(16)).decode()
        request = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade"]
        request += [f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", ""]
        self._socket.sendall("\r\n".join(request).encode())
        head = list(iter(self._stream.readline, b"\r\n"))
        assert b" 101 " in head[0], head

    def send(self, text: str) -> None:
        """Send one text."""
        self._frame(TEXT, text.encode())

    def _frame(self, kind: int, data: bytes) -> None:
        size, mask = len(data), os.urandom(4)
        length = bytes([MASKED | size]) if size < 126 else struct.pack(">BH", MASKED | 126, size)
        if size >= 1 << 16:
            length = struct.pack(">BQ", MASKED | 127, size)
        key = (mask * (size // 4 + 1))[:size]
        masked = (int.from_bytes(data) ^ int.from_bytes(key)).to_bytes(size)
        self._socket.sendall(bytes([FINAL | kind]) + length + mask + masked)

    def received(self) -> str:
        """Receive the next text."""
        whole = b""
        while True:
            first, second = self._stream.read(2)
            size = second & 0x7F
            if size > 125:
                size = int.from_bytes(self._stream.read(2 if size == 126 else 8))
            data = self._stream.read(size)
            if first & 0xF == PING:
                self._frame(PONG, data)
                continue
            whole += data
            if first & FINAL:
                return whole.decode()

    def close(self) -> None:
        """Close it without a closing handshake."""
        self._stream.close()
        self._socket.close()


@final
class Firefox(Browser):
    """One tab, driven over a web socket."""

    def __init__(self, channel: WebSocket) -> None:
        super().__init__()
        self._channel, self._count = channel, 0
        self.ask("session.new", capabilities={})
        (tab,) = self.ask("browsingContext.getTree")["contexts"]
        self._tab = tab["context"]
        self.ask("session.subscribe", events=["log.entryAdded"])

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Result of one command; events in between are stored in `said`."""
        self._count += 1
        self._channel.send(json.dumps({"id": self._count, "method": method, "params": params}))
        while True:
            answer = json.loads(self._channel.received())
            if answer.get("id") == self._count:
                assert answer["type"] == "success", answer
                result: dict[str, Any] = answer["result"]
                return result
            if answer.get("method") == "log.entryAdded":
                self.said.append(json.dumps(answer["params"])[:600])

    def opened(self, page: Path, fragment: str = "") -> None:
        self.ask("browsingContext.navigate", context=self._tab, url="about:blank", wait="complete")
        self.said.clear()
        self.ask("browsingContext.navigate", context=self._tab, url=page.as_uri() + fragment, wait="none")

    def value(self, expression: str) -> Any:
        found = self.ask("script.evaluate", expression=expression, target={"context": self._tab}, awaitPromise=True)
        assert found["type"] == "success", found
        return plain(found["result"])

    def mouse(self, does: str, x: float, y: float) -> None:
        steps: list[dict[str, Any]] = [{"type": "pointerMove", "x": round(x), "y": round(y)}]
        steps += [{"type": kind, "button": 0} for kind in BUTTON[does]]
        self._act({"type": "pointer", "id": "mouse", "actions": steps})

    def left_arrow(self) -> None:
        steps = [{"type": kind, "value": LEFT_ARROW} for kind in ("keyDown", "keyUp")]
        self._act({"type": "key", "id": "keys", "actions": steps})

    def _act(self, source: dict[str, Any]) -> None:
        self.ask("input.performActions", context=self._tab, actions=[source])

    def sized(self, width: int | None, height: int | None = None) -> None:
        size = None if width is None else {"width": width, "height": height}
        self.ask("browsingContext.setViewport", context=self._tab, viewport=size)


def plain(value: dict[str, Any]) -> Any:
    """A value of BiDi in Python; None for one that cannot leave the page."""
    match value["type"]:
        case "array":
            return [plain(item) for item in value["value"]]
        case "object":
            return {name: plain(item) for name, item in value["value"]}
        case "number" if isinstance(value["value"], str):
            return float(value["value"].replace("Infinity", "inf"))
        case "string" | "number" | "boolean":
            return value["value"]
        case _:
            return None


@contextmanager
def firefox(folder: Path) -> Iterator[Firefox]:
    """A browser with a fresh profile in `folder`; the test is skipped if there is none."""
    found = shutil.which("firefox-esr") or shutil.which("firefox")
    if found is None:
        pytest.skip("firefox is not installed")
    lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items()]
    (folder / "user.js").write_text("".join(lines))
    words = [found, "--headless", "--no-remote", "--remote-debugging-port", "0", "--profile", str(folder)]
    streams: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, env=os.environ | {"HOME": str(folder)}, **streams) as process:
        assert process.stderr is not None
        drain = Thread(target=process.stderr.read, daemon=True)  # so that the browser never blocks on its output
        try:
            listens = next((place for line in process.stderr if (place := LISTENS.search(line))), None)
            assert listens is not None, "firefox ended before it listened"
            drain.start()
            with closing(WebSocket(int(listens[1]), "/session")) as channel:
                yield Firefox(channel)
        finally:
            process.terminate()
            if drain.ident:
                drain.join()
