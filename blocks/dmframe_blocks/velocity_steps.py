"""Reference velocity that changes in steps or ramps."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    TIME,
    AbstractBlock,
    Diagonal,
    Equations,
    Output,
    Positive,
    Real,
    Rows,
    Side,
    Signals,
    Table,
    Vector,
    operation,
)

EARLY: Final = 1 + 1e-9
"""Factor of the time, so that rounding does not move a step to the next sample."""


@final
class VelocitySteps(AbstractBlock):
    """Reference velocity of the joints that is constant between given times: an excitation for identification.

    Before the first time it is zero; from each time on it is the row of `speeds` of that time. With `ramp`, each
    change begins at its time and takes that long, with a constant acceleration.

    With ramps the positions are those with steps, averaged over the last `ramp`. So they stay in the same box.

    Parameters
    ----------
    times : list, s
        Increasing times of the changes.
    speeds : one row a time, (n,), rad/s
        Velocity from each time on.
    ramp : diagonal (n,), s, > 0
        Duration of a change; by default the changes are steps.

    Notes
    -----
    Not for: a path, since it does not read positions. `dmframe experiment` writes a graph with it, inside the limits.

    References
    ----------
    [Ljung1999]_, on exciting signals.
    """

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("dq_r", "n", "rad/s"),)

    times: Vector = Real("*", "s", spread=False)
    speeds: Table = Rows("n", "rad/s")
    ramp: Diagonal | None = Positive("n", "s", default=None)

    @model_validator(mode="after")
    def _one_row_a_time(self) -> VelocitySteps:
        if len(self.speeds) != len(self.times):
            raise ValueError(f"expected as many speeds as times, found {len(self.speeds)} and {len(self.times)}")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            raise ValueError("expected increasing times")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """A sum of the changes."""
        rows, times = ca.vertsplit(p.speeds), ca.vertsplit(p.times)
        total, before = 0, 0 * rows[0]
        for row, begins in zip(rows, times, strict=True):
            done = completed(u.t, begins, p.ramp) if "ramp" in p else EARLY * u.t >= begins
            total = total + (row - before).T * done
            before = row
        return Equations(outputs={"dq_r": total})


@operation
def completed(t: Any, begins: Any, ramp: Any) -> Any:
    """The completed fraction of a change that begins at the time `begins` and takes `ramp`."""
    return ca.fmin(ca.fmax((t - begins) / ramp, 0), 1)
