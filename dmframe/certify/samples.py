r"""What a diagram claims over samples: V(next) - V, identically, on the very map of a tick that a run computes.

    V = (S_1 + S_2 + ...),    V(next) - V = -1/2 (decreases) + 1/2 (residuals)

V holds sampled states and parameters alone, so that no formula for the plant between two samples is needed: the claim
holds for every measurement and every command. What the residuals are made of is another matter: rows of an estimator
stand for means over a sample of what the plant's motion obeys, and that relation is tested along the vector field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import casadi as ca

from dmframe.block.faults import told_by
from dmframe.block.model import symbols_in
from dmframe.certificate import (
    SX,
    Acted,
    Certificate,
    Kept,
    LeastSquaresSteps,
    Relation,
    SampledCertificate,
    Square,
    Steps,
)
from dmframe.certify.claim import Claim, NotApplicableError, total
from dmframe.certify.identity import Equality
from dmframe.certify.sample_forms import unfit
from dmframe.certify.symbols import symbols_of
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.truths import Stated, conflicts
from dmframe.diagram.view import view
from dmframe.errors import BlockError
from dmframe.port import Side


@final
@dataclass(frozen=True)
class SampledPart:
    """One block's part of the claim, in the leaves of the closed loop, measured and commanded signals substituted."""

    block: str
    storage: tuple[Square, ...]
    decrease: tuple[Square, ...]
    residual: tuple[Square, ...]
    steps: tuple[Steps, ...]
    kept: tuple[Kept, ...]
    relations: tuple[Relation, ...]
    """Their commands are not substituted: they are free."""
    solved: tuple[SX, ...]
    acted: tuple[Acted, ...]
    """In the leaves of their sides: the command as the block holds it, the rest of the plant."""
    constants: Mapping[str, SX]

    @property
    def stored(self) -> tuple[Square, ...]:
        """The terms of V, those of the steps last."""
        return (*self.storage, *(item.storage for item in self.steps))

    @property
    def V(self) -> SX:
        """Half the sum of what is stored."""
        return total([term.value for term in self.stored]) / 2

    @property
    def lost(self) -> SX:
        """Half of what V loses from sample to sample."""
        own = [term.value for term in self.decrease]
        return total([*own, *(item.decrease for item in self.steps)]) / 2

    @property
    def gained(self) -> SX:
        """Half of the residuals."""
        own = [term.value for term in self.residual]
        return total([*own, *(item.residual for item in self.steps)]) / 2


@final
@dataclass(frozen=True)
class SampledClaim:
    """What the blocks of a diagram claim over samples.

    Parameters
    ----------
    base
        The diagram, its closed loop and the true values that blocks state.
    parts
        The blocks that claim something.
    silent
        Those without a certificate, and controllers with one of continuous time, of which nothing is said and nothing
        is needed.
    next
        What each sampled state becomes, by label, measured and commanded signals substituted.
    """

    base: Claim
    parts: tuple[SampledPart, ...]
    silent: tuple[str, ...]
    next: Mapping[str, SX]

    @property
    def V(self) -> SX:
        """The Lyapunov function."""
        return total([part.V for part in self.parts])

    @property
    def left(self) -> str:
        """What V may gain, in words; empty where it gains nothing."""
        unexplained = any(part.steps for part in self.parts)
        beside = any(part.residual for part in self.parts)
        kinds = ["what its data leave unexplained"] * unexplained + ["a residual that nothing bounds"] * beside
        return " and ".join(kinds)

    @cached_property
    def symbols(self) -> Mapping[str, SX]:
        """The sampled states, by label."""
        return {v.label: v.symbol for v in self.base.loop.stepped if v.sampled}

    def moved(self, expression: SX) -> SX:
        """An expression of sampled states one sample later."""
        used = symbols_in([expression])
        labels = [label for label, symbol in self.symbols.items() if used & symbols_in([symbol])]
        if not labels:
            return expression
        old, new = stack(self.symbols[label] for label in labels), stack(self.next[label] for label in labels)
        return ca.substitute([expression], [old], [new])[0]

    def change(self, part: SampledPart) -> SX:
        """V(next) - V of one block, but for what boxes and forgetting take away from it."""
        own = total([term.value for term in part.storage]) / 2
        return self.moved(own) - own + total([item.change for item in part.steps]) / 2

    def equalities(self) -> list[Equality]:
        """All that has to vanish identically, block by block."""
        return [equality for part in self.parts for equality in self.of(part)]

    def of(self, part: SampledPart) -> Iterator[Equality]:
        """What one block claims to vanish."""
        change = self.change(part)
        scale = ca.fabs(change) + ca.fabs(part.lost) + ca.fabs(part.gained)
        if part.stored:
            yield Equality(part.block, "V(next) - V", change + part.lost - part.gained, scale)
        for name, said in (move for item in part.steps for move in item.moves.items()):
            yield _equal(part.block, f"what {name} becomes", self.next[f"{part.block}.{name}"], said)
        for memory in part.kept:
            label = f"{part.block}.{memory.state}"
            pushed = memory.pushed(self.symbols[label])
            yield _equal(part.block, f"what {memory.state} keeps", self.next[label], pushed)
        for relation in part.relations:
            rate = self.along_the_plant(relation.momentum)
            yield _equal(part.block, "what the plant's motion obeys", rate, -relation.rest)
        for left in part.solved:
            yield Equality(part.block, "the equation that its output solves", left, 1 + ca.fabs(left))

    def along_the_plant(self, expression: SX) -> SX:
        """d/dt while the plant moves between two samples, its commands free."""
        loop = self.base.loop
        known = [(leaf.symbol, leaf.expression) for leaf in loop.measured]
        moving = [variable for variable in loop.flowing if symbols_in([expression]) & symbols_in([variable.symbol])]
        if not moving:
            return ca.SX.zeros(expression.shape)
        rates = loop.rates_of(moving)
        if known:
            rates = ca.substitute(rates, [stack(a for a, _ in known)], [stack(b for _, b in known)])
        return ca.jtimes(expression, stack(variable.symbol for variable in moving), stack(rates))


