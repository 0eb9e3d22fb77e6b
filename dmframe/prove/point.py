"""A claim at one point: its outputs, derivatives and differences, and the equalities that must vanish.

The point can be of any ring: residues of a prime field for the exact test, sizes for its error bound, reals for the
numeric cross-check. A fault changes the rates or next values; the stated terms of the certificates keep their values.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, final

from dmframe.common.text import UNNAMED, Text, sentence, text_of
from dmframe.exact import Tape, Trial
from dmframe.exact.ring import compute
from dmframe.prove.claim import Claim, Line, Out, Part, Steps, Term, made_of
from dmframe.prove.rules import OutputData, OutputResult, StepResult, form, shifted, step_result

Numbers = Sequence[Any]
Known = dict[tuple[str, int], dict[int, tuple[OutputData, OutputResult]]]


class Summand(NamedTuple):
    """A column of an equality, and the name of the fault that drops it."""

    name: Text
    column: list[Any]


class Equality(NamedTuple):
    """Columns whose sum must vanish, and the block that states it; empty for D V of the diagram."""

    block: str
    statement: str
    summands: list[Summand]

    @property
    def label(self) -> str:
        """Block and statement."""
        return f"{self.block}: {self.statement}" if self.block else self.statement

    @property
    def sums(self) -> list[Any]:
        """The elements that must vanish."""
        return [sum(column[1:], column[0]) for column in zip(*(s.column for s in self.summands), strict=True)]


@final
class Point:
    """A claim evaluated at one point.

    Parameters
    ----------
    ring
        Ring of the numbers.
    inputs
        Values of all symbols and of the copies of gains.
    values
        Values of all instructions.
    known
        Results of update steps at other points, by output, which are used again for equal inputs; new ones are added.
    """

    def __init__(
        self, claim: Claim, ring: Any, inputs: Sequence[Numbers], values: Numbers, known: Known | None = None
    ) -> None:
        self._known = {} if known is None else known
        self.claim, self.ring, self.inputs, self.values = claim, ring, inputs, values

    def out(self, name: Out) -> list[Any]:
        """An output, dense and column-major; zeros are the integer 0."""
        return _dense(self.claim.tape, self.values, self.claim.outputs[name])

    def input(self, label: str) -> Numbers:
        """Values of a symbol."""
        return self.inputs[self.claim.inputs[label]]

    def moves(self, outs: Mapping[str, Out], reverse: Collection[str] = ()) -> dict[str, list[Any]]:
        """Rates or next values by label; a reversed rate changes sign, a reversed increment changes direction."""
        found = {label: self.out(out) for label, out in outs.items()}
        for label in reverse:
            before = self.input(label) if self.claim.over_samples else [0] * len(found[label])
            found[label] = [2 * x - then for x, then in zip(before, found[label], strict=True)]
        return found

    def at(self, states: Mapping[str, Numbers]) -> Point:
        """The point with other values of these states, for the outputs that V is computed from."""
        inputs, values = list(self.inputs), list(self.values)
        for label, numbers in states.items():
            inputs[self.claim.inputs[label]] = numbers
        places = self.claim.later
        if isinstance(self.ring, Trial):
            nodes = self.claim.tape.nodes
            self.claim.tape.compute(((place, nodes[place]) for place in places), values, inputs, self.ring)
        else:
            compute(self.claim.tape, self.ring, values, inputs, places)
        return Point(self.claim, self.ring, inputs, values)

    def derivatives(self, moves: Mapping[str, Numbers]) -> dict[Out, list[Any]]:
        """Derivatives of the outputs that V is computed from, along these rates."""
        columns = self.claim.flow.along(self.ring, self.values, self._direction(moves))
        return dict(zip(self.claim.differentiated, columns, strict=True))

    def plant_derivatives(self) -> dict[Out, list[Any]]:
        """Derivatives of the plant's momenta along the plant's rates."""
        claim = self.claim
        direction = self._direction(self.moves(claim.plant_moves))
        return dict(zip(claim.momenta, claim.plant_flow.along(self.ring, self.values, direction), strict=True))

    def _direction(self, moves: Mapping[str, Numbers]) -> dict[int, Numbers]:
        return {self.claim.inputs[label]: numbers for label, numbers in moves.items()}

    def value(self, term: Term) -> Any:
        """Value of a term."""
        if term.rule == "square":
            vector, weight = (self.out(out) for out in made_of(term))
            return form(self.ring, vector, weight, vector)
        return self.out(term.parts["value"])[0]

    def weight(self, part: Part) -> Any:
        """Weight of a block's storage in V."""
        return self.input(part.weight)[0] if part.weight else 1

    @cached_property
    def step_results(self) -> Mapping[str, Sequence[StepResult]]:
        """Results of the update steps of each block, in order: two of them may update one estimate."""
        return {
            part.block: [self._step_result((part.block, place), steps) for place, steps in enumerate(part.steps)]
            for part in self.claim.parts
        }

    def _step_result(self, key: tuple[str, int], steps: Steps) -> StepResult:
        parts = {name: self.out(out) for name, out in steps.parts.items()}
        return step_result(self.ring, steps, parts, self._known.setdefault(key, {}))

    def half(self, value: Any) -> Any:
        """Half of a number."""
        return self.ring.reduced(value * self.ring.inverse(self.ring.number(2)))

    def storage(self, part: Part) -> Any:
        """S without the storage of update steps."""
        return self.half(sum((self.value(term) for term in part.stored), 0))


