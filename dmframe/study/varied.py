"""Varied quantities: factors bound to the parameters of a graph, with units, and their values in each run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from dmframe.block.gain import Prior
from dmframe.block.parameter import PAIRS, specs
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.common.units import plain, to_unit
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.study.design import Spread, columns_of
from dmframe.study.grammar import Distribution, Variation, is_user_name

How = Literal["value", "scale", "shift"]
START: Final = "start."
SETTINGS: Final[Mapping[str, tuple[str, str]]] = {
    "clock": ("s", "> 0"),
    "jitter": ("s", ">= 0"),
    "solver.step": ("s", "> 0"),
    "robot.friction_velocity": ("rad/s", "> 0"),
}
"""Numbers of a graph outside of its blocks: units and signs. Each value needs a run of its own."""


@final
@dataclass(frozen=True)
class Target:
    """A parameter of one graph that may vary.

    Parameters
    ----------
    value
        The graph's value, in the parameter's unit; None if the graph does not set it.
    shape
        Shape as of a port; empty for one number.
    spreads
        True if one number may replace all elements.
    """

    label: str
    unit: str
    sign: str
    value: np.ndarray | None
    shape: str
    spreads: bool = True


def target(label: str, graph: Graph, diagram: Callable[[], Diagram]) -> Target:
    """A parameter by its label.

    Raises
    ------
    UnknownNameError, ValueFault
        There is no such parameter, or it cannot be sampled.
    """
    if label in SETTINGS:
        unit, sign = SETTINGS[label]
        return Target(label, unit, sign, value_in(label, graph), "")
    if label.startswith(START):
        return _start(label, graph, diagram())
    known = {
        f"{name}.{key}": (block, key, spec)
        for name, block in graph.blocks.items()
        for key, spec in specs(type(block)).items()
    }
    if label not in known:
        choices = [name for name, (_, _, spec) in known.items() if spec.form not in PAIRS]
        raise UnknownNameError(label, "parameter", label, [*choices, *SETTINGS])
    block, key, spec = known[label]
    value = getattr(block, key)
    if spec.form in PAIRS:
        raise ValueFault(f"{label}: {PAIRS[spec.form]} cannot be sampled; list values of it under grid")
    if isinstance(value, Prior):
        raise ValueFault(
            f"{label}: the graph derives it from {value.inverse_of}; list values under grid, or set a number first"
        )
    spreads = spec.form in ("diagonal", "gain")
    return Target(label, spec.unit, spec.sign, value_in(label, graph), spec.shape, spreads)


def value_in(label: str, graph: Graph) -> np.ndarray | None:
    """The graph's own value of a quantity; None if it states no number."""
    value: Any = graph.file
    if label in SETTINGS:
        for key in label.split("."):
            value = getattr(value, key, None)
    elif label.startswith(START):
        value = graph.start.get(label.removeprefix(START))
    else:
        block, _, key = label.partition(".")
        value = getattr(graph.blocks.get(block), key, None)
    return None if value is None or isinstance(value, Prior) else np.asarray(value, dtype=float)


def _start(label: str, graph: Graph, diagram: Diagram) -> Target:
    key = label.removeprefix(START)
    variables = diagram.loop.variables
    found = next((each for each in variables if key in (each.label, each.name)), None)
    if found is None:
        choices = [f"{START}{each.label}" for each in variables]
        raise UnknownNameError(label, "state", label, [*choices, *(f"{START}{each.name}" for each in variables)])
    return Target(label, found.unit, "", value_in(label, graph), f"{found.symbol.numel()}")


@final
@dataclass(frozen=True)
class Factor:
    """A varied quantity, bound to parameters of a graph.

    Parameters
    ----------
    name
        Name of the column: the parameter, or a name of the user's choice.
    labels
        Labels of the changed parameters.
    how
        A drawn number is the parameter's value, a factor of the graph's own value, or a difference from it.
    spread
        Distribution; None if a grid lists its values. If `each` is given, one that contains all of them.
    elements
        Number of draws, one per element of the parameter; None for one draw for all elements.
    unit
        Unit of the drawn numbers.
    each
        Distributions of the elements if they differ.
    """

    name: str
    labels: tuple[str, ...]
    how: How
    spread: Spread | None
    elements: int | None
    unit: str
    each: tuple[Spread, ...] = ()

    @property
    def columns(self) -> Sequence[str]:
        """Columns of the table: one, or one per element."""
        return columns_of(self.name, self.elements)

    @property
    def spreads(self) -> Sequence[Spread]:
        """Distributions of the columns; none for a grid's."""
        return self.each or [self.spread for _ in self.columns if self.spread is not None]

    def put(self, values: dict[str, np.ndarray], drawn: np.ndarray, graph: Graph) -> None:
        """Apply (N, columns) drawn numbers to `values`, rows by label; missing labels start from the graph's values."""
        for label in self.labels:
            of_block = label not in SETTINGS and not label.startswith(START)
            if of_block and label.partition(".")[0] not in graph.blocks:
                raise ValueFault(f"{label}: expected that block in the graph {graph.name}, found none")
            rows = drawn if self.elements is not None else drawn[:, 0]
            if self.how == "value":
                values[label] = _filled(rows, label, graph) if of_block and self.elements is None else rows
                continue
            own = values[label] if label in values else _own(label, graph)[None]
            if self.elements is None:
                rows = rows.reshape(-1, *(1 for _ in own.shape[1:]))
            elif own.ndim == 1:
                own = own[:, None]
            values[label] = rows * own if self.how == "scale" else rows + own


