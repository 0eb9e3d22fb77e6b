"""What files and figures know of a run."""

from __future__ import annotations

from typing import Protocol

from dmframe.config import Experiment
from dmframe.results.storage import Storage
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

    @property
    def whole(self) -> Recording:
        """The same with V among its signals, where there is a V."""

    @property
    def notices(self) -> tuple[str, ...]:
        """What the run has to say of itself."""

    @property
    def storage(self) -> Storage:
        """V along the run; raises `DmframeError` with the reason where there is none."""
