"""A diagram with other numbers: the same expressions, so that nothing need be built or compiled again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dmframe.block.model import BlockModel
from dmframe.block.sizes import parameter_arrays
from dmframe.block.symmetric import unique
from dmframe.diagram.closed_loop import Parameter
from dmframe.diagram.diagram import Diagram
from dmframe.errors import DmframeError, ShapeError, UnknownNameError, ValueFault, raise_all
from dmframe.parameter import specs


def with_values(diagram: Diagram, values: Mapping[str, Any]) -> Diagram:
    """The diagram with parameters changed, ``{"servo.K_D": [700, 700, 350]}``; each is checked as in a graph file.

    Raises
    ------
    UnknownNameError
        There is no such parameter, or it shapes the equations and so needs a diagram of its own.
    ValueFault, ShapeError, UnitError
        A value that the parameter cannot take.
    """
    by_block = dict[str, dict[str, Any]]()
    known = _numbers(diagram)
    for label, value in values.items():
        if label not in known:
            raise UnknownNameError(f"values.{label}", "parameter that is a number", label, known)
        if value is None:
            raise ValueFault(f"values.{label}: expected a number, found none; leaving it out takes another diagram")
        block, _, name = label.partition(".")
        by_block.setdefault(block, {})[name] = value
    blocks, models, faults = dict(diagram.blocks), dict(diagram.models), list[DmframeError]()
    for name, changed in by_block.items():
        kind = type(blocks[name])
        try:
            kept = {key: value for key, value in blocks[name].model_dump().items() if value is not None}
            blocks[name] = kind(**{**kept, **changed})
        except DmframeError as error:
            faults += error.faults
            continue
        arrays, wrong = parameter_arrays(name, blocks[name], diagram.sizes, blocks, diagram.robot)
        faults += wrong
        models[name] = replace(models[name], block=blocks[name], values=arrays)
    raise_all(faults)
    parameters = tuple(
        _valued(parameter, models) if parameter.label.partition(".")[0] in by_block else parameter
        for parameter in diagram.loop.parameters
    )
    return replace(diagram, blocks=blocks, models=models, loop=replace(diagram.loop, parameters=parameters))


def _valued(parameter: Parameter, models: Mapping[str, BlockModel]) -> Parameter:
    """With the value that its block now has."""
    block, _, name = parameter.label.partition(".")
    model = models[block]
    if name not in model.values:
        return parameter
    try:
        _, value = unique(specs(type(model.block)).get(name), model.parameters[name], model.values[name])
    except ValueError as error:
        raise ShapeError(f"values.{parameter.label}: {error}") from None
    return replace(parameter, value=value)


def _numbers(diagram: Diagram) -> list[str]:
    """Labels of what can be changed: parameters that are numbers, and that the diagram has."""
    return [
        f"{name}.{key}"
        for name, model in diagram.models.items()
        for key in specs(type(model.block))
        if key in model.values
    ]
