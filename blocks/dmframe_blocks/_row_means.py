"""Means of successive rows, each of which is one row for an estimator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block import SX, DelayLine, Signals, named
from dmframe_blocks._averaged_servo import AveragedServo


@final
@dataclass(frozen=True)
class RowMeans:
    """Means of `number` successive rows and outputs; the states `late_rows` and `late_goals` hold the earlier ones."""

    averaged: AveragedServo
    number: int

    def after(self, x: Signals, row: SX, goal: SX) -> tuple[SX, SX, dict[str, SX]]:
        """The mean of a new row and the previous ones, of which there are fewer at first; and the stored rows."""
        if self.number == 1:
            return row, goal, {}
        averaged, number = self.averaged, named("number", ca.fmax(1, ca.fmin(x.count, self.number)))
        late = {"late_rows": averaged.pushed(x.late_rows, row), "late_goals": averaged.pushed(x.late_goals, goal)}
        mean = named("mean_row", (row + averaged.total(x.late_rows)) / number)
        return mean, named("mean_goal", (goal + averaged.total(x.late_goals)) / number), late

    @staticmethod
    def lines(kept: Mapping[str, SX], row: SX, goal: SX) -> tuple[DelayLine, ...]:
        """The delay lines of the stored rows, of which `row` and `goal` are the newest."""
        late = (("late_rows", row), ("late_goals", goal))
        return tuple(DelayLine(name, newest.T) for name, newest in late if name in kept)
