"""Numeric evaluation of a block's equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final
from weakref import finalize

import casadi as ca
import numpy as np

from dmframe.block.base import AbstractBlock
from dmframe.block.certificate import SX
from dmframe.block.model import model_block
from dmframe.block.names import type_name
from dmframe.block.parameter import specs
from dmframe.block.port import Signal, State
from dmframe.block.sizes import Sizes, bind_sizes, parameter_arrays
from dmframe.block.symmetric import unique
from dmframe.common.errors import DmframeError, MissingError, ShapeError, UnknownNameError, ValueFault, raise_all


@final
@dataclass(frozen=True)
class Values:
    """Values of equations: arrays by name, (n,) for a column, (n, p) for a matrix, a number for a scalar.

    `rates` are the derivatives of continuous states, `next` the values of sampled states one sample later.
    """

    outputs: Mapping[str, np.ndarray]
    rates: Mapping[str, np.ndarray]
    next: Mapping[str, np.ndarray]


def evaluate(block: AbstractBlock, inputs: Mapping[str, Any], states: Mapping[str, Any], robot: Any) -> Values:
    """See `AbstractBlock.evaluate`."""
    name, chain = type_name(type(block)), _chain(robot)
    given = {
        **_arrays(
            name,
            "input",
            block.inputs,
            inputs,
            needed={port.name for port in block.inputs if not (port.optional or port.drawn)},
        ),
        **_arrays(name, "state", block.states, states, needed=set()),
    }
    sizes = Sizes()
    declared: dict[tuple[str, str], Signal | State] = {
        **{("input", port.name): port for port in block.inputs},
        **{("state", state.name): state for state in block.states},
    }
    faults = [
        fault for key, array in given.items() if (fault := _bound(sizes, f"{name}.{key[1]}", declared[key], array))
    ]
    raise_all(faults)
    sizes, wrong = bind_sizes({name: block}, chain, sizes)
    raise_all(wrong)
    values, wrong = parameter_arrays(name, block, sizes, {name: block}, chain)
    raise_all(wrong)
    return _functions(block, sizes, chain, values).values(given, sizes)


def _chain(robot: Any) -> Any:
    """The chain of a robot; a packaged one is read again only after its file has changed."""
    if not isinstance(robot, str):
        return robot
    from dmframe.robot.library import find_robot, load

    known = _CHAINS.get(robot)
    if known is None or _state(known[0]) != known[1]:
        path = find_robot(robot).urdf
        known = path, _state(path), load(robot)
        if not robot.endswith(".urdf"):  # a path may lead to another file from another folder
            _CHAINS[robot] = known
    return known[2]


_CHAINS: dict[str, tuple[Path, tuple[int, int], Any]] = {}
"""The file of a packaged robot, its state and its chain: a loop over samples names the robot at each sample."""


def _state(path: Path) -> tuple[int, int]:
    """Time of modification and size of a file; zeros without it."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _arrays(
    name: str, kind: str, items: Sequence[Signal | State], values: Mapping[str, Any], needed: set[str]
) -> dict[tuple[str, str], np.ndarray]:
    known, faults, found = {item.name for item in items}, list[DmframeError](), dict[tuple[str, str], np.ndarray]()
    for key, value in values.items():
        if key not in known:
            faults.append(UnknownNameError(f"{name}.{key}", kind, key, known))
            continue
        try:
            found[kind, key] = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            faults.append(ValueFault(f"{name}.{key}: expected numbers, found {value!r:.60}"))
    lacking = sorted(needed - values.keys())
    if lacking:
        faults.append(MissingError(f"{name}: evaluate needs the {kind}s {', '.join(lacking)}"))
    raise_all(faults)
    return found


def _bound(sizes: Sizes, label: str, item: Signal | State, array: np.ndarray) -> DmframeError | None:
    """Bind the letters of a shape to the sizes of the array; return the fault if they do not agree."""
    words = item.shape.split()
    if array.ndim != len(words):
        found = " x ".join(map(str, array.shape)) or "one number"
        return ShapeError(f"{label}: expected the shape ({item.shape}), found {found}")
    for word, size in zip(words, array.shape, strict=True):
        if word.isdigit() and int(word) != size:
            return ShapeError(f"{label}: expected the shape ({item.shape}), found {size} for {word}")
        if not word.isdigit() and (fault := sizes.bind(word, size, label)):
            return fault
    return None


@final
@dataclass(frozen=True)
class _Functions:
    """Equations as functions of the block's inputs and states, and default values of those that are not given."""

    given: Mapping[tuple[str, str], Any]
    fixed: Sequence[ca.DM]
    functions: Mapping[str, tuple[Mapping[str, str], ca.Function]]

    def values(self, given: Mapping[tuple[str, str], np.ndarray], sizes: Sizes) -> Values:
        numbers = [*(ca.DM(given.get(key, other)) for key, other in self.given.items()), *self.fixed]

        def valued(part: str) -> dict[str, np.ndarray]:
            shapes, function = self.functions[part]
            found = (value.full() for value in function.call(numbers))
            return {key: a.reshape(sizes.of(of), order="F") for (key, of), a in zip(shapes.items(), found, strict=True)}

        return Values(valued("outputs"), valued("rates"), valued("next"))


_KEPT: dict[int, tuple[Any, _Functions]] = {}
"""The last functions of each existing block, by its identity: a loop over samples uses the same ones at each sample."""


def _functions(block: AbstractBlock, sizes: Sizes, chain: Any, values: Mapping[str, np.ndarray]) -> _Functions:
    """The functions of a block for a robot and sizes; those of a block with a mutable value are not cached."""
    key = type(block).equations, chain, tuple((letter, size) for letter, (size, _) in sizes.bound.items())
    kept = _KEPT.get(id(block))
    if kept is not None and kept[0] == key:
        return kept[1]
    written = _written(block, sizes, chain, values)
    with suppress(TypeError):
        hash(block)
        if kept is None:
            finalize(block, _KEPT.pop, id(block), None)
        _KEPT[id(block)] = key, written
    return written


def _written(block: AbstractBlock, sizes: Sizes, chain: Any, values: Mapping[str, np.ndarray]) -> _Functions:
    symbolic = None
    if chain is not None:
        from dmframe.robot.symbolic import SymbolicRobot

        symbolic = SymbolicRobot(chain)
    model = model_block(type_name(type(block)), block, values, sizes, symbolic)
    given: dict[tuple[str, str], Any] = {("input", key): 0.0 for key in model.inputs}
    given |= {("state", key): values.get(key, 0.0) for key in model.states}
    spec = specs(type(block))
    pairs = [unique(spec.get(key), symbol, model.values[key]) for key, symbol in model.parameters.items()]
    if model.robot is not None:
        robot = model.robot.values()
        pairs += [(constant.symbol, robot[constant.name]) for constant in model.robot.constants]
    symbols = [*model.inputs.values(), *model.states.values(), *(symbol for symbol, _ in pairs)]
    states = {state.name: state.shape for state in block.states}
    outputs = {port.name: port.shape for port in block.outputs}

    def function(stated: Mapping[str, SX], shapes: Mapping[str, str]) -> tuple[Mapping[str, str], ca.Function]:
        parts = [ca.densify(item) for item in stated.values()]
        return {key: shapes[key] for key in stated}, ca.Function("evaluate", symbols, parts)

    equations = model.equations
    functions = {
        "outputs": function(equations.outputs, outputs),
        "rates": function(equations.rates, states),
        "next": function(equations.next, states),
    }
    return _Functions(given, [ca.DM(value) for _, value in pairs], functions)
