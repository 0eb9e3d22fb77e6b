"""Progress of a design with the estimated time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, final

Say = Callable[[str], None]

STAGES: Final = {
    "robot": 2,
    "tuning": 28,
    "comparison": 21,
    "proof": 7,
    "rehearsal": 60,
    "export": 32,
    "page": 30,
}
"""Usual processor time of each stage, in the order of the stages; of a UR5e in seconds."""
EARLY: Final = 0.02
"""Fraction below which no time is estimated."""


@final
class Progress:
    """Messages of the stages, each with the estimated rest.

    The estimate is the elapsed time, multiplied by the usual share of what is left in that of what was done since then;
    what an earlier command did is no part of it.
    """

    def __init__(self, say: Say) -> None:
        self._say, self._began, self._kept = say, time.monotonic(), 0.0

    def say(self, stage: str, text: str, share: float = 0.0) -> None:
        """The state of a stage of which a share is done."""
        names = list(STAGES)
        done = sum(STAGES[name] for name in names[: names.index(stage)]) + STAGES[stage] * share
        since, total = done - self._kept, sum(STAGES.values())
        rest = ""
        if since > EARLY * total:
            left = (time.monotonic() - self._began) * (total - done) / since
            rest = f"; about {_duration(left)} left in all"
        self._say(f"{text}{rest}")

    def keep(self, stage: str, share: float = 1.0) -> None:
        """A share of a stage that an earlier command did."""
        self._kept += STAGES[stage] * share


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
