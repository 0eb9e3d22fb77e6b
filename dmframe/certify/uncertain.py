"""True parameters that are known only up to an interval, with two kinds of dependence between them.

``servo.K_I/K_P: [1.8, 2.6]`` is an interval of the ratio of two parameters of one block, element by element, and
``servo.K_P: {factor: [0.8, 1.25]}`` one factor for all elements of the graph's own value. The intervals of the
parameters are then the least ones that hold all values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from dmframe.block.parameter import Spec, array, read, specs
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault, raise_all
from dmframe.diagram import Diagram
from dmframe.diagram.wiring import Wire
from dmframe.exact.rational import Interval
from dmframe.robot.rational import decimal

RATIO: Final = "/"
"""Between the two parameters of a ratio."""
FACTOR: Final = "*"
"""After the label of a parameter: its factor."""


def intervals(diagram: Diagram, given: Mapping[str, Any]) -> dict[str, list[Interval]]:
    """A graph's key ``uncertain``, ``{servo.K_D: [600, 1000]}``, as one interval per element.

    For a ratio the result has both its interval and that of its first parameter, and likewise for a factor, with the
    label ``servo.K_D*``.

    Raises
    ------
    DmframeError
        A name that is not a parameter of the plant; a value that is not an interval, or excludes the graph's own
        number; a ratio whose second parameter may be zero, or is given by a ratio.
    """
    found, faults = dict[str, list[Interval]](), list[DmframeError]()
    for label, value in sorted(given.items(), key=lambda item: RATIO in item[0]):
        try:
            first, _, second = label.partition(RATIO)
            if isinstance(value, Mapping):
                found |= _scaled(diagram, label, value)
                continue
            found[label] = _read(diagram, label, value)
            if second:
                _refuse_chain(label, given)
                found[first] = _product(label, found[label], _of(diagram, first.partition(".")[0], second, found))
        except DmframeError as fault:
            faults.append(fault)
    raise_all(faults)
    return found


def tie_of(label: str) -> tuple[str, str] | None:
    """The two parameters of a ratio's label, or the parameter of a factor's and nothing; None for other labels."""
    if label.endswith(FACTOR):
        return label.removesuffix(FACTOR), ""
    first, _, second = label.partition(RATIO)
    return (first, f"{first.partition('.')[0]}.{second}") if second else None


def _scaled(diagram: Diagram, label: str, value: Mapping[str, Any]) -> dict[str, list[Interval]]:
    """The interval of a factor, and those of the elements."""
    own = _own(diagram, label)[2]
    path = ("uncertain", label)
    if RATIO in label or list(value) != ["factor"]:
        wanted = "an interval [lower, upper], or {factor: [lower, upper]}"
        raise ValueFault(f"uncertain.{label}: expected {wanted}, found {dict(value)}", path=path)
    (factor,) = _ends(label, value["factor"], Spec("", "", "", "box"), np.ones(()))
    return {label: [factor * decimal(float(x)) for x in own.ravel(order="F")], f"{label}{FACTOR}": [factor]}


def _own(diagram: Diagram, label: str, of: str = "") -> tuple[Spec, str, np.ndarray]:
    """Declaration, unit and value of a parameter of the plant, or of its ratio to another one of the block."""
    known = {
        f"{name}.{key}": (block, key)
        for name, block in diagram.blocks.items()
        if block.side is Side.PLANT or _is_hidden(diagram, name)
        for key in diagram.models[name].parameters
    }
    name, whole = label.partition(".")[0], f"{label}{RATIO}{of}" if of else label
    for part in (label, f"{name}.{of}" if of else label):
        if part not in known:
            raise UnknownNameError(
                f"uncertain.{whole}", "parameter of the plant", part, known, path=("uncertain", whole)
            )
    block, key = known[label]
    spec, own = specs(type(block))[key], diagram.models[name].values[key]
    if not of:
        return spec, spec.unit, own
    divisor = diagram.models[name].values[of]
    if own.shape != divisor.shape or (divisor <= 0).any():
        text = f"uncertain.{whole}: expected the ratio to a parameter above zero of the same size"
        raise ValueFault(text, path=("uncertain", whole))
    return spec, _quotient(spec.unit, specs(type(block))[of].unit), own / divisor


def _is_hidden(diagram: Diagram, name: str) -> bool:
    """True for a source that the plant alone reads, such as a load."""
    readers = [end for (end, _), source in diagram.sources.items() if isinstance(source, Wire) and source.block == name]
    of_plant = all(diagram.blocks[end].side is Side.PLANT for end in readers)
    return diagram.blocks[name].side is Side.SOURCE and bool(readers) and of_plant


def _read(diagram: Diagram, label: str, value: Any) -> list[Interval]:
    first, _, second = label.partition(RATIO)
    spec, unit, own = _own(diagram, first, second)
    return _ends(label, value, Spec(spec.shape, unit, spec.sign, "box"), own)


def _ends(label: str, value: Any, box: Spec, own: np.ndarray) -> list[Interval]:
    """An interval for each element of the graph's own value."""
    path = ("uncertain", label)
    if value is None:
        text = f"uncertain.{label}: expected an interval [lower, upper], found nothing; leave it out if it is known"
        raise ValueFault(text, path=path)
    try:
        ends = array(read(value, box), box, own.shape)
    except (DmframeError, ValueError) as error:
        raise ValueFault(f"uncertain.{label}: {error}", path=path) from None
    if (own < ends[..., 0]).any() or (own > ends[..., 1]).any():
        text = f"uncertain.{label}: expected an interval that holds the graph's own {own.tolist()}, found {value}"
        raise ValueFault(text, path=path)
    return [Interval(decimal(float(low)), decimal(float(high))) for low, high in ends.reshape(-1, 2)]


def _quotient(unit: str, divisor: str) -> str:
    """The unit of a ratio, with one slash."""
    (over, _, under), (below, _, above) = unit.partition("/"), divisor.partition("/")
    return f"{over or '1'} {above}".strip() + f"/({under.strip('()')} {below})"


def _of(diagram: Diagram, name: str, key: str, found: Mapping[str, list[Interval]]) -> list[Interval]:
    """The intervals of a parameter, or its own numbers."""
    own = diagram.models[name].values[key].ravel(order="F")
    return found.get(f"{name}.{key}") or [Interval(decimal(float(x)), decimal(float(x))) for x in own]


def _refuse_chain(label: str, given: Iterable[str]) -> None:
    """Raise `ValueFault` if the second parameter of a ratio is itself given by a ratio."""
    _, second = tie_of(label) or ("", "")
    if other := next((other for other in given if RATIO in other and (tie_of(other) or ("",))[0] == second), ""):
        text = f"uncertain.{label}: expected a second parameter that no ratio gives, found the ratio {other}"
        raise ValueFault(text, path=("uncertain", label))


def _product(label: str, ratio: list[Interval], other: list[Interval]) -> list[Interval]:
    if min(item.lower for item in other) <= 0:
        raise ValueFault(f"uncertain.{label}: expected a second parameter above zero", path=("uncertain", label))
    return [a * b for a, b in zip(ratio, other, strict=True)]
