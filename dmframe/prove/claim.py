r"""A claim as data: symbols, a straight-line program, and the terms and rules that refer to its outputs.

V is half the sum of the stored terms, weighted with 1 or kappa. D is d/dt along :math:`\dot x = f(x, t)`, or the
difference over a sample, :math:`x \leftarrow g(x)`. The program contains f or g, by the label of the moving symbol. It
contains no derivative and no difference of V: the checker computes them (`dmframe.prove.point`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Literal, final

from dmframe.exact import Tape
from dmframe.exact.ring import needed
from dmframe.exact.tangent import Tangents, between
from dmframe.program import Program, shared
from dmframe.prove.rules import Rule

Out = str
"""Name of an output of the program."""


@final
@dataclass(frozen=True)
class Symbol:
    """An input of the program: free, or with exact values."""

    label: str
    kind: str
    size: int
    values: tuple[Fraction, ...] | None = None


@final
@dataclass(frozen=True)
class Term:
    """A term of V, of the dissipation, of the residual, or an error.

    Parameters
    ----------
    name
        Printed name.
    rule
        Reason why it is nonnegative or bounded. For ``square`` the checker computes the value from ``vector`` and
        ``weight``; every other rule has its ``value`` among its parts.
    parts
        Outputs from which it is computed.
    """

    name: str
    rule: str
    parts: Mapping[str, Out]


@final
@dataclass(frozen=True)
class Steps(Rule):
    """Update of an estimate from sample to sample, with the outputs that its rule uses."""

    parts: Mapping[str, Out]


@final
@dataclass(frozen=True)
class Line:
    """A delay line: its newest entry, its state, and the condition for storing an entry; None: at each sample."""

    state: str
    newest: Out
    before: Out
    when: Out | None


@final
@dataclass(frozen=True)
class PlantIdentity:
    """Identity of the plant between two samples: d/dt momentum + rest = 0."""

    momentum: Out
    rest: Out


@final
@dataclass(frozen=True)
class Part:
    """Contribution of one block.

    `weight` is ``kappa`` on the servo level below a cascade, empty for the weight 1. `lemma` contains the terms of the
    projection lemma. `memories` are pairs of an information matrix and its stated rate, `symmetric` the matrices that
    must be symmetric, `solved` the expressions that an output makes zero.
    """

    block: str
    weight: str = ""
    stored: tuple[Term, ...] = ()
    dissipation: tuple[Term, ...] = ()
    residual: tuple[Term, ...] = ()
    errors: tuple[Term, ...] = ()
    supply: Out = ""
    consumed: Term | None = None
    lemma: Out = ""
    memories: tuple[tuple[str, Out, Out], ...] = ()
    symmetric: tuple[tuple[str, Out], ...] = ()
    steps: tuple[Steps, ...] = ()
    lines: tuple[Line, ...] = ()
    plant: tuple[PlantIdentity, ...] = ()
    solved: tuple[Out, ...] = ()

    @property
    def stores(self) -> bool:
        """True if V has a term of this block."""
        return bool(self.stored or self.steps)

    @property
    def states_its_change(self) -> bool:
        """True if the block states D of its terms; without terms, D is zero."""
        return bool(self.stores or self.dissipation or self.residual)


@final
@dataclass(frozen=True, eq=False)
class Claim:
    """V and D V of a diagram.

    Parameters
    ----------
    symbols
        Quantified symbols.
    gains
        Labels of the parameters that have copies, inputs after the symbols, for the rates and next values: a fault
        changes the copies only.
    program
        All expressions, with the symbols and these copies as inputs.
    operator
        ``flow`` or ``sample``.
    moves
        Rates, or next values, by the label of the moving symbol.
    plant_moves
        In discrete time: rates of the plant between two samples, for free commands.
    reversed
        Controller states that V or a delay line contains: a fault reverses their rates or increments.
    stored_states
        In discrete time: labels of the sampled states that stored terms contain.
    composed
        Cross terms: the dominating block, the consuming block, the composed vector and the required vector.
    """

    symbols: tuple[Symbol, ...]
    gains: tuple[str, ...]
    program: Program
    operator: Literal["flow", "sample"]
    moves: Mapping[str, Out]
    plant_moves: Mapping[str, Out]
    reversed: tuple[str, ...]
    stored_states: tuple[str, ...]
    parts: tuple[Part, ...]
    composed: tuple[tuple[str, str, Out, Out], ...] = ()

    @property
    def over_samples(self) -> bool:
        """True if D is the difference over a sample."""
        return self.operator == "sample"

    @property
    def D(self) -> str:
        """Printed symbol of D V."""
        return "V(next) - V" if self.over_samples else "dV/dt"

    @cached_property
    def tape(self) -> Tape:
        """The program with exact numbers."""
        return Tape(self.program)

    @cached_property
    def shared(self) -> Claim:
        """The same claim with common subexpressions merged; error bounds are those of the original program."""
        return replace(self, program=shared(self.program))

    @cached_property
    def outputs(self) -> Mapping[Out, int]:
        """Positions of the outputs."""
        return {pattern.name: position for position, pattern in enumerate(self.program.outputs)}

    @cached_property
    def inputs(self) -> Mapping[str, int]:
        """Positions of the symbols."""
        return {symbol.label: position for position, symbol in enumerate(self.symbols)}

    @cached_property
    def copies(self) -> Mapping[str, int]:
        """Positions of the copies of the gains."""
        return {label: len(self.symbols) + place for place, label in enumerate(self.gains)}

    @cached_property
    def differentiated(self) -> tuple[Out, ...]:
        """Outputs that V is computed from, and information matrices."""
        parts = [out for part in self.parts for term in part.stored for out in made_of(term)]
        return tuple(dict.fromkeys([*parts, *(matrix for part in self.parts for _, matrix, _ in part.memories)]))

    @cached_property
    def flow(self) -> Tangents:
        """Derivatives of the outputs that V is computed from."""
        return self._tangents(self.differentiated, self.moves)

    @cached_property
    def momenta(self) -> tuple[Out, ...]:
        """Momenta that the plant identities differentiate."""
        return tuple(relation.momentum for part in self.parts for relation in part.plant)

    @cached_property
    def plant_flow(self) -> Tangents:
        """Derivatives of the momenta."""
        return self._tangents(self.momenta, self.plant_moves)

    @cached_property
    def moved(self) -> Mapping[str, Out]:
        """Moves that the identity contains; in discrete time, of the states in V, of memories and of delay lines."""
        if not self.over_samples:
            return self.moves
        names = [f"{part.block}.{name}" for part in self.parts for s in part.steps for name in (s.estimate, s.memory)]
        names += [f"{part.block}.{line.state}" for part in self.parts for line in part.lines]
        contained = {*names, *self.stored_states}
        return {label: out for label, out in self.moves.items() if label in contained}

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Instructions that the identity depends on."""
        unused = {self.moves[label] for label in self.moves if label not in self.moved}
        return needed(self.tape, [position for out, position in self.outputs.items() if out not in unused])

    @cached_property
    def later(self) -> tuple[int, ...]:
        """Instructions of V that depend on moving symbols."""
        moving = [self.inputs[label] for label in self.moved]
        return between(self.tape, moving, [self.outputs[out] for out in self.differentiated])

    def prepare(self) -> None:
        """Compute what each evaluation at a point reads."""
        _ = self.places, self.later if self.over_samples else self.flow, self.momenta and self.plant_flow

    def _tangents(self, outs: tuple[Out, ...], moves: Mapping[str, Out]) -> Tangents:
        return Tangents(self.tape, [self.outputs[out] for out in outs], [self.inputs[label] for label in moves])


def made_of(term: Term) -> tuple[Out, ...]:
    """Outputs from which the value of a term is computed."""
    return (term.parts["vector"], term.parts["weight"]) if term.rule == "square" else (term.parts["value"],)
