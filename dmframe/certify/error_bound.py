"""Bounds on tracking errors, as part of a verdict; `dmframe.bounds` computes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final

from dmframe.common.text import Text

Kind = Literal["rms", "sup"]

LARGE: Final = 1.0
"""Bounds from here on are as large as the robot [rad or m]."""


@final
@dataclass(frozen=True)
class Share:
    """The largest contribution to a bound: a term of V at the start, or the disturbance.

    `lowered_by`: parameters of the controller that would lower it, such as ``a larger inverse.Lambda_I``.
    """

    of: Text
    lowered_by: tuple[str, ...] = ()
    of_start: bool = True


@final
@dataclass(frozen=True)
class ErrorBound:
    """Bound on the norm of an error over a run, from the start to `over_s`.

    Parameters
    ----------
    signal
        The error.
    kind
        ``rms``: root of the mean square over the run; ``sup``: largest value in the run.
    value, unit
        The bound.
    disturbance
        Bound on the torque at each joint [N m].
    dominated_by
        The largest contribution.
    holds
        The motion that it refers to.
    moved
        Error of a robot that stands still at the start of its path, at most; None where it is not known.
    """

    signal: Text
    kind: Kind
    over_s: float
    value: float
    unit: str
    disturbance: tuple[float, ...]
    dominated_by: Share
    holds: Literal["continuous time", "samples", "data"] = "continuous time"
    moved: float | None = None

    @property
    def useful(self) -> bool:
        """False for a bound that a robot that stands still meets, or one from `LARGE` on."""
        return self.value < (LARGE if not self.moved else min(LARGE, self.moved))


@final
@dataclass(frozen=True)
class ErrorBounds:
    """The bounds of a loop, and the reasons why it has no others."""

    found: tuple[ErrorBound, ...] = ()
    missing: tuple[str, ...] = ()
