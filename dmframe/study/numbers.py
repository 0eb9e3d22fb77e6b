"""Numbers in a study's page; limits are rounded conservatively."""

from __future__ import annotations

import math
from typing import Final

from dmframe.common.units import plain
from dmframe.study.statistics import Proportion, Quantile
from dmframe.study.varied import Factor

ALMOST: Final = 0.999999
"""Largest proportion that is printed with more digits."""


def count(number: int) -> str:
    """``10 000``."""
    return f"{number:,}".replace(",", " ")


def percent(proportion: float, up: bool | None = None) -> str:
    """Percentage with two digits, rounded up or down if it is a limit; near 1, two digits of its difference from 1."""
    if not math.isfinite(proportion):
        return "-"
    if proportion > ALMOST:
        return "100 %" if up or proportion >= 1 else "99.9999 %"
    if proportion > 0.99:
        return f"{100 - _two(100 * (1 - proportion), None if up is None else not up):.10g} %"
    return f"{_two(100 * proportion, up):.10g} %"


def _two(value: float, up: bool | None) -> float:
    """Two significant digits."""
    if value <= 0:
        return 0.0
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    scaled = value / power
    # 3.0000000000000004 is 3
    rounded = round(scaled) if up is None else math.ceil(scaled - 1e-9) if up else math.floor(scaled + 1e-9)
    return float(f"{rounded * power:.12g}")


def interval(proportion: Proportion) -> str:
    """Two-sided interval of a proportion; empty without one."""
    if proportion.low is None or proportion.high is None:
        return ""
    return f"{percent(proportion.low, up=False)} to {percent(proportion.high, up=True)}"


def figure(value: float, unit: str) -> str:
    """A figure of a run; ``diverged`` if infinite."""
    if math.isinf(value):
        return "diverged"
    return "-" if math.isnan(value) else plain(value, unit)


def between(found: Quantile, unit: str) -> str:
    """Interval of a quantile; empty without one."""
    if found.low is None or found.high is None or found.low == math.inf:
        return ""
    low = "no lower limit" if found.low == -math.inf else figure(found.low, unit)
    high = "no upper limit" if found.high == math.inf and math.isfinite(found.value) else figure(found.high, unit)
    return f"{low} to {high}"


def chance(p: float | None) -> str:
    """Probability of a test."""
    if p is None:
        return ""
    return "below 1e-6" if p < 1e-6 else f"{p:.2g}"


def span(low: float, high: float, unit: str) -> str:
    """``400 to 1600 V s/rad``."""
    return f"{low:.5g} to {high:.5g} {unit}".rstrip()


def distribution(factor: Factor, element: int = 0) -> str:
    """Distribution of a sampled or searched quantity as text; with bounds of its own for each, of an element."""
    spread, unit = factor.each[element] if factor.each else factor.spread, factor.unit
    if spread is None:
        return ""
    what = {"value": "", "scale": "times the graph's own value, ", "shift": "added to the graph's own value, "}
    ends = span(spread.lower, spread.upper, unit)
    if spread.kind == "normal":
        bounded = math.isfinite(spread.lower) or math.isfinite(spread.upper)
        clip = f", between {ends.replace(' to ', ' and ')}" if bounded else ""
        text = f"normal, mean {plain(spread.a, unit, 5)}, standard deviation {plain(spread.b, unit, 5)}{clip}"
    else:
        text = f"{ends}, {'uniform' if spread.kind == 'uniform' else 'log-uniform'}"
    of = f"; of {', '.join(factor.labels)}" if factor.labels != (factor.name,) else ""
    return f"{what[factor.how]}{text}{of}"
