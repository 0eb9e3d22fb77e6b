"""Decisions about V along the runs of a graph that are independent of the samples; `dmframe.remembered` caches them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class StorageUnit:
    """Units in V; angles are dimensionless, as in SI.

    Parameters
    ----------
    unit, rate
        Units of V and of dV/dt; empty if no block's unit was derived or V adds terms of several units.
    parts
        Unit of each block's storage function, if derived, before the multiplication by kappa.
    several
        Units of terms that V adds with the same weight, if there are several: the unit weights then carry units.
    """

    unit: str
    rate: str
    parts: Mapping[str, str]
    several: tuple[str, ...] = ()

    @property
    def about(self) -> str:
        """Note on a V without a common unit."""
        return f"its terms are in {' and '.join(self.several)}, each counted in SI's units" if self.several else ""


@final
@dataclass(frozen=True)
class Decided:
    """Decisions from the claim of a graph about V along its runs.

    Parameters
    ----------
    reason
        Reason why there is no V; empty if there is one.
    kappa
        The weight of the servo level.
    assumed
        True if the claim assumes positive weights, which each run has to confirm.
    names
        Names of V's terms, for a figure.
    unit
        Unit of V; None without V.
    """

    reason: str = ""
    kappa: float = 1.0
    assumed: bool = False
    names: tuple[str, ...] = ()
    unit: StorageUnit | None = None

    @property
    def data(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self)

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> Decided:
        """The inverse of `data`."""
        unit = data["unit"]
        made = None if unit is None else StorageUnit(**{**unit, "several": tuple(unit["several"])})
        return cls(**{**data, "names": tuple(data["names"]), "unit": made})
