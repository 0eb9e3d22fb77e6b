"""Sliders of a live page: parameters that can be changed without a new diagram."""

from __future__ import annotations

from collections.abc import Callable, Collection, Set
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import numpy as np

from dmframe.block.parameter import specs
from dmframe.block.port import Side
from dmframe.block.prose import about
from dmframe.block.symmetric import lower_triangle
from dmframe.certify import Verdict
from dmframe.certify.parameter_margins import same_claims
from dmframe.common.errors import DmframeError
from dmframe.common.names import unicode_name
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Parameter
from dmframe.diagram.knowledge import known_truths
from dmframe.diagram.values import with_values
from dmframe.formula.unmarked import unmarked

GROUPS = {Side.CONTROLLER: "controller", Side.PLANT: "hidden", Side.SOURCE: "path"}
ROBOT = {
    "robot.inertia": "Masses and inertias of all links, together",
    "robot.gravity": "Gravity",
    "robot.friction_velocity": "Where smooth Coulomb friction reaches tanh(1)",
}
"""Robot parameters that a factor may change, with descriptions."""
KNOWN = "; the controller uses the changed value"
MOST = 3
"""Maximum size of a parameter with one slider an element."""
WIDE, NARROW = 100.0, 4.0
"""Largest factors of gains and unknown parameters, and of path parameters."""
REACH_PARTS = (1, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32, 1 / 64)
"""Fractions of the range tried if a block rejects the full range of a slider."""
REACHES = {"m": 0.1, "rad": 0.5}
"""Range of a shift of a position or angle, by unit."""

Heeded = Callable[[Set[int], np.ndarray], Set[int]]
"""Function from moved elements of p, others fixed, to those with any effect."""


