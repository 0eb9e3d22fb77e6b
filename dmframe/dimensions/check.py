"""Unit check of one block, and of all blocks of a diagram."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca

from dmframe.block.base import AbstractBlock
from dmframe.block.model import BlockModel
from dmframe.block.parameter import specs
from dmframe.block.port import ANY, Signal, State
from dmframe.block.sizes import Sizes
from dmframe.common.errors import UnitError
from dmframe.common.units import base_units
from dmframe.dimensions.algebra import Algebra
from dmframe.dimensions.declared import Declared, Leaf
from dmframe.dimensions.dimension import BASES, Dimension, counted, product, spelled
from dmframe.dimensions.limits import with_limits
from dmframe.dimensions.rules import Contradiction, dimensions
from dmframe.dimensions.stated import STORED, Item, items_of
from dmframe.dimensions.words import expression
from dmframe.program import CONST, INPUT, TO_READ, Program, by_code, read, shared


def unit_faults(models: Mapping[str, BlockModel], sizes: Sizes, robot: Any = None) -> list[UnitError]:
    """The first inconsistency of units in the equations, certificate and conditions of each block.

    Parameters
    ----------
    models, sizes
        Of the diagram.
    robot
        The robot's chain, or None.
    """
    found = (check.fault() for check in checks_of(models, sizes, robot))
    return [fault for fault in found if fault is not None]


def checks_of(models: Mapping[str, BlockModel], sizes: Sizes, robot: Any = None) -> list[Check]:
    """The check of each block."""
    units = element_units(models, robot)
    prismatic = robot is not None and any(joint.kind == "prismatic" for joint in robot.joints)
    return [Check.of(model, sizes, units, prismatic=prismatic) for model in models.values()]


def element_units(models: Mapping[str, BlockModel], robot: Any) -> dict[str, tuple[str, ...]]:
    """The units of the elements of each dimension, from the blocks that define the dimension."""
    found = dict[str, tuple[str, ...]]()
    for model in models.values():
        for letter, elements in model.block.elements(robot).items():
            found.setdefault(letter, tuple(element.unit for element in elements))
    return found


@final
@dataclass(frozen=True)
class Disagreement:
    """An inconsistency of units: the expression, the value of the program, and the dimensions that differ.

    `operands` are the places of the operands that differ; empty if the dimension of a whole expression is wrong.
    """

    item: Item
    place: int
    operands: tuple[int, ...]
    found: tuple[Dimension, ...]


_POSES: Final = frozenset(by_code({"sin": 0, "cos": 0}))
"""Operations that occur in the robot's functions of a pose, and in no other function of a robot."""