def _own(label: str, graph: Graph) -> np.ndarray:
    found = value_in(label, graph)
    if found is None:
        raise ValueFault(f"{label}: expected a number in the graph {graph.name}, found none")
    return found


def _filled(rows: np.ndarray, label: str, graph: Graph) -> np.ndarray:
    """One number per run, repeated for a parameter that needs all its elements."""
    block, _, key = label.partition(".")
    if specs(type(graph.blocks[block]))[key].form != "vector":
        return rows
    return np.repeat(rows[:, None], _own(label, graph).size, axis=1)


def factor(name: str, variation: Variation, graph: Graph, diagram: Callable[[], Diagram]) -> Factor:
    """A variation of the study file, bound to a graph.

    Raises
    ------
    DmframeError
        An unknown parameter, a wrong unit, a distribution that violates the parameter's sign.
    """
    labels = variation.of or (name,)
    if is_user_name(name) and name not in SETTINGS and not variation.of:
        raise ValueFault(f"expected block.parameter, or {name}: {{..., of: [block.parameter, ...]}}")
    targets = list[Target]()
    for label in labels:
        try:
            targets.append(target(label, graph, diagram))
        except DmframeError as error:
            for fault in error.faults:
                fault.path = ("of",) if variation.of else ()
            raise
    kind = variation.kinds[0]
    how: How = "scale" if kind == "scale" else "shift" if kind == "shift" else "value"
    drawn = getattr(variation, kind) if how != "value" else variation
    unit = "" if how == "scale" else _unit(targets)
    spread = spread_of(drawn, unit, (kind,) if how != "value" else ())
    for each in targets:
        _check_target(each, how, spread)
    elements, separate = _elements(name, variation, targets, diagram), each_of(drawn, unit)
    if separate and len(separate) != elements:
        own = "no key per: element" if elements is None else f"{elements} elements"
        raise ValueFault(f"expected bounds for each element, found {len(separate)}, and {own}", path=(kind,))
    return Factor(name, labels, how, spread, elements, unit, separate)


def _unit(targets: Sequence[Target]) -> str:
    units = {each.unit for each in targets}
    if len(units) > 1:
        found = ", ".join(f"{each.label} [{each.unit}]" for each in targets)
        raise ValueFault(f"expected parameters of one unit, found {found}; scale them, or let each vary by itself")
    return units.pop()


def each_of(given: Distribution, unit: str) -> tuple[Spread, ...]:
    """Distributions of a parameter's elements if the file gives bounds for each; an element may have equal ones."""
    if given.uniform is None or not isinstance(given.uniform[0], tuple):
        return ()
    ends = [[to_unit(value, unit) for value in side] for side in given.uniform if isinstance(side, tuple)]
    for low, high in zip(*ends, strict=True):
        if not low <= high:
            text = f"uniform: expected two bounds, the lower one first, found {low:g} and {high:g}"
            raise ValueFault(text, path=("uniform",))
    return tuple(Spread("uniform", low, high, low, high) for low, high in zip(*ends, strict=True))