@final
@dataclass(frozen=True)
class Slider:
    """Slider: factor of a parameter's elements, or shift of one element.

    Parameters
    ----------
    label
        ``block.parameter``, and for a shift ``block.parameter[k]``.
    at, size
        Elements of p that it changes.
    most
        Largest factor (its inverse is the least), or largest shift in `unit`.
    first
        Index of the parameter in p.
    written
        Structure of the parameter in a graph file: index of each number relative to `first`, nested lists, None for
        structural zeros.
    """

    label: str
    group: str
    block: str
    name: str
    description: str
    unit: str
    kind: str
    at: int
    size: int
    most: float
    first: int
    written: Any

    @property
    def places(self) -> range:
        """Elements of p that it changes."""
        return range(self.at, self.at + self.size)

    @property
    def data(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def sliders_of(diagram: Diagram, verdict: Verdict, heeded: Heeded | None = None) -> list[Slider]:
    """Sliders of all parameters that enter the loop only as symbols: others need a new diagram.

    Excluded are parameters fixed at zero in the proof, those from which other elements of p are computed, and those
    without visible effect according to `heeded`. The range of a slider excludes values that its block rejects.
    """
    found, at = list[Slider](), 0
    known = {group for item in known_truths(diagram) for group in item.groups}
    for parameter in diagram.loop.parameters:
        size = parameter.symbol.numel()
        if parameter.label not in verdict.fixed and changes_alone(diagram, parameter, verdict):
            found += _of(diagram, parameter, at, size, known)
        at += size
    if heeded is not None:
        moved = {place for slider in found for place in slider.places}
        acting = heeded(moved, diagram.loop.p_values)
        found = [slider for slider in found if not acting.isdisjoint(slider.places)]
    return [narrowed for slider in found if (narrowed := _narrowed(diagram, slider)) is not None]


def _of(diagram: Diagram, parameter: Parameter, at: int, size: int, known: Collection[str]) -> list[Slider]:
    block, _, name = parameter.label.partition(".")
    values, unit = parameter.value.ravel(order="F"), parameter.unit
    if parameter.label in ROBOT:
        description = ROBOT[parameter.label] + KNOWN * (name in known) + "."
        return [Slider(parameter.label, "hidden", block, name, description, unit, "factor", at, size, NARROW, at, 0)]
    if block not in diagram.blocks:
        return []
    kind = type(diagram.blocks[block])
    group, spec = GROUPS[kind.side], specs(kind).get(name)
    description = unmarked(about(kind).parameters.get(name, ""))
    shown, places = unicode_name(name), written(diagram, parameter)
    if group == "path" and unit in REACHES and (spec is None or not spec.sign):
        if size > MOST:
            return []
        axes = "xyz" if size == MOST else "1234"
        return [
            Slider(
                f"{parameter.label}[{k}]" if size > 1 else parameter.label,
                group,
                block,
                f"{shown} {axes[k]}" if size > 1 else shown,
                description,
                unit,
                "shift",
                at + k,
                1,
                REACHES[unit],
                at,
                places,
            )
            for k in range(size)
        ]
    if not np.any(values) or (spec is not None and spec.form in ("box", "ball")):
        return []
    most = NARROW if group == "path" else WIDE
    return [Slider(parameter.label, group, block, shown, description, unit, "factor", at, size, most, at, places)]


def written(diagram: Diagram, parameter: Parameter) -> Any:
    """Indices of the parameter in the structure given to its block."""
    block, _, name = parameter.label.partition(".")
    given, size = np.asarray(getattr(diagram.blocks[block], name)), parameter.symbol.numel()
    if given.ndim == 2:
        rows, columns = given.shape
        if size == rows * columns and parameter.symbol.shape == given.shape:
            return [[row + column * rows for column in range(columns)] for row in range(rows)]
        _, below, left = lower_triangle(diagram.models[block].parameters[name])
        places = {pair: k for k, (i, j) in enumerate(zip(below, left, strict=True)) for pair in ((i, j), (j, i))}
        return [[places.get((row, column)) for column in range(columns)] for row in range(rows)]
    return list(range(size)) if size > 1 or given.ndim else 0


def _narrowed(diagram: Diagram, slider: Slider) -> Slider | None:
    """Slider with a range that its block accepts at both ends; None if there is none."""
    if slider.label in ROBOT:
        return slider
    for part in REACH_PARTS:
        most = slider.most**part if slider.kind == "factor" else slider.most * part
        ends = (most, 1 / most) if slider.kind == "factor" else (most, -most)
        if all(_takes(diagram, slider, end) for end in ends):
            return replace(slider, most=most)
    return None


def _takes(diagram: Diagram, slider: Slider, value: float) -> bool:
    label = slider.label.partition("[")[0]
    p = diagram.loop.p_values.copy()
    moved = slice(slider.at, slider.at + slider.size)
    p[moved] = p[moved] * value if slider.kind == "factor" else p[moved] + value

    def filled(place: Any) -> Any:
        if isinstance(place, list):
            return [filled(inner) for inner in place]
        return 0.0 if place is None else float(p[slider.first + place])

    try:
        with_values(diagram, {label: filled(slider.written)})
    except (DmframeError, TypeError, ValueError):
        return False
    return True


def changes_alone(diagram: Diagram, parameter: Parameter, verdict: Verdict) -> bool:
    """True for a parameter that can change alone: same diagram, same certificate, no dependent parameter."""
    if parameter.label.startswith("robot."):
        return parameter.label in ROBOT
    block, _, name = parameter.label.partition(".")
    before = getattr(diagram.blocks[block], name, None)
    if before is None:
        return False
    try:
        changed = with_values(diagram, {parameter.label: (np.asarray(before, dtype=float) * 1.01 + 1e-6).tolist()})
    except (DmframeError, TypeError, ValueError):
        return False
    pairs = zip(changed.loop.parameters, diagram.loop.parameters, strict=True)
    moved = [new.label for new, old in pairs if not np.array_equal(new.value, old.value)]
    claim = verdict.flow_claim
    return moved == [parameter.label] and (claim is None or same_claims(claim, changed, block))