def differences(point: Point, moves: Mapping[str, Numbers], part: Part) -> list[Summand]:
    """D S of a block's stored terms, one by one."""
    if not part.stored:
        return []
    if point.claim.over_samples:
        then = point.at(moves)
        return [Summand(text_of(term.name), [point.half(then.value(term) - point.value(term))]) for term in part.stored]
    along = point.derivatives(moves)
    return [Summand(text_of(term.name), [_rate(point, term, along)]) for term in part.stored]


def _rate(point: Point, term: Term, along: Mapping[Out, list[Any]]) -> Any:
    """Half of D of a term."""
    if term.rule != "square":
        return point.half(along[term.parts["value"]][0])
    ring, (vector, weight) = point.ring, made_of(term)
    a, W, da, dW = point.out(vector), point.out(weight), along[vector], along[weight]
    return point.half(form(ring, a, W, da) + form(ring, da, W, a) + form(ring, a, dW, a))


def equalities(point: Point, moves: Mapping[str, Numbers]) -> Iterator[Equality]:
    """All equalities of the claim; D V of the diagram comes first.

    D V of the diagram, in which the supply rates cancel, does not need the equalities of the blocks. They are checked
    as well, so that a block with a wrong supply rate cannot be used in other graphs.
    """
    claim = point.claim
    own = [(part, list(_own(point, moves, part))) for part in claim.parts]
    if not claim.over_samples:
        yield _whole(point, own)
    for part, summands in own:
        if part.states_its_change or not claim.over_samples:
            supply = [-x for x in point.out(part.supply)] if part.supply else [0]
            exchanged = Summand(UNNAMED, supply)
            yield Equality(part.block, "dS/dt" if not claim.over_samples else claim.D, [*summands, exchanged])
        yield from _of_a_sample(point, moves, part)
    if not claim.over_samples:
        yield from _memories(point, moves)
        yield from _symmetric(point)
    for dominating, consuming, composed, wanted in claim.composed:
        summands = [Summand(UNNAMED, point.out(composed)), Summand(UNNAMED, [-x for x in point.out(wanted)])]
        yield Equality(dominating, f"the vector that it dominates is that of {consuming}", summands)


