"""Chromium without a window, driven through its debugging pipe: no package and no port is needed."""

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

TURNS = 200
"""How often a page is asked before it is given up, 30 ms apart."""


@final
class Browser:
    """One tab; `said` is all that the page told its console, and every error in it."""

    def __init__(self, commands: int, answers: int) -> None:
        self._commands, self._answers, self._rest, self._count = commands, answers, b"", 0
        self.said = list[str]()
        target = self.ask("Target.createTarget", session=None, url="about:blank")["targetId"]
        self._session: str | None = None
        self._session = self.ask("Target.attachToTarget", session=None, targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, session: str | None = "", **params: Any) -> dict[str, Any]:
        """One command's result; what comes in between is kept in `said`."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            if answer.get("method") in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
                entry = answer["params"].get("entry", {})
                if entry.get("source") != "rendering":  # the browser's own remarks on a machine without a graphics card
                    self.said.append(json.dumps(answer["params"])[:600])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            found = os.read(self._answers, 1 << 20)
            assert found, "the browser ended"
            self._rest += found
        text, _, self._rest = self._rest.partition(b"\0")
        answer: dict[str, Any] = json.loads(text)
        return answer

    def opened(self, page: Path, fragment: str = "") -> None:
        """Open a file anew."""
        self.ask("Page.navigate", url="about:blank")
        self.said.clear()
        self.ask("Page.navigate", url=page.as_uri() + fragment)

    def value(self, expression: str) -> Any:
        """What an expression is in the page."""
        found = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, expression: str) -> Any:
        """The expression's value as soon as it is true."""
        for _ in range(TURNS):
            if found := self.value(f"document.readyState === 'complete' && ({expression})"):
                return found
            self.value("new Promise((done) => setTimeout(done, 30))")
        raise AssertionError(f"{expression}: never true; {self.said}")

    def dragged(self, element: str, start: float, end: float, steps: int = 6) -> None:
        """Hold an element with the mouse at a part of its width, and let it go at another."""
        box = self.value(
            f"(() => {{ const e = document.getElementById({element!r}); e.scrollIntoView({{block: 'center'}});"
            " const b = e.getBoundingClientRect(); return [b.x, b.width, b.y + b.height / 2]; })()"
        )
        left, width, y = box

        def mouse(kind: str, part: float) -> None:
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            self.ask("Input.dispatchMouseEvent", type=kind, x=left + part * width, y=y, **held)

        mouse("mousePressed", start)
        for k in range(1, steps + 1):
            mouse("mouseMoved", start + (end - start) * k / steps)
        mouse("mouseReleased", end)


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """A browser with a fresh profile in `folder`; the test is skipped where there is none."""
    found = shutil.which("chromium") or shutil.which("google-chrome")
    if found is None or shutil.which("bash") is None:
        pytest.skip("chromium is not installed")
    (read, commands), (answers, write) = os.pipe(), os.pipe()
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-pipe"]
    launch = ["bash", "-c", f'exec "$@" 3<&{read} 4>&{write}', "-", found, *options, f"--user-data-dir={folder}"]
    process = subprocess.Popen(launch, pass_fds=(read, write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(read)
    os.close(write)
    try:
        yield Browser(commands, answers)
    finally:
        process.terminate()
        process.wait()
        os.close(commands)
        os.close(answers)
