"""Trials of a search, and those than which no other is better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Trial:
    """A trial that has ended.

    Parameters
    ----------
    values
        What was tried, by column.
    figures
        The objectives, in their order; of one that was stopped early, what they are at the least.
    state
        ``ran``, ``stopped``, ``broken`` (a limit, or a run that diverged) or ``refused``, before any run.
    why
        What speaks against it, in words.
    """

    number: int
    values: Mapping[str, float]
    figures: tuple[float, ...]
    state: str
    why: str


def dominates(one: Sequence[float], other: Sequence[float]) -> bool:
    """True where one is nowhere worse than the other, and somewhere better."""
    return all(a <= b for a, b in zip(one, other, strict=True)) and any(a < b for a, b in zip(one, other, strict=True))


def front_of(trials: Sequence[Trial]) -> list[Trial]:
    """Of trials that ran, those than which no other is better; of equal ones the first."""
    ran = sorted((each for each in trials if each.state == "ran"), key=lambda each: (each.figures, each.number))
    found = list[Trial]()
    for each in ran:
        if not any(all(a <= b for a, b in zip(other.figures, each.figures, strict=True)) for other in found):
            found.append(each)
    return found