def _own(point: Point, moves: Mapping[str, Numbers], part: Part) -> Iterator[Summand]:
    """D S + dissipation - residual - lemma - cross term of one block, with the names of the faults that drop them."""
    block, ring = part.block, point.ring
    for place, (term, found) in enumerate(zip(part.stored, differences(point, moves, part), strict=True), start=1):
        yield Summand(Text(f"{block}: storage of ", term.name or f"term {place}", " dropped"), found.column)
    if point.claim.over_samples:
        steps = point.step_results[block]
        yield Summand(UNNAMED, [ring.reduced(sum((item.moved for item in steps), 0))])
        lost = sum((point.value(term) for term in part.dissipation), 0) + sum((item.lost for item in steps), 0)
        gained = sum((point.value(term) for term in part.residual), 0) + sum((item.gained for item in steps), 0)
        yield Summand(sentence("{block}: decrease of {V} dropped", block=block), [lost])
        yield Summand(sentence("{block}: increase of {V} dropped", block=block), [-gained])
        return
    for term in part.dissipation:
        yield Summand(Text(f"{block}: dissipation of ", term.name, " dropped"), [point.value(term)])
    for term in part.residual:
        yield Summand(Text(f"{block}: bounded residual of ", term.name, " dropped"), [-point.value(term)])
    if part.lemma:
        yield Summand(UNNAMED, [-x for x in point.out(part.lemma)])
    if part.consumed is not None:
        yield Summand(UNNAMED, [-point.value(part.consumed)])


def _whole(point: Point, own: Sequence[tuple[Part, Sequence[Summand]]]) -> Equality:
    """D V of the diagram: the weighted terms of the blocks, without supply rates."""
    found = [
        Summand(name, [point.ring.reduced(point.weight(part) * x) for x in column])
        for part, summands in own
        for name, column in summands
    ]
    return Equality("", point.claim.D, found or [Summand(UNNAMED, [0])])


def _of_a_sample(point: Point, moves: Mapping[str, Numbers], part: Part) -> Iterator[Equality]:
    """Updates of estimates and delay lines, the plant identities, and the equations that the block's output solves."""
    block = part.block
    for steps in point.step_results[block]:
        for name, stated in steps.moves.items():
            yield _equal(block, f"next value of {name}", moves[f"{block}.{name}"], stated)
    for line in part.lines:
        yield _equal(block, f"next value of {line.state}", moves[f"{block}.{line.state}"], _shifted_line(point, line))
    if part.plant:
        along = point.plant_derivatives()
        for place, relation in enumerate(part.plant, start=1):
            which = "its plant identity" if len(part.plant) == 1 else f"its plant identity {place}"
            rest = Summand(Text(f"{block}: remainder of {which} dropped"), point.out(relation.rest))
            yield Equality(block, "plant identity", [Summand(UNNAMED, along[relation.momentum]), rest])
    for expression in part.solved:
        yield Equality(block, "equation solved by its output", [Summand(UNNAMED, point.out(expression))])


def _shifted_line(point: Point, line: Line) -> list[Any]:
    when = None if line.when is None else point.out(line.when)[0]
    shapes = [_shape(point.claim, out) for out in (line.newest, line.before)]
    return shifted(point.ring, point.out(line.newest), point.out(line.before), (shapes[0], shapes[1]), when)


def _shape(claim: Claim, out: Out) -> tuple[int, int]:
    pattern = claim.program.outputs[claim.outputs[out]]
    return pattern.rows, pattern.size // pattern.rows


def _equal(block: str, statement: str, one: Numbers, other: Numbers) -> Equality:
    return Equality(block, statement, [Summand(UNNAMED, list(one)), Summand(UNNAMED, [-x for x in other])])


def _memories(point: Point, moves: Mapping[str, Numbers]) -> Iterator[Equality]:
    """Rates of information matrices, as their terms state them."""
    for part in point.claim.parts:
        for name, matrix, rate in part.memories:
            yield _equal(part.block, f"dG/dt of {name}", point.derivatives(moves)[matrix], point.out(rate))


def _symmetric(point: Point) -> Iterator[Equality]:
    """Symmetry of both matrices of a divergence, which uses their lower triangles only."""
    for part in point.claim.parts:
        for name, out in part.symmetric:
            matrix, (rows, _) = point.out(out), _shape(point.claim, out)
            transposed = [matrix[column + row * rows] for column in range(rows) for row in range(rows)]
            yield _equal(part.block, f"{name} is symmetric", matrix, transposed)


def _dense(tape: Tape, values: Numbers, output: int) -> list[Any]:
    pattern, sources = tape.program.outputs[output], tape.program.sources[output]
    matrix: list[Any] = [0] * pattern.size
    for place, source in zip(pattern.places, sources, strict=True):
        matrix[place] = values[source]
    return matrix
