"""Symbols over which a claim is quantified, and those that have exact values."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, final

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify.claim import Claim, NotApplicableError
from dmframe.diagram import ClosedLoop, Diagram, Parameter
from dmframe.diagram.closed_loop import stack
from dmframe.exact import zero_test
from dmframe.program import TO_READ
from dmframe.robot.rational import decimal


@final
@dataclass(frozen=True)
class Group:
    """A signal or a parameter: its symbols, and its exact values if it is not free."""

    label: str
    kind: str
    symbol: SX
    values: tuple[Fraction, ...] | None = None


@final
@dataclass(frozen=True)
class Symbols:
    """All symbols of a residual, in a fixed order."""

    groups: tuple[Group, ...]

    def function(self, name: str, expressions: Sequence[SX], more: Sequence[SX] = ()) -> Any:
        """Expressions as a function of all groups, and of further symbols.

        Raises `NotApplicableError` if they contain any other symbol.
        """
        inputs = [*self._inputs, *map(ca.vec, more)]
        function = ca.Function(name, inputs, [ca.vec(x) for x in expressions], {"allow_free": True, **TO_READ})
        if function.has_free():
            free = ", ".join(str(symbol) for symbol in function.get_free())
            raise NotApplicableError(f"a certificate holds {free}, which is no signal and no parameter of this diagram")
        return function

    def vanishes(self, name: str, expression: SX, trials: int = 3) -> bool:
        """True if an expression is identically zero. Raises `ValueFault` if it is undefined everywhere."""
        return bool(zero_test(self.function(name, [expression]), values=self.fixed, trials=trials).zero)

    @cached_property
    def _inputs(self) -> list[SX]:
        return [stack([group.symbol]) for group in self.groups]

    @property
    def fixed(self) -> dict[int | str, Sequence[Fraction]]:
        """Positions of the groups that are not free, with their values."""
        return {k: group.values for k, group in enumerate(self.groups) if group.values is not None}


def symbols_of(claim: Claim, uncertain: Collection[str] = ()) -> Symbols:
    """The claim's symbols: the same object until a derivative adds a trajectory.

    Free symbols are the time, all states, trajectories, corrections of projections, gains, servo and inertial
    parameters. Fixed are the robot's rotations, which must be orthogonal, and absent effects: parameters of the plant
    that are zero and not `uncertain`, by label.
    """
    key = (frozenset(uncertain), len(claim.diagram.resolver.trajectories))
    if key not in claim.symbols:
        claim.symbols[key] = _symbols_of(claim, uncertain)
    known: Symbols = claim.symbols[key]
    return known


def _symbols_of(claim: Claim, uncertain: Collection[str]) -> Symbols:
    loop, diagram = claim.loop, claim.diagram
    states = [Group(v.label, "state", v.symbol) for v in loop.variables]
    trajectories = [Group(leaf.name, "trajectory", leaf.symbol) for leaf in diagram.resolver.trajectories.values()]
    corrections = [Group(f"{p.name}, correction", "projection", p.correction) for p in loop.projections]
    parameters = [
        _parameter(diagram, parameter, parameter.label in uncertain)
        for parameter in loop.parameters
        if not _of_source(diagram, parameter)
    ]
    kappa = [] if claim.kappa.is_constant() else [Group("kappa", "weight", claim.kappa)]
    time = Group("t", "time", loop.time)
    groups = (time, *states, *trajectories, *corrections, *parameters, *kappa)
    if not claim.over_samples:
        return Symbols(groups)
    known = (*groups, *_of_a_clock(loop))
    unknown = [
        Group(f"{part.block}.{name}", "constant", ca.SX(symbol))
        for part in claim.parts
        for name, symbol in part.certificate.unknown.items()
    ]
    for text in _no_constants(claim, known, unknown):
        raise NotApplicableError(text)
    return Symbols((*known, *unknown))


def _no_constants(claim: Claim, known: Sequence[Group], unknown: Sequence[Group]) -> Iterator[str]:
    """Unknown constants that are a signal, a parameter, or not a separate symbol."""
    labels, loop = {group.label for group in known}, claim.loop
    sources = claim.diagram.resolver.trajectories.values()
    taken = symbols_in(
        [*(group.symbol for group in known), *(leaf.symbol for leaf in (*loop.sampled_signals, *sources))]
    )
    taken |= loop.constants
    for group in unknown:
        block, _, name = group.label.partition(".")
        symbol, found = group.symbol, symbols_in([group.symbol])
        if not name.isidentifier() or group.label in labels:
            yield f"{block}: expected a constant's name to be one of its own, found {name!r}"
        if not symbol.is_dense() or not symbol.is_valid_input() or len(found) != symbol.numel():
            yield f"{block}: expected the constant {name} to be a symbol, found an expression"
        if found & taken:
            yield f"{block}: expected the constant {name} to be a symbol of its own, found one of the diagram"
        taken |= found


def _of_a_clock(loop: ClosedLoop) -> Iterator[Group]:
    """Sampling period, future trajectories, random inputs, and commands of a discrete-time claim."""
    yield Group("T", "period", loop.period)
    yield from (Group(leaf.name, "trajectory", leaf.symbol) for leaf in loop.ahead)
    yield from (Group(noise.label, "noise", noise.symbol) for noise in loop.noises)
    yield from (Group(f"{leaf.name}, as commanded", "command", leaf.symbol) for leaf in loop.commanded)


def _of_source(diagram: Diagram, parameter: Parameter) -> bool:
    """True for a parameter that only shapes a trajectory; trajectories are free symbols, some with the same name."""
    block = parameter.label.partition(".")[0]
    return block in diagram.blocks and diagram.resolver.side(block) is Side.SOURCE


def _parameter(diagram: Diagram, parameter: Parameter, uncertain: bool) -> Group:
    label, block = parameter.label, parameter.label.partition(".")[0]
    if label == "robot.rotations":
        return Group(label, "parameter", parameter.symbol, exact_values(diagram)[label])
    plant = block in diagram.blocks and diagram.blocks[block].side is Side.PLANT
    absent = plant and not parameter.value.any() and not uncertain
    values = (Fraction(0),) * parameter.symbol.numel() if absent else None
    return Group(label, "parameter", parameter.symbol, values)


def exact_values(diagram: Diagram) -> Mapping[str, tuple[Fraction, ...]]:
    """Every parameter's value as rational numbers: decimals as written, and the robot's exact numbers."""
    return {
        parameter.label: parameter.rational or tuple(decimal(float(x)) for x in parameter.value.ravel(order="F"))
        for parameter in diagram.loop.parameters
    }
