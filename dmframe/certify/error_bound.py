"""Bounds on tracking errors, as part of a verdict; `dmframe.bounds` computes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

from dmframe.common.text import Text

Kind = Literal["rms", "sup"]


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
    """

    signal: Text
    kind: Kind
    over_s: float
    value: float
    unit: str
    disturbance: tuple[float, ...]
    dominated_by: Share
    holds: Literal["continuous time", "samples", "data"] = "continuous time"


@final
@dataclass(frozen=True)
class ErrorBounds:
    """The bounds of a loop, and the reasons why it has no others."""

    found: tuple[ErrorBound, ...] = ()
    missing: tuple[str, ...] = ()
