"""Which numbers of a closed loop a page lets its reader move."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, final

import numpy as np

from dmframe.block.prose import about
from dmframe.certify import Verdict
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Parameter
from dmframe.diagram.values import with_values
from dmframe.errors import DmframeError
from dmframe.formula.names import unicode_name
from dmframe.parameter import specs
from dmframe.port import Side

GROUPS = {Side.CONTROLLER: "controller", Side.PLANT: "hidden", Side.SOURCE: "path"}
ROBOT = {
    "robot.inertia": "Masses and inertias of all links, together.",
    "robot.gravity": "Gravity; the controller knows it.",
    "robot.friction_velocity": "Where smooth Coulomb friction reaches tanh(1).",
}
"""Numbers of the robot that a factor may change, with what they are."""
MOST = 3
"""Elements of a parameter that is moved element by element."""
WIDE, NARROW = 100.0, 4.0
"""Largest factors: of gains and unknown numbers, of what shapes a path."""
REACHES = {"m": 0.1, "rad": 0.5}
"""How far an element of a place or an angle may be moved, by its unit."""


@final
@dataclass(frozen=True)
class Slider:
    """A number that can be moved: a factor of a parameter's elements, or a shift of one element.

    Parameters
    ----------
    label
        ``block.parameter``, and for a shift ``block.parameter[k]``.
    at, size
        Which elements of p it moves.
    most
        The largest factor, whose inverse is the least, or the largest shift in `unit`.
    """

    label: str
    group: str
    block: str
    name: str
    says: str
    unit: str
    kind: str
    at: int
    size: int
    most: float

    @property
    def data(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def sliders_of(diagram: Diagram, verdict: Verdict) -> list[Slider]:
    """All numbers that enter the loop as symbols alone: one that a block reads as a number needs another diagram.

    Left out, too, are numbers that the proof takes for zero, and those from which another number of p was computed.
    """
    found, at = list[Slider](), 0
    for parameter in diagram.loop.parameters:
        size = parameter.symbol.numel()
        if parameter.label not in verdict.fixed and _free(diagram, parameter):
            found += _of(diagram, parameter, at, size)
        at += size
    return found


def _of(diagram: Diagram, parameter: Parameter, at: int, size: int) -> list[Slider]:
    block, _, name = parameter.label.partition(".")
    values, unit = parameter.value.ravel(order="F"), parameter.unit
    if parameter.label in ROBOT:
        says = ROBOT[parameter.label]
        return [Slider(parameter.label, "hidden", block, name, says, unit, "factor", at, size, NARROW)]
    if block not in diagram.blocks:
        return []
    kind = type(diagram.blocks[block])
    group, spec = GROUPS[kind.side], specs(kind).get(name)
    says = about(kind).parameters.get(name, "")
    shown = unicode_name(name)
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
                says,
                unit,
                "shift",
                at + k,
                1,
                REACHES[unit],
            )
            for k in range(size)
        ]
    if not np.any(values) or (spec is not None and spec.form in ("box", "ball")):
        return []
    most = NARROW if group == "path" else WIDE
    return [Slider(parameter.label, group, block, shown, says, unit, "factor", at, size, most)]


def _free(diagram: Diagram, parameter: Parameter) -> bool:
    """True for a number that can change by itself, without another diagram and without another number."""
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
    return moved == [parameter.label]
