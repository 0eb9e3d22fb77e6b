"""Times and rates of a graph that are implausible, as after a forgotten unit: ``clock: 8`` is 8 s, not 8 ms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from dmframe.block.parameter import specs
from dmframe.block.port import Side
from dmframe.common.units import plain
from dmframe.config.graph import BaseGraph

CLOCK: Final = (5e-5, 0.5)
"""Plausible sampling periods [s]; those of robot controllers are 0.1 ms to 100 ms."""
LONGEST: Final = 60.0
"""Longest plausible time of a block's parameter [s]."""
DURATION: Final = 2 * 86400.0
"""Longest plausible simulated time [s]."""
UNSTABLE: Final = 2.0
"""Product of a rate and the sampling period from which on x - T k x overshoots by more than x."""


def doubt_of_period(period: float, key: str = "") -> str:
    """The sampling period [s] with the plausible range, and what was probably meant; empty for a plausible one."""
    least, most = CLOCK
    if least <= period <= most:
        return ""
    meant = f"; for {period:g} ms write `{key}{period:g} ms`" if least <= period / 1000 <= most else ""
    return f"{plain(period, 's')}, expected {plain(least, 's')} to {plain(most, 's')}{meant}"


def implausible(graph: BaseGraph) -> tuple[str, ...]:
    """Remarks on times and rates of the graph outside of plausible ranges, each with its range."""
    clock, found = graph.clock, list[str]()
    if clock is not None and (doubt := doubt_of_period(clock, "clock: ")):
        found.append(f"clock is {doubt}")
        clock = None  # its products would repeat the remark
    if graph.duration > DURATION:
        found.append(f"duration is {plain(graph.duration, 's')}, {graph.duration / 86400:.3g} days")
    return (*found, *_of_blocks(graph, clock))


def _of_blocks(graph: BaseGraph, clock: float | None) -> Iterator[str]:
    for name, block in graph.blocks.items():
        for key, spec in specs(type(block)).items():
            largest = _largest(getattr(block, key)) if spec.form in ("diagonal", "gain") else None
            if largest is None:
                continue
            label = f"{name}.{key}"
            if spec.unit == "s" and largest > LONGEST:
                meant = f"; for {largest:g} ms write `{largest:g} ms`"
                yield f"{label} is {plain(largest, 's')}, expected at most {plain(LONGEST, 's')}{meant}"
            rate = spec.unit in ("1/s", "rad/s") and block.side is not Side.PLANT
            if rate and clock is not None and largest * clock > UNSTABLE:
                yield (
                    f"{label} is {plain(largest, spec.unit)}, {largest * clock:.3g} in a sample of {plain(clock, 's')}"
                    f"; expected at most {plain(UNSTABLE / clock, spec.unit)}"
                )


def _largest(value: Any) -> float | None:
    """Largest absolute element of a number or of numbers; None for others."""
    try:
        numbers = np.abs(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        return None
    return float(numbers.max()) if value is not None and numbers.size else None
