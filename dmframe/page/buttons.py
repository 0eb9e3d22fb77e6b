"""Guided buttons of a live page: values that a button sets, from the graph's key ``page.buttons``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from dmframe.common.errors import DmframeError, MissingError, ValueFault
from dmframe.common.units import to_unit
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.page.sliders import changes_alone, written

NOW: Final = "now"
"""Text in a button's value for the time that the page shows."""
CLOCK: Final = "clock"
PROBES: Final = (0.25, 0.5)
"""Two times, as fractions of the horizon, that find the elements which are the time shown."""


def buttons_of(graph: BaseGraph, diagram: Diagram, verdict: Any, horizon: float) -> list[dict[str, Any]]:
    """Buttons with the elements of p that they set.

    Raises
    ------
    DmframeError
        A value is unknown or invalid, or changing it requires another diagram or another proof.
    """
    found = list[dict[str, Any]]()
    for name, button in graph.file.page.buttons.items():
        made: dict[str, Any] = {"name": name, "title": button.title, "says": button.says, CLOCK: None, "set": []}
        for label, value in button.set.items():
            path = ("page", "buttons", name, "set", label)
            with graph.placing():
                try:
                    if label == CLOCK:
                        made[CLOCK] = _clock(graph, value)
                    else:
                        made["set"].append(_values(diagram, verdict, label, value, horizon))
                except DmframeError as error:
                    for fault in error.faults:
                        fault.path, fault.text = path, f"{'.'.join(path[:3])}: {fault.text}"
                    raise
        found.append(made)
    return found


def _clock(graph: BaseGraph, value: Any) -> float:
    if graph.clock is None:
        raise ValueFault("expected a graph on a clock, found a continuous one; leave clock out")
    period = to_unit(value, "s")
    if not period > 0:
        raise ValueFault(f"clock: expected a positive period, found {value!r}")
    return period


def _values(diagram: Diagram, verdict: Any, label: str, value: Any, horizon: float) -> dict[str, Any]:
    """Elements of p that a label has, with numbers or `NOW`."""
    at = 0
    for parameter in diagram.loop.parameters:
        if parameter.label == label:
            break
        at += parameter.symbol.numel()
    else:
        _ = with_values(diagram, {label: _at(value, 0.0)})  # its message for an unknown name is better
        raise MissingError(f"{label}: expected a parameter that enters the loop as a symbol")
    if not changes_alone(diagram, parameter, verdict):
        raise ValueFault(f"{label}: expected a parameter that can change alone; another value needs another diagram")
    first, second = (_numbers(diagram, label, _at(value, part * horizon)) for part in PROBES)
    numbers = [NOW if a != b else float(a) for a, b in zip(first, second, strict=True)]
    return {"label": label, "at": at, "values": numbers, "written": written(diagram, parameter)}


def _numbers(diagram: Diagram, label: str, value: Any) -> np.ndarray:
    changed = with_values(diagram, {label: value})
    found: Mapping[str, np.ndarray] = {parameter.label: parameter.value for parameter in changed.loop.parameters}
    return found[label].ravel(order="F")


def _at(value: Any, time: float) -> Any:
    """The value with a time in place of `NOW`."""
    if isinstance(value, list):
        return [_at(item, time) for item in value]
    return time if value == NOW else value
