"""Browsers without a window, driven through what they offer to debuggers: no package is needed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

TURNS: Final = 200
"""How often a page is polled before it is given up, 30 ms apart."""
SHOW: Final = "document.getElementById({element!r}).scrollIntoView({{block: 'nearest'}})"
BOX: Final = (
    "(() => {{ const b = document.getElementById({element!r}).getBoundingClientRect();"
    " return [b.x, b.width, b.y + b.height / 2]; }})()"
)


class Browser(ABC):
    """One tab, with reduced motion; `said` is all that the page wrote to its console, and every error in it."""

    def __init__(self) -> None:
        self.said = list[str]()
        self._at = (0.0, 0.0)

    @abstractmethod
    def opened(self, page: Path, fragment: str = "") -> None:
        """Open a file anew."""

    @abstractmethod
    def value(self, expression: str) -> Any:
        """What an expression is in the page."""

    @abstractmethod
    def mouse(self, does: str, x: float, y: float) -> None:
        """The mouse ``moves`` to a place, or is ``pressed`` or ``released`` there."""

    @abstractmethod
    def left_arrow(self) -> None:
        """Press this key."""

    @abstractmethod
    def sized(self, width: int | None, height: int | None = None) -> None:
        """Give the page a telephone's size; without numbers, that of the window."""

    def until(self, expression: str, turns: int = TURNS) -> Any:
        """The expression's value as soon as it is true."""
        for _ in range(turns):
            if found := self.value(f"document.readyState === 'complete' && ({expression})"):
                return found
            self.value("new Promise((done) => setTimeout(done, 30))")
        raise AssertionError(f"{expression}: never true; {self.said}")

    def dragged(self, element: str, *parts: float, steps: int = 6) -> None:
        """Hold an element with the mouse at the first of these parts of its width, and let it go at the last."""
        self.held(element, *parts, steps=steps)
        self.let_go()

    def held(self, element: str, *parts: float, steps: int = 6) -> None:
        """The same without letting it go."""
        self.value(SHOW.format(element=element))
        places = [self.spot(element, part) for part in parts]
        self._at = places[0]
        self.mouse("pressed", *self._at)
        for x in between([x for x, _ in places], steps):
            self._at = (x, self._at[1])
            self.mouse("moves", *self._at)

    def spot(self, element: str, part: float) -> tuple[float, float]:
        """A place in an element, at a part of its width."""
        left, width, y = self.value(BOX.format(element=element))
        return left + part * width, y

    def let_go(self) -> None:
        """Release what was held, where it is."""
        self.mouse("released", *self._at)


def between(places: Sequence[float], steps: int) -> list[float]:
    """From each place to the next in steps of one length."""
    return [a + (b - a) * k / steps for a, b in pairwise(places) for k in range(1, steps + 1)]
