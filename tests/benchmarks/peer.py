"""What a peer is: a tool that simulates our closed loop."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from abc import ABC, abstractmethod
from typing import ClassVar

from tests.benchmarks.loop import Array, Loop


class Peer(ABC):
    """The closed loop in one tool.

    Making an instance builds the model; `run` simulates from the start each time it is called.

    Attributes
    ----------
    title : as the table calls it
    package : the distribution that it needs, as `pip` calls it; "" for none
    module : what to import from it
    method : how it integrates the plant, "" for as the graph says
    note : what is unfair, and to whom
    """

    title: ClassVar[str]
    package: ClassVar[str] = ""
    module: ClassVar[str] = ""
    method: ClassVar[str] = "RK4"
    note: ClassVar[str] = ""

    def __init__(self, loop: Loop, step: float) -> None:
        self.loop, self.step = loop, step
        self.build()

    @abstractmethod
    def build(self) -> None:
        """Make the model."""

    @abstractmethod
    def run(self, seconds: float) -> Array:
        """The joint angles at every sampling instant, (ticks + 1, n) [rad]."""

    def warm(self, seconds: float) -> None:
        """What is not timed: the compilation that a run of that length needs."""
        self.run(min(seconds, 1.0))

    @classmethod
    def missing(cls) -> str:
        """What is missing to run it, and how to install it; "" if nothing is."""
        if cls.module and importlib.util.find_spec(cls.module) is None:
            return f"missing: {cls.package} is not installed; pip install --group peers"
        return ""

    @classmethod
    def version(cls) -> str:
        """The tool's version."""
        return importlib.metadata.version(cls.package) if cls.package else ""
