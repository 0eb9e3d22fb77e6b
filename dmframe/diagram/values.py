"""Change the numbers of a diagram without building or compiling its expressions again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from dmframe.block import AbstractBlock
from dmframe.block.faults import fault_context
from dmframe.block.gain import Prior
from dmframe.block.model import BlockModel, stated_by, with_starts
from dmframe.block.names import type_name
from dmframe.block.numberless import remade
from dmframe.block.parameter import specs
from dmframe.block.sizes import parameter_arrays
from dmframe.block.steady import same_statement, stated_equations
from dmframe.block.symmetric import unique
from dmframe.common.errors import DmframeError, NeedsDiagramError, ShapeError, UnknownNameError, ValueFault, raise_all
from dmframe.diagram.closed_loop import Parameter
from dmframe.diagram.diagram import Diagram
from dmframe.diagram.resolve import Resolver
from dmframe.diagram.view import stated_start, view

_SYMBOLS: WeakKeyDictionary[Resolver, set[str]] = WeakKeyDictionary()
"""Labels of parameters that are known to be symbols in all expressions of their block."""


def with_values(diagram: Diagram, values: Mapping[str, Any]) -> Diagram:
    """The diagram with parameters changed, ``{"servo.K_D": [700, 700, 350]}``; each is checked as in a graph file.

    Raises
    ------
    UnknownNameError
        There is no such parameter, or it changes the equations and therefore requires a new diagram.
    NeedsDiagramError
        A block reads it as a number instead of a symbol.
    ValueFault, ShapeError, UnitError
        A value is invalid for the parameter.
    """
    by_block = dict[str, dict[str, Any]]()
    known = _numbers(diagram)
    for label, value in values.items():
        if label not in known:
            raise UnknownNameError(f"values.{label}", "parameter that is a number", label, known)
        if value is None:
            raise ValueFault(f"values.{label}: expected a number, found none; removing it requires another diagram")
        block, _, name = label.partition(".")
        by_block.setdefault(block, {})[name] = value
    blocks, models, faults = dict(diagram.blocks), dict(diagram.models), list[DmframeError]()
    for name, changed in by_block.items():
        kind = type(blocks[name])
        try:
            kept = {key: value for key, value in blocks[name].model_dump().items() if value is not None}
            blocks[name] = kind(**{**kept, **changed})
        except DmframeError as error:
            for fault in error.faults:  # the message has the block's type; replace it by its name
                fault.text = f"{name}.{fault.text.removeprefix(f'{type_name(kind)}.')}"
            faults += error.faults
    raise_all(faults)
    for name in (*by_block, *_priors(blocks, by_block)):
        arrays, wrong = parameter_arrays(name, blocks[name], diagram.sizes, blocks, diagram.robot)
        faults += wrong
        models[name] = replace(models[name], block=blocks[name], values=with_starts(arrays, models[name].states))
    raise_all(faults)
    for name, changed in by_block.items():
        _require_symbolic(diagram, blocks, name, changed)
    others = {name for name, model in models.items() if model is not diagram.models[name]}
    parameters = tuple(
        _valued(parameter, models) if parameter.label.partition(".")[0] in others else parameter
        for parameter in diagram.loop.parameters
    )
    return replace(diagram, blocks=blocks, models=models, loop=replace(diagram.loop, parameters=parameters))


def changed_numbers(blocks: Mapping[str, AbstractBlock], others: Mapping[str, AbstractBlock]) -> dict[str, Any] | None:
    """Arguments of `with_values` that change blocks into the others; None if they differ in more than numbers."""
    if blocks.keys() != others.keys():
        return None
    changed = dict[str, Any]()
    for name, block in blocks.items():
        other = others[name]
        if type(other) is not type(block):
            return None
        for key in type(block).model_fields:
            old, new = getattr(block, key), getattr(other, key)
            if old == new:
                continue
            spec = specs(type(block)).get(key)
            if spec is None or new is None or old is None or Prior in (type(old), type(new)):
                return None
            if spec.form == "gain" and np.ndim(old) != np.ndim(new):  # a matrix has other symbols than a diagonal
                return None
            if np.ndim(old) == np.ndim(new) and np.shape(old) != np.shape(new):  # a list of another length
                return None
            changed[f"{name}.{key}"] = new
    return changed


def _priors(blocks: Mapping[str, AbstractBlock], changed: Mapping[str, Any]) -> list[str]:
    """Other blocks with a gain computed from a changed block."""
    return [
        name
        for name, block in blocks.items()
        if name not in changed
        and any(
            isinstance(gain := getattr(block, key), Prior) and gain.inverse_of in changed for key in specs(type(block))
        )
    ]


def _require_symbolic(diagram: Diagram, blocks: Mapping[str, AbstractBlock], name: str, keys: Collection[str]) -> None:
    """Reject a number that a block reads as ``self.k`` instead of ``p.k``: its expressions contain the old value.

    Each parameter is checked once.
    """
    seen, old, new = _SYMBOLS.setdefault(diagram.resolver, set()), diagram.blocks[name], blocks[name]
    fresh = [key for key in keys if f"{name}.{key}" not in seen and getattr(old, key) != getattr(new, key)]
    if not fresh:
        return
    before, after = (_stated(diagram, name, remade(block)) for block in (old, new))
    if not same_statement(before, after):
        raise NeedsDiagramError(
            f"{name}: its equations or its start read {' or '.join(fresh)} as a number, so that other values require a "
            f"diagram of their own; read it as p.{fresh[0]}",
            path=("blocks", name),
        )
    seen |= {f"{name}.{key}" for key in fresh}


def _stated(diagram: Diagram, name: str, block: AbstractBlock) -> dict[str, Any]:
    """A block's equations and initial values on the diagram's symbols."""
    model, seen = diagram.models[name], view(diagram, name)
    with fault_context(name, "start()"):
        starts = stated_start(block, seen)
    return {**stated_equations(stated_by(name, block, model.signals(), diagram.sizes)), **starts}


def _valued(parameter: Parameter, models: Mapping[str, BlockModel]) -> Parameter:
    """The parameter with the present value of its block."""
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
    """Labels of the numeric parameters of the diagram, which can be changed."""
    return [
        f"{name}.{key}"
        for name, model in diagram.models.items()
        for key in specs(type(model.block))
        if key in model.values
    ]