def _equal(block: str, says: str, one: SX, other: SX) -> Equality:
    return Equality(block, says, ca.vec(ca.densify(one - other)), ca.vec(ca.fabs(one) + ca.fabs(other)))


def sampled_claim_of(diagram: Diagram) -> SampledClaim:
    """Assemble what the blocks claim over samples.

    Raises `NotApplicableError` where none claims anything, or one claims what nothing over samples can be said of.
    """
    stated, silent, truths = certificates_over_samples(diagram)
    claiming = {name: item for name, item in stated.items() if isinstance(item, SampledCertificate)}
    if not any(item.storage or item.steps for item in claiming.values()):
        reason = f"{diagram.loop.clocked}; a proof in continuous time does not reach it"
        raise NotApplicableError(f"{reason}, and no block of this graph claims anything over samples")
    parts = tuple(_told_part(diagram, name, item) for name, item in claiming.items())
    steps = [(part.block, item) for part in parts for item in part.steps]
    memories = frozenset(f"{name}.{item.memory}" for name, item in steps if isinstance(item, LeastSquaresSteps))
    base = Claim(diagram, diagram.loop, (), ca.SX(1), truths, {}, memories=memories)
    own = diagram.loop.becomes()
    becomes = dict(zip(own, diagram.loop.crossed(list(own.values())), strict=True))
    claim = SampledClaim(base, parts, silent, becomes)
    for text in _no_constants(claim):
        raise NotApplicableError(text)
    for part in parts:
        for text in unfit(claim, part):
            raise NotApplicableError(f"{part.block}: {text}")
    return claim


def _no_constants(claim: SampledClaim) -> Iterator[str]:
    """What is called a constant that nobody knows, and is a signal, a parameter, or no symbol of its own."""
    groups = symbols_of(claim.base).groups
    labels = {group.label for group in groups}
    loop, sources = claim.base.loop, claim.base.diagram.resolver.trajectories.values()
    taken = symbols_in([*(group.symbol for group in groups), *(leaf.symbol for leaf in (*loop.crossings, *sources))])
    taken |= symbols_in(parameter.symbol for parameter in loop.parameters)
    for part in claim.parts:
        for name, symbol in part.constants.items():
            found = symbols_in([symbol])
            if not name.isidentifier() or f"{part.block}.{name}" in labels:
                yield f"{part.block}: expected a constant's name to be one of its own, found {name!r}"
            if not symbol.is_dense() or not symbol.is_valid_input() or len(found) != symbol.numel():
                yield f"{part.block}: expected the constant {name} to be a symbol, found an expression"
            if found & taken:
                yield f"{part.block}: expected the constant {name} to be a symbol of its own, found one of the diagram"
            taken |= found


