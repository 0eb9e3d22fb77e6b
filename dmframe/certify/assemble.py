"""A diagram's claim as data: one CasADi function whose outputs are the named expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, final

import casadi as ca

from dmframe.block.certificate import SX, InformationSquare, LogDet, NormSquare, Potential, Square, Steps
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify.claim import Claim, NotApplicableError, Part
from dmframe.certify.form import stepping
from dmframe.certify.symbols import Group, Symbols, symbols_of
from dmframe.diagram.closed_loop import stack
from dmframe.program import Pattern, Program, read
from dmframe.prove import claim as data

RULES = {
    "Square": "square",
    "NormSquare": "norm_square",
    "Lemma": "monotone",
    "InformationSquare": "gathered",
    "Potential": "potential",
    "LogDet": "log_det",
    "Clipped": "clipped",
    "Consumed": "square",
}
"""Rule by the class of a term."""

DEEP = 100
"""Depth to which two elements are compared before their difference is tested."""


def assembled(claim: Claim, uncertain: Sequence[str] = (), more: Mapping[str, SX] = MappingProxyType({})) -> data.Claim:
    """The claim as data, with further expressions as outputs of its program, by name.

    Raises `NotApplicableError` if a certificate contains a symbol that is neither a signal nor a parameter of the
    diagram.
    """
    return _Assembly(claim, uncertain, more).claim()


@final
class _Assembly:
    """The expressions of a claim, collected under their names."""

    def __init__(self, claim: Claim, uncertain: Sequence[str], more: Mapping[str, SX]) -> None:
        self._of, self._uncertain, self._more = claim, uncertain, more
        self._outs = dict[str, SX]()

    def claim(self) -> data.Claim:
        """Collect all expressions, and read the program."""
        of = self._of
        parts = tuple(map(self._part, of.parts))
        composed = tuple(
            (
                block.block,
                part.block,
                self._out(f"{block.block}.composed for {part.block}", block.composed),
                self._out(f"{part.block}.consumed vector", part.certificate.consumes.vector),
            )
            for part, block in of.cross_terms
            if block is not None and part.certificate.consumes is not None
        )
        moves, plant = self._moves(parts), self._plant_moves()
        for name, expression in self._more.items():
            self._out(name, ca.vec(ca.densify(expression)) if expression.is_column() else ca.densify(expression))
        symbols = symbols_of(of, self._uncertain)  # with the trajectories' derivatives
        gains = self._gains(symbols)
        copies = [ca.SX.sym(f"{gain.label}.changed", gain.symbol.shape) for gain in gains]
        if gains:
            old, new = stack(gain.symbol for gain in gains), stack(copies)
            moved = ca.substitute(list(moves.values()), [old], [new])
            moves = dict(zip(moves, moved, strict=True))
        named = {label: self._out(f"move of {label}", rate) for label, rate in moves.items()}
        plant_named = {label: self._out(f"plant's move of {label}", rate) for label, rate in plant.items()}
        labels = [group.label for group in symbols.groups]
        still = {leaf.name for leaf in stepping(of)} if of.over_samples else set[str]()
        kinds = ["stepping" if group.label in still else group.kind for group in symbols.groups]
        return data.Claim(
            symbols=tuple(
                data.Symbol(g.label, kind, g.symbol.numel(), g.values)
                for g, kind in zip(symbols.groups, kinds, strict=True)
            ),
            gains=tuple(gain.label for gain in gains),
            program=self._program(symbols, [*labels, *(f"{gain.label}.changed" for gain in gains)], copies),
            operator="sample" if of.over_samples else "flow",
            moves=named,
            plant_moves=plant_named,
            reversed=tuple(self._reversed()),
            stored_states=tuple(self._stored()) if of.over_samples else (),
            parts=parts,
            composed=composed,
        )

    def _out(self, name: str, expression: Any) -> str:
        """Enter an output; a repeated name is numbered."""
        unique, count = name, 1
        while unique in self._outs:
            count += 1
            unique = f"{name} ({count})"
        self._outs[unique] = ca.SX(expression)
        return unique

    def _program(self, symbols: Symbols, labels: Sequence[str], copies: Sequence[SX]) -> Program:
        function = symbols.function("claim", list(self._outs.values()), copies)
        program = read(function)
        inputs = [replace(item, name=label) for item, label in zip(program.inputs, labels, strict=True)]
        outputs = [
            Pattern(name, x.shape[0], item.size, item.places)
            for item, (name, x) in zip(program.outputs, self._outs.items(), strict=True)
        ]
        return Program("claim", program.nodes, inputs, outputs, program.sources)

    def _term(self, block: str, role: str, term: Any) -> data.Term:
        kind, parts = type(term).__name__, dict[str, str]()
        prefix = f"{block}.{role} of {term.of}" if getattr(term, "of", "") else f"{block}.{role}"
        if kind == "Consumed":
            parts = {"vector": self._out(f"{prefix}.vector", term.vector), "weight": self._out(f"{prefix}.c", term.c)}
        elif isinstance(term, Square):
            vector, weight = self._out(f"{prefix}.vector", term.vector), self._out(f"{prefix}.weight", term.weight)
            parts = {"vector": vector, "weight": weight}
        else:
            parts["value"] = self._out(f"{prefix}.value", term.value)
            if isinstance(term, NormSquare | InformationSquare | Potential):
                parts["vector"] = self._out(f"{prefix}.vector", term.vector)
        return data.Term(getattr(term, "of", ""), RULES[kind], parts)

    def _part(self, part: Part) -> data.Part:
        stated, block = part.certificate, part.block

        def terms(role: str, items: Sequence[Any]) -> tuple[data.Term, ...]:
            return tuple(self._term(block, role, item) for item in items)

        return data.Part(
            block,
            weight="" if part.cascade or not self._of.cascaded else "kappa",
            stored=terms("stored", stated.storage),
            dissipation=terms("dissipation", stated.dissipation),
            residual=terms("residual", stated.residual),
            errors=terms("error", stated.errors),
            supply=self._out(f"{block}.supply", stated.supply),
            consumed=None if stated.consumes is None else self._term(block, "cross term", stated.consumes),
            lemma="" if ca.SX(part.lemma).is_zero() else self._out(f"{block}.lemma", part.lemma),
            memories=tuple(self._memories(part)),
            symmetric=tuple(self._symmetric(part)),
            steps=tuple(self._steps(block, item) for item in stated.steps),
            lines=tuple(self._line(block, item) for item in stated.delay_lines),
            plant=tuple(
                data.PlantIdentity(self._out(f"{block}.momentum", item.momentum), self._out(f"{block}.rest", item.rest))
                for item in stated.plant
            ),
            solved=tuple(self._out(f"{block}.solved", item) for item in stated.solved),
        )

    def _memories(self, part: Part) -> Iterator[tuple[str, str, str]]:
        """Information matrices and their stated rates, without repetition of a shared matrix."""
        seen = list[InformationSquare]()
        if self._of.over_samples:
            return
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, InformationSquare) and not any(_same_memory(term, other) for other in seen):
                seen.append(term)
                name = f"{part.block}: G of |{term.of}|_G^2"
                self._of.operator.record.add(name, ca.vec(term.memory))
                rate = self._out(f"{name}, its rate", term.rate)
                yield term.of, self._out(name, term.memory), rate

    def _symmetric(self, part: Part) -> Iterator[tuple[str, str]]:
        for term in part.certificate.storage:
            if isinstance(term, LogDet):
                for what, matrix in (("", term.matrix), ("the true value of ", term.true)):
                    dense = ca.densify(ca.SX(matrix))
                    if not ca.is_equal(dense, dense.T, DEEP):
                        name = f"{what}{term.of}"
                        yield name, self._out(f"{part.block}.{name}", dense)

    def _steps(self, block: str, item: Steps) -> data.Steps:
        named = {name: self._out(f"{block}.{item.estimate}: {name}", x) for name, x in item.named.items()}
        memory = item.names[1] if len(item.names) > 1 else ""
        return data.Steps(item.rule, item.estimate, memory, tuple(item.parts), len(item.rows), bool(item.box), named)

    def _line(self, block: str, item: Any) -> data.Line:
        label = f"{block}.{item.state}"
        when = None if item.always else self._out(f"{label}: when", item.when)
        before = self._out(f"{label}: before", self._of.sample.symbols[label])
        return data.Line(item.state, self._out(f"{label}: newest", item.newest), before, when)

    def _moves(self, parts: Sequence[data.Part]) -> dict[str, SX]:
        """Rates of the states in V and in information matrices; in discrete time, next values of all sampled states."""
        of = self._of
        if of.over_samples:
            return {label: ca.vec(ca.densify(then)) for label, then in of.sample.next.items()}
        made = [ca.SX(piece) for part in of.parts for term in part.certificate.storage for piece in term.pieces]
        made += [self._outs[matrix] for part in parts for _, matrix, _ in part.memories]
        return of.flow.rates_of(symbols_in(made))

    def _plant_moves(self) -> dict[str, SX]:
        of = self._of
        momenta = [item.momentum for part in of.parts for item in part.certificate.plant]
        return of.sample.plant_rates(symbols_in(momenta)) if momenta else {}

    def _reversed(self) -> Iterator[str]:
        """States of the controller that affect V or a delay line."""
        of = self._of
        lines = {f"{part.block}.{item.state}" for part in of.parts for item in part.certificate.delay_lines}
        used = symbols_in([of.V])
        for variable in of.loop.stepped if of.over_samples else of.loop.controller:
            if variable.label in lines or used & variable.identities:
                yield variable.label

    def _stored(self) -> Iterator[str]:
        """Sampled states that stored terms contain."""
        used = symbols_in([term.value for part in self._of.parts for term in part.certificate.storage])
        return (label for label, symbol in self._of.sample.symbols.items() if used & symbols_in([symbol]))

    def _gains(self, symbols: Symbols) -> list[Group]:
        """Parameters of the controller in V, in its dissipation, or in update steps of an estimate."""
        of = self._of
        stated = [part.certificate for part in of.parts]
        made = [term.value for item in stated for term in (*item.dissipation, *item.residual)]
        made += [ca.SX(x) for item in stated for steps in item.steps for x in steps.named.values()]
        held = symbols_in([of.V, *made])
        controllers = {name for name, block in of.diagram.blocks.items() if block.side is Side.CONTROLLER}
        return [
            group
            for group in symbols.groups
            if group.label.split(".")[0] in controllers
            and held & symbols_in([group.symbol])
            and group.kind == "parameter"
        ]


def _same_memory(one: InformationSquare, other: InformationSquare) -> bool:
    pairs = zip(one.pieces[2:], other.pieces[2:], strict=True)
    return all(a.shape == b.shape and ca.is_equal(a, b, 2) for a, b in pairs)


__all__ = ["NotApplicableError", "assembled"]
