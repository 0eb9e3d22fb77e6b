r"""A claim as data: symbols, one straight-line program, and the terms and rules that its outputs are parts of.

V is half the sum of the stored terms, weighted with 1 or kappa. D is d/dt along :math:`\dot x = f(x, t)`, or the
difference over a sample, :math:`x \leftarrow g(x)`. The program gives f or g, by the label of what moves. No output is
a derivative or a difference of V: the checker forms them (`dmframe.prove.point`).
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
        As it is printed.
    rule
        What makes it non-negative or bounded: ``square``, whose value the checker forms from ``vector`` and ``weight``;
        every other rule has its ``value`` among its parts.
    parts
        The outputs that it is made of.
    """

    name: str
    rule: str
    parts: Mapping[str, Out]


@final
@dataclass(frozen=True)
class Steps(Rule):
    """Steps of an estimate from sample to sample, with the outputs that their rule reads."""

    parts: Mapping[str, Out]


@final
@dataclass(frozen=True)
class Line:
    """A delay line: the newest entry, the state, and, where it is not stored at each sample, when it is."""

    state: str
    newest: Out
    before: Out
    when: Out | None


@final
@dataclass(frozen=True)
class Relation:
    """An identity of the plant between two samples: d/dt momentum + rest = 0."""

    momentum: Out
    rest: Out


@final
@dataclass(frozen=True)
class Part:
    """What one block contributes.

    `weight` is ``kappa`` on the servo level below a cascade, empty for the weight 1. `lemma` holds the terms of the
    projection lemma. `memories` are pairs of an information matrix and its stated rate, `symmetric` the matrices that
    must be symmetric, `solved` what an output makes zero.
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
    plant: tuple[Relation, ...] = ()
    solved: tuple[Out, ...] = ()

    @property
    def stores(self) -> bool:
        """True where V has a term of this block."""
        return bool(self.stored or self.steps)

    @property
    def states_its_change(self) -> bool:
        """True where the block states D of its terms: also of none, which then loses and gains nothing."""
        return bool(self.stores or self.dissipation or self.residual)


@final
@dataclass(frozen=True, eq=False)
class Claim:
    """V and D V of a diagram.

    Parameters
    ----------
    symbols
        What the claim is quantified over.
    gains
        Labels of the parameters whose values in what moves the states are inputs of their own, after the symbols: a
        fault changes them there alone.
    program
        All expressions, with the symbols and these copies as inputs.
    operator
        ``flow`` or ``sample``.
    moves
        Rates, or next values, by the label of the symbol that moves.
    plant_moves
        Over samples: rates of what the plant moves between two samples, its commands free.
    reversed
        States of the controller that V or a delay line holds: a fault reverses their moves.
    stored_states
        Over samples: labels of the sampled states that stored terms hold.
    composed
        Cross terms: the block that dominates, the one that consumes, what the first composes, and what the second has.
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
        """True where D is the difference over a sample."""
        return self.operator == "sample"

    @property
    def D(self) -> str:
        """How D V is printed."""
        return "V(next) - V" if self.over_samples else "dV/dt"

    @cached_property
    def tape(self) -> Tape:
        """The program with exact numbers."""
        return Tape(self.program)

    @cached_property
    def shared(self) -> Claim:
        """The same claim, its program with each value once; error bounds are those of the program as it is."""
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
        """Positions of the gains' copies."""
        return {label: len(self.symbols) + place for place, label in enumerate(self.gains)}

    @cached_property
    def differentiated(self) -> tuple[Out, ...]:
        """The outputs of which V is made, and information matrices."""
        parts = [out for part in self.parts for term in part.stored for out in made_of(term)]
        return tuple(dict.fromkeys([*parts, *(matrix for part in self.parts for _, matrix, _ in part.memories)]))

    @cached_property
    def flow(self) -> Tangents:
        """The derivatives of what V is made of."""
        return self._tangents(self.differentiated, self.moves)

    @cached_property
    def momenta(self) -> tuple[Out, ...]:
        """What the plant's identities differentiate."""
        return tuple(relation.momentum for part in self.parts for relation in part.plant)

    @cached_property
    def plant_flow(self) -> Tangents:
        """The derivatives of these."""
        return self._tangents(self.momenta, self.plant_moves)

    @cached_property
    def moved(self) -> Mapping[str, Out]:
        """The moves of which the identity speaks: over samples, of what V holds, of memories and of delay lines."""
        if not self.over_samples:
            return self.moves
        names = [f"{part.block}.{name}" for part in self.parts for s in part.steps for name in (s.estimate, s.memory)]
        names += [f"{part.block}.{line.state}" for part in self.parts for line in part.lines]
        held = {*names, *self.stored_states}
        return {label: out for label, out in self.moves.items() if label in held}

    @cached_property
    def places(self) -> tuple[int, ...]:
        """The instructions that the identity needs."""
        left = {self.moves[label] for label in self.moves if label not in self.moved}
        return needed(self.tape, [position for out, position in self.outputs.items() if out not in left])

    @cached_property
    def later(self) -> tuple[int, ...]:
        """The instructions of what V is made of that depend on what moves."""
        moving = [self.inputs[label] for label in self.moved]
        return between(self.tape, moving, [self.outputs[out] for out in self.differentiated])

    def _tangents(self, outs: tuple[Out, ...], moves: Mapping[str, Out]) -> Tangents:
        return Tangents(self.tape, [self.outputs[out] for out in outs], [self.inputs[label] for label in moves])


def made_of(term: Term) -> tuple[Out, ...]:
    """The outputs that a term's value is formed of."""
    return (term.parts["vector"], term.parts["weight"]) if term.rule == "square" else (term.parts["value"],)
