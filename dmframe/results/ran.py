"""What files and figures know of a run."""

from __future__ import annotations

from typing import Protocol

from dmframe.config import Experiment
from dmframe.simulate import Recording


class Ran(Protocol):
    """An experiment with its recording; a `dmframe.results.run.Run` is one."""

    @property
    def name(self) -> str:
        """What tables and legends call it."""

    @property
    def experiment(self) -> Experiment:
        """What was run."""

    @property
    def recording(self) -> Recording:
        """What came of it."""