@final
class Check:
    """One block's program on its own symbols, with their dimensions."""

    def __init__(
        self, model: BlockModel, sizes: Sizes, units: Mapping[str, tuple[str, ...]], *, prismatic: bool = False
    ) -> None:
        self.model = model
        self._algebra = Algebra()
        self._declared = Declared(self._algebra, model, units)
        self._items = items_of(model, sizes, self._declared)
        if _is_dimensionless(model.block):
            self._algebra.ignored = BASES
            return
        posed = model.robot is not None and not _POSES.isdisjoint(self._compiled[0].codes)
        self._algebra.ignored = ("m", "rad") if prismatic else ("rad",) if posed else ()

    @classmethod
    def of(
        cls, model: BlockModel, sizes: Sizes, units: Mapping[str, tuple[str, ...]], *, prismatic: bool = False
    ) -> Check:
        """The check of a block; after an inconsistency it is repeated with the robot's limits as symbols with units."""
        check = cls(model, sizes, units, prismatic=prismatic)
        if model.robot is None or check._first is None:
            return check
        limited = with_limits(model, sizes)
        return check if limited is None else cls(limited, sizes, units, prismatic=prismatic)

    @cached_property
    def _compiled(self) -> tuple[Program, dict[int, Leaf]]:
        column = ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(item.expression)) for item in self._items))
        given = self._declared.arguments
        known = [argument.symbols for argument in given]
        free = ca.Function("units", known, [column], {"allow_free": True}).free_sx()
        program = shared(read(ca.Function("units", [*known, ca.vertcat(ca.SX(0, 1), *free)], [column], TO_READ)))
        leaf_units = dict[int, Leaf]()
        for place, node in enumerate(program.nodes):
            if node.code == INPUT and node.a < len(given):
                leaf_units[place] = given[node.a].leaf(node.b)
            elif node.code == INPUT:  # an undeclared symbol is one that the block has created
                leaf_units[place] = Leaf(str(free[node.b]), self._algebra.unknown())
        return program, leaf_units

    @property
    def parameters(self) -> list[str]:
        """The parameters on which the block's expressions depend."""
        return sorted({leaf.parameter for leaf in self._compiled[1].values() if leaf.parameter})

    @cached_property
    def _first(self) -> Disagreement | None:
        """The first inconsistency with the declared units."""
        return self.disagreement()

    def disagreement(self, parameter: str = "", times: int | None = None) -> Disagreement | None:
        """The first inconsistency, optionally with the dimension of one parameter multiplied by another."""
        program, leaf_units = self._compiled
        algebra = self._algebra
        algebra.forget()
        given = {
            place: algebra.product(leaf.dimension, times)
            if times is not None and leaf.parameter == parameter
            else leaf.dimension
            for place, leaf in leaf_units.items()
        }
        values, wrong = dimensions(program, algebra, given)
        if wrong:
            return self._inside(program, values, wrong[0])
        places = iter(program.stored(range(len(values)))[0])
        for item in self._items:
            for k, place in zip(range(item.expression.numel()), places, strict=False):
                if item.numbers and program.nodes[place].code == CONST:
                    continue
                if item.expected and algebra.same(item.expected[k], values[place]) is None:
                    found = algebra.of(item.expected[k]), algebra.of(values[place])
                    return Disagreement(item, place, (), found)
        return None

    @property
    def storage(self) -> Dimension | None:
        """The dimension of the block's storage; None if it has none, or if the dimension is unknown."""
        if self._algebra.ignored == BASES or self.disagreement() is not None:
            return None
        stored = (item.expected[0] for item in self._items if item.what in STORED and item.expected)
        known = [found for found in map(self._algebra.of, stored) if not found.unknowns]
        return known[0] if known else None

    def times(self, dimension: Dimension) -> int:
        """The handle of a dimension, for `disagreement`."""
        return self._algebra.handle(dimension)

    def fault(self) -> UnitError | None:
        """The first inconsistency as a fault, with the one parameter whose unit would remove it."""
        declared = next(declaration_faults(type(self.model.block)), None)
        if declared is not None:
            return UnitError(f"{self.model.name}: {declared}", path=("blocks", self.model.name))
        found = self._first
        if found is None:
            return None
        program, leaf_units = self._compiled
        text = _text_of(found, program, {place: leaf.name for place, leaf in leaf_units.items()})
        return UnitError(f"{self.model.name}: {text}{self._remedy(found, program)}", path=("blocks", self.model.name))

    def _inside(self, program: Program, values: list[int], wrong: Contradiction) -> Disagreement:
        found = tuple(self._algebra.of(values[operand]) for operand in wrong.operands)
        return Disagreement(self._item_of(program, wrong.node), wrong.node, wrong.operands, found)

    def _item_of(self, program: Program, node: int) -> Item:
        """The first statement that needs a value."""
        reached = [place == node for place in range(len(program.nodes))]
        for place in range(node + 1, len(program.nodes)):
            reached[place] = any(reached[operand] for operand in program.nodes[place].operands)
        stored, begin = program.stored(reached)[0], 0
        for item in self._items:
            end = begin + item.expression.numel()
            if any(stored[begin:end]):
                return item
            begin = end
        raise AssertionError(node)  # each value is in a statement

    def _remedy(self, found: Disagreement, program: Program) -> str:
        if any(program.nodes[operand].code == CONST for operand in found.operands):
            return "; declare a number with a unit as a parameter"
        fitting = list(self._fitting())
        return f"; {fitting[0]} would agree" if len(fitting) == 1 else ""

    def _fitting(self) -> Iterator[str]:
        """Each parameter whose unit can be changed so that all expressions agree, with that unit."""
        units = {name: spec.unit for name, spec in specs(type(self.model.block)).items()}
        for parameter in self.parameters:
            factor = self._algebra.unknown()
            if self.disagreement(parameter, factor) is not None:
                continue
            other = self._algebra.of(factor)
            if not other.unknowns:
                whole = product(counted(units[parameter]), other._replace(angular=True, number=False))
                yield f"{parameter} in {spelled(whole)}"


def _is_dimensionless(block: AbstractBlock) -> bool:
    """True if a block declares no units except those of time: all its quantities, time included, are plain numbers."""
    items: list[Signal | State] = [*block.inputs, *block.outputs, *block.states, *block.truth]
    units = {item.unit for item in items} | {spec.unit for spec in specs(type(block)).values()}
    return all(base_units(unit)[1].keys() <= {"s"} for unit in units - {ANY})


def declaration_faults(block: type[AbstractBlock]) -> Iterator[str]:
    """Faults of declarations outside equations: initial values, boxes and balls of states, and derivative ports."""
    numbers = specs(block)
    for state in block.states:
        for name, what in ((state.name, "start"), (state.box, "box"), (state.ball, "ball")):
            spec = numbers.get(name)
            if spec is not None and counted(spec.unit) != counted(state.unit):
                yield (
                    f"expected {name}, the {what} of {state.name}, in {state.unit or 'a plain number'}, "
                    f"found {spec.unit or 'a plain number'}"
                )
    ports = {port.name: port for port in (*block.inputs, *block.outputs)}
    for port in ports.values():
        of = ports.get(port.derivative_of)
        if of is not None and ANY not in (of.unit, port.unit):
            rate = product(counted(of.unit), counted("s"), -1)
            if counted(port.unit) != rate:
                yield (
                    f"expected {port.name}, the derivative of {of.name}, in {spelled(rate)}, "
                    f"found {port.unit or 'a plain number'}"
                )


def _text_of(found: Disagreement, program: Program, names: Mapping[int, str]) -> str:
    where = expression(program, found.place, names)
    if not found.operands:
        expected, other = found.found
        return f"expected {found.item.what} in {spelled(expected)}, found {spelled(other)}: {where}"
    parts = [expression(program, operand, names) for operand in found.operands]
    if len(parts) == 1:
        return f"{found.item.what}: expected a plain number in {where}, found {spelled(found.found[0])}"
    one, by = parts
    first, second = found.found
    ratio = product(first, second, -1)
    if first.unknowns or second.unknowns:
        return f"{found.item.what}: {one} and {by} differ by {spelled(ratio)}, and cannot be added or compared"
    return (
        f"{found.item.what}: expected one unit in {where}, found {spelled(first)} in {one} and {spelled(second)} "
        f"in {by}"
    )
