"""All values that a study draws, as intervals of parameters and of starts."""

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

HELD: Final = 0.99
"""Probability of the box, where what is drawn has no ends."""

Ends = tuple[np.ndarray, np.ndarray]


@final
@dataclass(frozen=True, eq=False)
class Box:
    """All values that parameters and starts take in a study.

    Parameters
    ----------
    ends
        By ``block.parameter``, and ``start.block.state``, its lower and its upper ends, in its own shape.
    held
        The probability that a sample lies in it; 1 where everything that is drawn has ends.
    units
        Of the parameters and starts.
    outside
        Columns that are drawn and that no proof reads: a clock, the step of the solver.
    unknown
        Labels that are drawn and have no interval, since another number makes another loop.
    """

    ends: Mapping[str, Ends]
    units: Mapping[str, str]
    held: float
    outside: tuple[str, ...]
    unknown: tuple[str, ...] = ()

    @property
    def intervals(self) -> dict[str, list[Interval]]:
        """As `dmframe.certify.verify` takes them: exact, of the decimals that a graph would state."""
        return {
            label: [Interval(decimal(float(a)), decimal(float(b))) for a, b in zip(*map(_column, ends), strict=True)]
            for label, ends in self.ends.items()
        }


def _column(values: np.ndarray) -> np.ndarray:
    return values.ravel(order="F")


def box_of(diagram: Diagram, factors: Sequence[Factor], start: Mapping[str, Any] | None = None) -> Box:
    """The box of what factors do to a loop's parameters and starts.

    The ends are computed as the runs compute their values, and rounding never turns an order round: no run lies
    outside. `start` is the graph's key of that name.
    """
    own, given = _own(diagram, start or {}), start or {}
    ends, outside, unknown = dict[str, Ends](), list[str](), list[str]()
    drawn = [(factor, factor.spread) for factor in factors if factor.spread is not None]
    endless = sum(len(factor.columns) for factor, spread in drawn if not _has_ends(spread))
    # draws are independent, so that the probabilities of boxes multiply
    each = HELD ** (1 / endless) if endless else 1.0
    for factor, spread in drawn:
        low, high = _reach(spread, each)
        for written in factor.labels:
            label = label_of(diagram, written, given)
            if label in own:
                ends[label] = _moved(factor.how, ends.get(label, (own[label], own[label])), low, high)
            elif label or written not in SETTINGS:
                unknown.append(written)
            else:
                outside += factor.columns
    # a factor of zero: nothing varies, and what the graph lacks stays absent
    ends = {label: pair for label, pair in ends.items() if not all(np.array_equal(end, own[label]) for end in pair)}
    units = {parameter.label: parameter.unit for parameter in diagram.loop.parameters if parameter.label in ends}
    units |= {f"{START}{v.label}": v.unit for v in diagram.loop.variables if f"{START}{v.label}" in ends}
    return Box(ends, units, HELD if endless else 1.0, tuple(dict.fromkeys(outside)), tuple(dict.fromkeys(unknown)))


def label_of(diagram: Diagram, written: str, given: Mapping[str, Any]) -> str:
    """What a study's label is to a proof: a parameter of the loop, ``start.block.state``, or nothing.

    A block's parameter may be where a state starts; a graph's key `start`, which goes before it, then decides.
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
    """The graph's own numbers, of parameters and of starts."""
    found = {item.label: np.asarray(item.value, dtype=float) for item in diagram.loop.parameters}
    for variable in diagram.loop.variables:
        size = variable.symbol.numel()
        held = start.get(variable.label, start.get(variable.name))
        if held is None:
            held = diagram.models[variable.block].values.get(variable.name, 0.0)
        array = np.asarray(held, dtype=float)
        column = np.broadcast_to(array.ravel(order="F") if array.size > 1 else array.ravel(), (size,))
        found[f"{START}{variable.label}"] = column
    return found


def _moved(how: str, own: Ends, low: float, high: float) -> Ends:
    below, above = own
    if how == "scale":
        products = np.stack([low * below, low * above, high * below, high * above])
        return products.min(axis=0), products.max(axis=0)
    if how == "shift":
        return below + low, above + high
    return np.full_like(below, low), np.full_like(below, high)


def _has_ends(spread: Spread) -> bool:
    return bool(np.isfinite(spread.lower) and np.isfinite(spread.upper))


def _reach(spread: Spread, probability: float) -> tuple[float, float]:
    """The ends of a distribution; of one without, those between which so much of it lies, as much beyond each."""
    if _has_ends(spread):
        return spread.lower, spread.upper
    low, high = spread.at(np.array([(1 - probability) / 2, (1 + probability) / 2])).tolist()
    return low, high
