"""Candidates for the design: tuned laws, and the next best values of a law that fails a check."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, final

from dmframe.design.decide import Candidate, Ranking, ranked
from dmframe.race.compute import Kept, computed
from dmframe.race.plan import Cell, Run
from dmframe.race.protocol import Choice
from dmframe.race.run import Finished

TRIED: Final = 3
"""Values of a law that are checked, the best in training first; the same number for each law."""


@final
class Contest:
    """A finished race, and further candidates of its laws.

    Attributes
    ----------
    ranking
        All laws with the values that the protocol chose.
    """

    def __init__(self, finished: Finished, adaptive: Sequence[str], workers: int | None) -> None:
        self._finished, self._workers = finished, workers
        self.ranking: Ranking = ranked(finished, adaptive)

    @property
    def hardest(self) -> Cell:
        """The cell in which most laws diverged."""
        return max(self._finished.rows, key=lambda row: sum(map(math.isinf, row.errors.values()))).cell

    def candidates(self, *, adaptive: bool) -> Iterator[Candidate]:
        """Laws of a kind in the order of their errors; of each the values with the best training scores."""
        for chosen in self.ranking.ordered(adaptive=adaptive):
            yield chosen
            for choice in self._finished.choices:
                if choice.law == chosen.law:
                    yield from self._others(choice, chosen)

    def _others(self, choice: Choice, chosen: Candidate) -> Iterator[Candidate]:
        accepted = sorted((tried for tried in choice.tried if not tried.why), key=lambda tried: tried.score)
        for tried in accepted[1:TRIED]:
            race = self._finished.race
            runs = [Run(choice.law, cell, tried.values, race.file.seed + 1) for cell in race.held_out]
            errors = computed(race, runs, Kept(self._finished.folder), workers=self._workers)
            yield Candidate(chosen.law, chosen.adaptive, dict(tried.values), [errors[run] for run in runs])
