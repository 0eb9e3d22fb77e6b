"""The dimension of each symbol of a block, from the declarations of ports, states, parameters and the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel
from dmframe.block.parameter import PAIRS, Spec, specs
from dmframe.block.port import ANY, Signal, State
from dmframe.block.symmetric import lower_triangle
from dmframe.dimensions.algebra import ANYTHING, Algebra
from dmframe.dimensions.dimension import declared
from dmframe.dimensions.limits import LIMITS, Limited
from dmframe.robot.parameters import DynamicParameters

_OF_JOINTS_AND_TASK: Final = ("n", "m")
"""Letters whose elements have the same unit: joints, and coordinates of the task."""


@final
class Leaf(NamedTuple):
    """A scalar symbol: its name in messages, its dimension, and the parameter to which it belongs, if any."""

    name: str
    dimension: int
    parameter: str = ""


@final
@dataclass(frozen=True)
class Argument:
    """Symbols that are declared together; the dimension of each is computed when a program reads it."""

    symbols: SX
    leaf: Callable[[int], Leaf]


@final
class Declared:
    """The declarations of a block as handles of an algebra.

    Parameters
    ----------
    model
        The block.
    units
        Units of elements from the blocks of the diagram, by letter.
    """

    def __init__(self, algebra: Algebra, model: BlockModel, units: Mapping[str, tuple[str, ...]]) -> None:
        self.algebra, self.model, self._units = algebra, model, units
        self._unknowns = dict[tuple[str, int], int]()
        self._memories = {item.memory for item in model.block.estimates if item.memory}
        self.arguments = list[Argument]()
        self._starts = {name for state in model.block.states for name in (state.name, state.box, state.ball)}
        block, states = model.block, {state.name: state for state in model.block.states}
        for port in block.inputs:
            self.add(port, model.inputs[port.name])
        for name, leaf in model.states.items():
            self.add(states[name], leaf)
        for name, spec in specs(type(block)).items():
            own = model.parameters.get(name), model.starts.get(f"{name}_0")
            for leaf in own:
                if leaf is not None:
                    self._add_parameter(name, leaf, spec)
        if model.robot is not None:
            self._add_robot(model.robot)

    def unit(self, unit: str) -> int:
        """The handle of a declared unit."""
        return self.algebra.handle(declared(unit))

    def of_item(self, item: Signal | State, rows: int, columns: int) -> list[int]:
        """The dimensions of a port's or state's elements, column by column."""
        return [self._element(item.name, item.shape, item.unit, i, j) for j in range(columns) for i in range(rows)]

    def add(self, item: Signal | State, leaf: SX) -> None:
        """Declare the symbols of a port or a state."""
        rows = leaf.shape[0]

        def of(k: int) -> Leaf:
            i, j = k % rows, k // rows
            return Leaf(_label(item.name, leaf, i, j), self._element(item.name, item.shape, item.unit, i, j))

        self.arguments.append(Argument(leaf, of))

    def _add_parameter(self, name: str, leaf: SX, spec: Spec) -> None:
        full = spec.form == "gain" and not leaf.is_column()
        pair, words = spec.form in PAIRS, spec.shape.split()
        shape = " ".join(words * 2 if full else words[:1] if pair else words)
        symbols, rows, columns = lower_triangle(leaf) if full else (leaf, [], [])
        height = leaf.shape[0]

        def of(k: int) -> Leaf:
            i, j = (rows[k], columns[k]) if full else (k % height, k // height)
            return Leaf(_label(name, leaf, i, j), self._of_parameter(name, spec, shape, i, 0 if pair else j), name)

        self.arguments.append(Argument(symbols, of))

    def _of_parameter(self, name: str, spec: Spec, shape: str, i: int, j: int) -> int:
        if spec.several:
            return ANYTHING
        if not spec.unit and (self._follows(name) or (name not in self._starts and self._mixed(shape))):
            return self._free(name, shape, i, j)
        return self._element(name, shape, spec.unit, i, j)

    def _follows(self, name: str) -> bool:
        """True if a parameter's unit follows from the error that drives an adaptation, or from the estimate."""
        block = self.model.block
        error = getattr(block, "driven_by", "")
        open_unit = any(port.name == error and port.unit == ANY for port in (*block.inputs, *block.outputs))
        return any(item.gain == name for item in block.estimates) or (open_unit and name in ("error_leak", "dead_zone"))

    def _add_robot(self, robot: Any) -> None:
        inertia = [element.unit for element in DynamicParameters(robot.chain).elements]
        for constant in robot.constants:
            kind = constant.name.rpartition(".")[2]
            units = inertia if kind == "inertia" else [constant.unit] * constant.symbol.numel()
            self._add_constant(kind, constant.symbol, units)
        for name, symbol in robot.limits.items() if isinstance(robot, Limited) else ():
            self._add_constant(name, symbol, [LIMITS[name]] * symbol.numel())

    def _add_constant(self, name: str, symbol: SX, units: Sequence[str]) -> None:
        def of(k: int) -> Leaf:
            return Leaf(_label(name, symbol, k, 0), self._open(units[k]))

        self.arguments.append(Argument(symbol, of))

    def _open(self, unit: str) -> int:
        """The dimension of a unit with the power of rad undetermined."""
        return self.algebra.handle(declared(unit)._replace(angular=False))

    def _element(self, name: str, shape: str, unit: str, i: int, j: int) -> int:
        """The dimension of one element of an array with this name, shape and unit."""
        words = shape.split()
        if unit == ANY or name in self._memories:
            return self._free(name, shape, i, j)
        if not unit and len(words) == 1 and words[0] in self._units and self._units[words[0]][i]:
            return self._open(self._units[words[0]][i])
        if not unit and self._mixed(shape):
            return self.algebra.product(self._free(name, shape, i, j), self.unit(""))
        if len(words) == 2 and words[1] in self._units and self._units[words[1]][j]:
            return self.algebra.product(self.unit(unit), self._open(self._units[words[1]][j]), -1)
        return self.unit(unit)

    def _mixed(self, shape: str) -> bool:
        """True if the elements of an array without a unit may have different units."""
        return any(word not in _OF_JOINTS_AND_TASK for word in shape.split())

    def _free(self, name: str, shape: str, i: int, j: int) -> int:
        """An unknown dimension: one for all joints, one per element of other kinds; for a matrix, row times column."""
        words = shape.split()
        counted = [letter in self._units for letter in words]
        places = [
            place if letter not in _OF_JOINTS_AND_TASK and (is_counted or not any(counted)) else 0
            for letter, place, is_counted in zip(words, (i, j), counted, strict=False)
        ]
        if len(words) < 2:
            return self._unknown(name, places[0] if places else 0)
        rows, columns = (name, name) if words[0] == words[1] else (f"{name} by row", f"{name} by column")
        return self.algebra.product(self._unknown(rows, places[0]), self._unknown(columns, places[1]))

    def _unknown(self, name: str, place: int) -> int:
        if (name, place) not in self._unknowns:
            self._unknowns[name, place] = self.algebra.unknown()
        return self._unknowns[name, place]


def _label(name: str, leaf: SX, i: int, j: int) -> str:
    """Name of an element as a block writes it."""
    if leaf.numel() == 1:
        return name
    return f"{name}[{i}]" if leaf.shape[1] == 1 else f"{name}[{i}, {j}]"
