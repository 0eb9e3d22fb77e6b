"""Protocol through which result writers and figures read a run."""

from __future__ import annotations

from typing import Protocol

from dmframe.config import BaseGraph
from dmframe.results.storage import Storage
from dmframe.simulate import Recording


class RunLike(Protocol):
    """BaseGraph with its recording, e.g. `dmframe.results.run.Run`."""

    @property
    def name(self) -> str:
        """Name in tables and legends."""

    @property
    def graph(self) -> BaseGraph:
        """Graph of the run."""

    @property
    def recording(self) -> Recording:
        """Recorded states and outputs."""

    @property
    def whole(self) -> Recording:
        """Recording with V among its signals, if defined."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Warnings of the run."""

    @property
    def storage(self) -> Storage:
        """V along the run; raises `DmframeError` if it is not defined."""
