"""Headless browsers, driven through their debugging interfaces: no package is needed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

TURNS: Final = 200
"""Number of polls of a page before the test fails, 30 ms apart."""
SHOW: Final = "document.getElementById({element!r}).scrollIntoView({{block: 'nearest'}})"
BOX: Final = (
    "(() => {{ const b = document.getElementById({element!r}).getBoundingClientRect();"
    " return [b.x, b.width, b.y + b.height / 2]; }})()"
)


class Browser(ABC):
    """One tab, with reduced motion; `said` is all output of the page to its console, with every error."""

    def __init__(self) -> None:
        self.said = list[str]()
        self._at = (0.0, 0.0)

    @abstractmethod
    def opened(self, page: Path, fragment: str = "") -> None:
        """Open a file again."""

    @abstractmethod
    def value(self, expression: str) -> Any:
        """Value of an expression in the page."""

    @abstractmethod
    def mouse(self, does: str, x: float, y: float) -> None:
        """The mouse ``moves`` to a place, or is ``pressed`` or ``released`` there."""

    @abstractmethod
    def left_arrow(self) -> None:
        """Press this key."""

    @abstractmethod
    def sized(self, width: int | None, height: int | None = None) -> None:
        """Set the page to the size of a phone; without numbers, to that of the window."""

    def until(self, expression: str, turns: int = TURNS) -> Any:
        """The expression's value as soon as it is true."""
        for _ in range(turns):
            if found := self.value(f"document.readyState === 'complete' && ({expression})"):
                return found
            self.value("new Promise((done) => setTimeout(done, 30))")
        raise AssertionError(f"{expression}: never true; {self.said}")

    def dragged(self, element: str, *parts: float, steps: int = 6) -> None:
        """Press the mouse on an element at the first of these fractions of its width, and release it at the last."""
        self.held(element, *parts, steps=steps)
        self.let_go()

    def held(self, element: str, *parts: float, steps: int = 6) -> None:
        """The same without release."""
        self.value(SHOW.format(element=element))
        places = [self.spot(element, part) for part in parts]
        self._at = places[0]
        self.mouse("pressed", *self._at)
        for x in between([x for x, _ in places], steps):
            self._at = (x, self._at[1])
            self.mouse("moves", *self._at)

    def spot(self, element: str, part: float) -> tuple[float, float]:
        """A place in an element, at a fraction of its width."""
        left, width, y = self.value(BOX.format(element=element))
        return left + part * width, y

    def let_go(self) -> None:
        """Release the mouse at its place."""
        self.mouse("released", *self._at)


def between(places: Sequence[float], steps: int) -> list[float]:
    """From each place to the next in steps of one length."""
    return [a + (b - a) * k / steps for a, b in pairwise(places) for k in range(1, steps + 1)]
