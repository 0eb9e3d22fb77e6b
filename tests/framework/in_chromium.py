"""Chromium, through its debugging pipe."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import pytest
from in_browser import Browser

MOUSE = {"moves": "mouseMoved", "pressed": "mousePressed", "released": "mouseReleased"}


@final
class Chromium(Browser):
    """One tab, driven over two pipes."""

    def __init__(self, commands: int, answers: int) -> None:
        super().__init__()
        self._commands, self._answers, self._rest, self._count = commands, answers, b"", 0
        target = self.ask("Target.createTarget", session=None, url="about:blank")["targetId"]
        self._session: str | None = None
        self._session = self.ask("Target.attachToTarget", session=None, targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.ask(f"{domain}.enable")
        self.motion(False)

    def ask(self, method: str, session: str | None = "", **params: Any) -> dict[str, Any]:
        """Result of one command; events in between are stored in `said`."""
        number = self._send(method, session, params)
        while True:
            answer = self._next()
            if answer.get("method") == "Page.javascriptDialogOpening":  # whether the page may be left: yes
                self._send("Page.handleJavaScriptDialog", "", {"accept": True})
            if answer.get("id") == number:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            if answer.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                entry = answer["params"].get("entry", {})
                if entry.get("source") != "rendering":  # messages about a missing graphics card
                    self.said.append(json.dumps(answer["params"])[:600])

    def _send(self, method: str, session: str | None, params: dict[str, Any]) -> int:
        """Send a command without waiting for its result; returns its number."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        return self._count

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            found = os.read(self._answers, 1 << 20)
            assert found, "the browser ended"
            self._rest += found
        text, _, self._rest = self._rest.partition(b"\0")
        answer: dict[str, Any] = json.loads(text)
        return answer

    def opened(self, page: Path, fragment: str = "") -> None:
        self.visit(page.as_uri() + fragment)

    def visit(self, address: str) -> None:
        """Open an address again."""
        self.ask("Page.navigate", url="about:blank")
        self.said.clear()
        self.ask("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        found = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def mouse(self, does: str, x: float, y: float) -> None:
        held = {"button": "left", "buttons": 1, "clickCount": 1}
        self.ask("Input.dispatchMouseEvent", type=MOUSE[does], x=x, y=y, **held)

    def left_arrow(self) -> None:
        self.ask("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft", windowsVirtualKeyCode=37)

    def sized(self, width: int | None, height: int | None = None) -> None:
        if width is None:
            self.ask("Emulation.clearDeviceMetricsOverride")
            return
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=True)

    def motion(self, wanted: bool) -> None:
        """Whether the reader prefers motion; without it, a stationary robot leaves computing time for the rest."""
        calm = [] if wanted else [{"name": "prefers-reduced-motion", "value": "reduce"}]
        self.ask("Emulation.setEmulatedMedia", features=calm)


@contextmanager
def chromium(folder: Path, *more: str) -> Iterator[Chromium]:
    """A browser with a fresh profile in `folder` and `more` options; the test is skipped if there is none."""
    found = shutil.which("chromium") or shutil.which("google-chrome")
    if found is None or shutil.which("bash") is None:
        pytest.skip("chromium is not installed")
    (read, commands), (answers, write) = os.pipe(), os.pipe()
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-pipe", *more]
    launch = ["bash", "-c", f'exec "$@" 3<&{read} 4>&{write}', "-", found, *options, f"--user-data-dir={folder}"]
    process = subprocess.Popen(launch, pass_fds=(read, write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(read)
    os.close(write)
    try:
        yield Chromium(commands, answers)
    finally:
        process.terminate()
        process.wait()
        os.close(commands)
        os.close(answers)
