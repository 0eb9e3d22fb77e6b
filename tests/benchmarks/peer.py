"""The interface of a compared tool: a simulator of the closed loop."""

from __future__ import annotations

import importlib.metadata
import importlib.util
from abc import ABC, abstractmethod
from typing import ClassVar

from tests.benchmarks.loop import Array, Loop


class Peer(ABC):
    """The closed loop in one tool.

    Construction builds the model; `run` simulates from the start at each call.

    Attributes
    ----------
    title : name in the table
    package : the required distribution, by its name for `pip`; "" for none
    module : the module to import from it
    method : integration method of the plant; "" for that of the graph
    note : in which respect the comparison is unfair, and to which tool
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
        """Preparation that is not timed: the compilation for a run of that length."""
        self.run(min(seconds, 1.0))

    @classmethod
    def missing(cls) -> str:
        """What is missing to run the tool, and how to install it; "" if it can run."""
        if cls.module and importlib.util.find_spec(cls.module) is None:
            return f"missing: {cls.package} is not installed; pip install --group peers"
        return ""

    @classmethod
    def version(cls) -> str:
        """The tool's version."""
        return importlib.metadata.version(cls.package) if cls.package else ""