def certificates_over_samples(
    diagram: Diagram,
) -> tuple[dict[str, Certificate | SampledCertificate], tuple[str, ...], Stated]:
    """Every block's certificate; of blocks in continuous time, the true values that they state are all that is read."""
    sides = (Side.PLANT, Side.CONTROLLER)
    waiting = [name for side in sides for name, block in diagram.blocks.items() if block.side is side]
    found, stated, silent = dict[str, Certificate | SampledCertificate](), dict[str, Mapping[str, SX]](), []
    while waiting:
        faults = dict[str, str]()
        for name in waiting:
            known = len(diagram.resolver.faults)
            try:
                seen = view(diagram, name, stated)
                del diagram.resolver.faults[known:]
                with told_by(name, "certificate()"):
                    certificate = diagram.blocks[name].composed_certificate(seen.u, seen.x, seen.p, seen.truth)
            except BlockError as error:
                faults[name] = error.text
                continue
            if certificate is None:
                silent.append(name)
                continue
            if type(certificate) not in (Certificate, SampledCertificate):
                kind = type(certificate).__name__
                raise NotApplicableError(f"{name}: expected a Certificate or a SampledCertificate, found {kind}")
            found[name] = certificate
            stated[name] = {key: ca.SX(value) for key, value in certificate.truth.items()}
        if list(faults) == waiting:
            sampled = [name for name in faults if any(state.sampled for state in diagram.blocks[name].states)]
            for name in sampled:
                raise NotApplicableError(faults[name])
            silent += faults  # a law in continuous time, of which this proof says nothing
            break
        waiting = list(faults)
    for text in conflicts(diagram, stated):
        raise NotApplicableError(text)
    other = {name for name, item in found.items() if isinstance(item, Certificate)}
    silent += (name for name in other if diagram.blocks[name].side is Side.CONTROLLER)
    order = {name: found[name] for name in diagram.blocks if name in found}
    return order, tuple(name for name in diagram.blocks if name in silent), stated


def _told_part(diagram: Diagram, name: str, stated: SampledCertificate) -> SampledPart:
    """What it claims; raises `NotApplicableError` where that holds no expressions, such as an MX."""
    try:
        with told_by(name, "certificate()"):
            return _part(diagram, name, stated)
    except BlockError as error:
        raise NotApplicableError(error.text) from None


def _part(diagram: Diagram, name: str, stated: SampledCertificate) -> SampledPart:
    """In the leaves of the closed loop; the relations' commands stay leaves of their own."""
    loop = diagram.loop

    def joined(pieces: Sequence[SX]) -> list[SX]:
        return loop.crossed([ca.SX(piece) for piece in pieces])

    def when(value: SX) -> SX:
        return value if isinstance(value, int) else joined([value])[0]

    def squares(terms: Sequence[Square]) -> tuple[Square, ...]:
        return tuple(term.with_pieces(joined(term.pieces)) for term in terms)

    measured = [(leaf.symbol, leaf.expression) for leaf in loop.measured]

    def of_the_plant(expression: SX) -> SX:
        pair = ([stack(a for a, _ in measured)], [stack(b for _, b in measured)]) if measured else None
        return ca.substitute([ca.SX(expression)], *pair)[0] if pair else ca.SX(expression)

    return SampledPart(
        name,
        squares(stated.storage),
        squares(stated.decrease),
        squares(stated.residual),
        tuple(item.with_pieces(joined(item.pieces)) for item in stated.steps),
        tuple(replace(item, newest=joined([item.newest])[0], when=when(item.when)) for item in stated.kept),
        tuple(Relation(of_the_plant(item.momentum), of_the_plant(item.rest)) for item in stated.relations),
        tuple(loop.crossed([ca.vec(ca.densify(ca.SX(item)))])[0] for item in stated.solved),
        tuple(_acted(item, of_the_plant) for item in stated.acted),
        {key: ca.SX(value) for key, value in stated.constants.items()},
    )


def _acted(item: Acted, of_the_plant: Callable[[SX], SX]) -> Acted:
    return Acted(ca.SX(item.held), *(of_the_plant(piece) for piece in item.pieces[1:]))


__all__ = ["SampledClaim", "SampledPart", "certificates_over_samples", "sampled_claim_of"]