def spread_of(given: Distribution, unit: str, path: tuple[str, ...] = ()) -> Spread:
    """A distribution of the file in a unit. Raises `UnitError` and `ValueFault`, at `path` below the variation."""
    kind = next(kind for kind in ("uniform", "log", "normal") if getattr(given, kind) is not None)

    def pair(key: str) -> tuple[float, float]:
        try:
            first, second = (to_unit(value, unit) for value in getattr(given, key))
        except DmframeError as error:
            error.path = (*path, key)
            error.text = f"{key}: {error.text}"
            raise
        return first, second

    def refuse(key: str, expected: str) -> ValueFault:
        return ValueFault(f"{key}: {expected}", path=(*path, key))

    if each := each_of(given, unit):
        if not any(own.a < own.b for own in each):
            raise refuse(kind, "expected bounds of which at least one pair differs")
        low, high = min(own.a for own in each), max(own.b for own in each)
        return Spread("uniform", low, high, low, high)
    a, b = pair(kind)
    if kind == "normal":
        if not b > 0:
            raise refuse(kind, f"expected a standard deviation above zero, found {plain(b, unit)}")
        lower, upper = pair("clip") if given.clip is not None else (-math.inf, math.inf)
        if not lower < upper:
            raise refuse("clip", f"expected two bounds, the lower one first, found {lower:g} and {upper:g}")
        return Spread("normal", a, b, lower, upper)
    if not a < b:
        raise refuse(kind, f"expected two bounds, the lower one first, found {a:g} and {b:g}")
    if kind == "log" and not a > 0:
        raise refuse(kind, f"expected bounds above zero, found {plain(a, unit)}")
    return Spread("log" if kind == "log" else "uniform", a, b, a, b)


def _check_target(found: Target, how: How, spread: Spread) -> None:
    """Raise `ValueFault` for a distribution that can violate the parameter's sign or form."""
    if how == "value" and (found.value is not None and found.value.ndim > 1):
        raise ValueFault(f"{found.label}: the graph has rows of numbers there; scale them, or list values under grid")
    if how == "value" and not found.spreads and found.value is None:
        raise ValueFault(f"{found.label}: expected numbers in the graph, to know how many it takes; found none")
    own = found.value
    if how != "value" and own is None:
        raise ValueFault(f"{found.label}: expected a number in the graph, which {how} changes; found none")
    if not found.sign:
        return
    least = spread.lower
    if how == "shift" and own is not None:
        least = float(own.min()) + spread.lower
    if least > 0 or (least == 0 and found.sign == ">= 0"):
        return
    unit = "" if how == "scale" else found.unit
    bound = "without a lower bound" if math.isinf(least) else f"down to {plain(least, unit)}"
    what = "its factor" if how == "scale" else "it"
    remedy = "; clip: [lower, upper] sets bounds" if spread.kind == "normal" else ""
    raise ValueFault(f"{found.label} is {found.sign}, and {what} is drawn {bound}{remedy}")


def _elements(name: str, variation: Variation, targets: Sequence[Target], diagram: Callable[[], Diagram]) -> int | None:
    if variation.per is None:
        return None
    counts = set[int]()
    for each in targets:
        if variation.per == "joint" and each.shape != "n" and not each.label.startswith(START):
            raise ValueFault(f"per: {each.label} has no value per joint; use per: element", path=("per",))
        if not each.shape or (each.value is not None and each.value.ndim > 1):
            raise ValueFault(f"per: {each.label} has no independent elements; omit per", path=("per",))
        counts.add(_count(each, diagram))
    if len(counts) > 1:
        found = ", ".join(f"{each.label} {_count(each, diagram)}" for each in targets)
        raise ValueFault(f"expected parameters of one size, found {found}", path=("of",))
    return counts.pop()


def _count(each: Target, diagram: Callable[[], Diagram]) -> int:
    if each.label.startswith(START):
        return int(each.shape)
    if each.value is not None and each.value.ndim == 1:
        return each.value.size
    block, _, key = each.label.partition(".")
    values = diagram().models[block].values
    return int(np.shape(values[key])[0])


def factors_of(
    section: str, variations: Mapping[str, Variation], graph: Graph, diagram: Callable[[], Diagram]
) -> tuple[list[Factor], list[DmframeError]]:
    """The variations of a section of the study file, bound to a graph, and their faults."""
    found, faults = list[Factor](), list[DmframeError]()
    for name, variation in variations.items():
        try:
            found.append(factor(name, variation, graph, diagram))
        except DmframeError as error:
            for fault in error.faults:
                fault.path = fault.path if fault.location else (section, name, *fault.path)
                fault.text = f"{section}.{name}: {fault.text.removeprefix(f'{name}: ')}"
                faults.append(fault)
            continue
        if found[-1].each and section == "tune":
            text = f"{section}.{name}: expected two bounds for all elements, found lists"
            faults.append(ValueFault(text, path=(section, name)))
    return found, faults


def set_twice(factors: Iterable[Factor], fixed: Iterable[str]) -> list[ValueFault]:
    """Faults of parameters whose value is set by two quantities."""
    seen, faults = dict.fromkeys(fixed, "grid"), list[ValueFault]()
    for each in factors:
        for label in each.labels:
            if each.how == "value" and label in seen:
                text = f"sample.{each.name}: {label} has its value from {seen[label]} already; keep one of them"
                faults.append(ValueFault(text, path=("sample", each.name)))
            seen.setdefault(label, each.name)
    return faults
