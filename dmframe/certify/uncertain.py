"""True parameters that are known only up to an interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dmframe.block.parameter import Spec, array, read, specs
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal


def intervals(diagram: Diagram, given: Mapping[str, Any]) -> dict[str, list[Interval]]:
    """A graph's key ``uncertain``, ``{servo.K_D: [600, 1000]}``, as one interval per element.

    Raises
    ------
    DmframeError
        A name that is not a parameter of the plant; a value that is not an interval, or excludes the graph's own
        number.
    """
    found, faults = dict[str, list[Interval]](), list[DmframeError]()
    known = {
        f"{name}.{key}": (block, key)
        for name, block in diagram.blocks.items()
        if block.side is Side.PLANT
        for key in diagram.models[name].parameters
    }
    for label, value in given.items():
        path = ("uncertain", label)
        if label not in known:
            faults.append(UnknownNameError(f"uncertain.{label}", "parameter of the plant", label, known, path=path))
            continue
        block, key = known[label]
        if value is None:
            text = f"uncertain.{label}: expected an interval [lower, upper], found nothing; leave it out if it is known"
            faults.append(ValueFault(text, path=path))
            continue
        spec = specs(type(block))[key]
        own = diagram.models[label.partition(".")[0]].values[key]
        try:
            box = Spec(spec.shape, spec.unit, spec.sign, "box")
            ends = array(read(value, box), box, own.shape)
        except (DmframeError, ValueError) as error:
            faults.append(ValueFault(f"uncertain.{label}: {error}", path=path))
            continue
        if (own < ends[..., 0]).any() or (own > ends[..., 1]).any():
            text = f"uncertain.{label}: expected an interval that holds the graph's own {own.tolist()}, found {value}"
            faults.append(ValueFault(text, path=path))
            continue
        pairs = ends.reshape(-1, 2)
        found[label] = [Interval(decimal(float(low)), decimal(float(high))) for low, high in pairs]
    raise_all(faults)
    return found
