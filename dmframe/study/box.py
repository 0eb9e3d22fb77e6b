"""Box of all values that a study samples: intervals of parameters and initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.certify.begun import START
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal
from dmframe.study.design import Spread
from dmframe.study.varied import SETTINGS, Factor

COVERAGE: Final = 0.99
"""Probability of the box if some distribution is unbounded."""

Ends = tuple[np.ndarray, np.ndarray]


@final
@dataclass(frozen=True, eq=False)
class Box:
    """Intervals of all parameters and initial states that a study samples.

    Parameters
    ----------
    ends
        By ``block.parameter`` and ``start.block.state``, lower and upper bounds in its own shape.
    probability
        Probability that a sample lies in the box; 1 if all distributions are bounded.
    units
        Units of the parameters and initial states.
    outside
        Sampled columns that do not appear in any proof: a clock, the step of the solver.
    unknown
        Sampled labels without an interval, since each value changes the equations of the loop.
    """

    ends: Mapping[str, Ends]
    units: Mapping[str, str]
    probability: float
    outside: tuple[str, ...]
    unknown: tuple[str, ...] = ()

    @property
    def intervals(self) -> dict[str, list[Interval]]:
        """Exact intervals of the decimal numbers, as for `dmframe.certify.verify`."""
        return {
            label: [Interval(decimal(float(a)), decimal(float(b))) for a, b in zip(*map(_column, ends), strict=True)]
            for label, ends in self.ends.items()
        }


def hull(
    first: Mapping[str, Sequence[Interval]], second: Mapping[str, Sequence[Interval]]
) -> dict[str, Sequence[Interval]]:
    """Intervals that contain both, where a label has two."""
    found = {**first}
    for label, given in second.items():
        pairs = zip(found.get(label, given), given, strict=True)
        found[label] = [Interval(min(a.lower, b.lower), max(a.upper, b.upper)) for a, b in pairs]
    return found


def _column(values: np.ndarray) -> np.ndarray:
    return values.ravel(order="F")


def box_of(diagram: Diagram, factors: Sequence[Factor], start: Mapping[str, Any] | None = None) -> Box:
    """The box of the values that factors give to a loop's parameters and initial states.

    The bounds are computed with the same operations as the values of the runs; rounding is monotonic, so that no run
    lies outside. `start` is the graph's key of that name.
    """
    own, given = _own(diagram, start or {}), start or {}
    ends, outside, unknown = dict[str, Ends](), list[str](), list[str]()
    drawn = [(factor, factor.spread) for factor in factors if factor.spread is not None]
    endless = sum(len(factor.columns) for factor, spread in drawn if not has_bounds(spread))
    # independent draws: the probabilities of the intervals multiply
    each = COVERAGE ** (1 / endless) if endless else 1.0
    for factor, spread in drawn:
        ranges = [_reach(own, each) for own in factor.each or [spread]]
        low, high = np.array(ranges).T if factor.each else ranges[0]
        for written in factor.labels:
            label = label_of(diagram, written, given)
            if label in own:
                ends[label] = _moved(factor.how, ends.get(label, (own[label], own[label])), low, high)
            elif label or written not in SETTINGS:
                unknown.append(written)
            else:
                outside += factor.columns
    # without variation the graph's own value applies
    ends = {label: pair for label, pair in ends.items() if not all(np.array_equal(end, own[label]) for end in pair)}
    units = {parameter.label: parameter.unit for parameter in diagram.loop.parameters if parameter.label in ends}
    units |= {f"{START}{v.label}": v.unit for v in diagram.loop.variables if f"{START}{v.label}" in ends}
    return Box(ends, units, COVERAGE if endless else 1.0, tuple(dict.fromkeys(outside)), tuple(dict.fromkeys(unknown)))


def label_of(diagram: Diagram, written: str, given: Mapping[str, Any]) -> str:
    """Label of a study's quantity in a proof: a parameter of the loop, ``start.block.state``, or empty.

    A block's parameter may be the initial value of a state; the graph's key `start` takes precedence over it.
    """
    loop = diagram.loop
    if any(parameter.label == written for parameter in loop.parameters):
        return written
    if written.startswith(START):
        key = written.removeprefix(START)
        found = [v.label for v in loop.variables if v.label == key]
        found += [v.label for v in (*loop.plant, *loop.controller) if v.name == key]
        return f"{START}{found[0]}" if found else ""
    block, _, name = written.partition(".")
    state = next((v.label for v in loop.variables if v.label == written), None)
    if state is None or block not in diagram.models or name not in diagram.models[block].values:
        return ""
    return "" if {state, name} & given.keys() else f"{START}{state}"


def _own(diagram: Diagram, start: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The graph's own parameters and initial states."""
    found = {item.label: np.asarray(item.value, dtype=float) for item in diagram.loop.parameters}
    for variable in diagram.loop.variables:
        size = variable.symbol.numel()
        value = start.get(variable.label, start.get(variable.name))
        if value is None:
            value = diagram.models[variable.block].values.get(variable.name, 0.0)
        array = np.asarray(value, dtype=float)
        column = np.broadcast_to(array.ravel(order="F") if array.size > 1 else array.ravel(), (size,))
        found[f"{START}{variable.label}"] = column
    return found


def _moved(how: str, own: Ends, low: Any, high: Any) -> Ends:
    below, above = own
    if how == "scale":
        products = np.stack([low * below, low * above, high * below, high * above])
        return products.min(axis=0), products.max(axis=0)
    if how == "shift":
        return below + low, above + high
    return np.full_like(below, low), np.full_like(below, high)


def has_bounds(spread: Spread) -> bool:
    """True for a bounded distribution."""
    return bool(np.isfinite(spread.lower) and np.isfinite(spread.upper))


def _reach(spread: Spread, probability: float) -> tuple[float, float]:
    """Bounds of a distribution; for an unbounded one, its central interval of a probability."""
    if has_bounds(spread):
        return spread.lower, spread.upper
    low, high = spread.at(np.array([(1 - probability) / 2, (1 + probability) / 2])).tolist()
    return low, high
