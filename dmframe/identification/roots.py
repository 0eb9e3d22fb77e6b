r"""The second cascade with the same motion: feed-forward and viscous friction have it in common.

With the gains p and i, the feed-forward f, the inverse velocity gain w and the viscous friction B, the motion depends
on F = f/w, A = (p + f i)/w, b = (p + i)/w, C = p i/w and V = 1/w + B alone. With s = 1 - f and D = b - A they give

.. math::

    (D b + C F) s^2 - D (D + b) s + D^2 = 0,

so that two cascades have the same motion; their viscous frictions differ.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dmframe.identification.model import Array
from dmframe.identification.unknowns import VISCOUS, Unknowns

LEAST: Final = 0.02
"""Least feed-forward of a cascade that has a second one."""
SCALED: Final = ("D", "S", "offset")
"""Unknowns that are torques times w."""


def second(unknowns: Unknowns, theta: Array) -> Array:
    """The unknowns of the second cascade of each joint; NaN for a joint without one with positive gains."""
    at, found = unknowns.places, theta.copy()
    p, i, f, w = np.exp(theta[at["k_p"]]), np.exp(theta[at["k_i"]]), theta[at["f"]], np.exp(theta[at["w"]])
    with np.errstate(all="ignore"):
        F, b, C, D = f / w, (p + i) / w, p * i / w, i * (1 - f) / w
        s = D**2 / ((D * b + C * F) * (1 - f))  # the product of both roots is D^2 / (D b + C F)
        other = (1 - s) / F
        own = {"k_p": np.log(other * (b - D / s)), "k_i": np.log(other * D / s), "f": 1 - s, "w": np.log(other)}
        own["B"] = other * ((1 + theta[at["B"]]) / w) - 1
        own |= {name: theta[at[name]] * other / w for name in SCALED}
        missing = (f < LEAST) | (1 - s < LEAST) | ~np.all([np.isfinite(values) for values in own.values()], axis=0)
    for name, values in own.items():
        found[at[name]] = np.where(missing, np.nan, values)
    return found


def with_friction(unknowns: Unknowns, theta: Array, deviation: Array) -> Array:
    """The unknowns with the second cascade where the first one has a negative viscous friction and is less likely.

    `deviation` is the standard deviation of w B of each joint, with which a negative value is an error of the fit; that
    of a value before the log is seen is `VISCOUS`.
    """
    at, other, found = unknowns.places, second(unknowns, theta), theta.copy()
    own, its = theta[at["B"]], other[at["B"]]
    better = (own < 0) & (its > own) & (np.abs(own) / deviation > np.abs(its) / VISCOUS)
    for name in ("k_p", "k_i", "f", "w", "B", *SCALED):
        found[at[name]] = np.where(better, other[at[name]], theta[at[name]])
    return found
