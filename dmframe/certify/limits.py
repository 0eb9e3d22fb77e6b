r"""From what vanishes to what the loop is for: errors that go to zero because a vanishing signal is made of them.

Let every :math:`z_k \to 0`. A vector w goes to zero if it is, identically and element by element,

.. math:: w = \sum_k c_k z_k \quad\text{or}\quad R^\top w = \sum_k c_k z_k

with constants :math:`c_k`, and R of full row rank, uniformly: then :math:`|R^\top w|^2 \ge c |w|^2`. With such an R,
:math:`(R R^\top)^{-1} R z_k` goes to zero too, which :math:`R^\top` takes to :math:`z_k` or next to it, and so does
what is made of its parts. The constants are not guessed: they are solved for at random points of a prime field, more
points than there are constants, with the parameters at the graph's own numbers.
"""

from __future__ import annotations

import random
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.certificate import SX, Potential, Square, soft_clip
from dmframe.certify.claim import Claim
from dmframe.certify.closure import Closure
from dmframe.certify.symbols import Group, Symbols, exact_values, symbols_of
from dmframe.exact import Tape
from dmframe.exact.linear import rank
from dmframe.exact.trial import Trial, ZeroDivision
from dmframe.linalg import nodes, solve_spd
from dmframe.text import Text, around, listed_text, name_of, sentence

_SOFT = r"\operatorname{soft\_clip}({})"

MORE = 3
"""Points beyond the number of constants, each a further test."""


@final
@dataclass(frozen=True)
class Vanishing:
    """A vector that goes to zero; `proved` if its derivative is known to be bounded, which that step needs."""

    of: Text
    vector: SX
    proved: bool


@final
@dataclass(frozen=True)
class Goal:
    """An error that should go to zero; `width`, of one that a potential holds, whose forces know it as soft_clip."""

    of: Text
    vector: SX
    width: SX | None = None


@final
@dataclass(frozen=True)
class Made:
    """The step by which an error goes to zero, and what it assumes."""

    step: Text
    assumes: tuple[Text, ...] = ()


def goals(claim: Claim, closure: Closure) -> list[Goal]:
    """The errors in V, those that certificates name, and those that a stable linear subsystem drives."""
    found = {
        term.of: Goal(term.of, term.vector, term.width if isinstance(term, Potential) else None)
        for part in claim.parts
        for term in (*part.certificate.storage, *part.certificate.errors)
        if isinstance(term, Square | Potential)
    }
    for item in closure.driven:
        for name, vector in zip(item.of, item.bounded, strict=True):
            found.setdefault(name, Goal(name, vector))
    return list(found.values())


def combined(samples: Samples, closure: Closure, goal: Goal, vanishing: Sequence[Vanishing]) -> Made | None:
    """Why a goal goes to zero, if it does: it itself, or its soft_clip, which is zero where it is and nowhere else."""
    made = _combined(samples, closure, goal, vanishing)
    if made is None and goal.width is not None:
        forces = Goal(
            Text(around(goal.of, "soft_clip({})", r"\operatorname{soft\_clip}({})")), soft_clip(goal.vector, goal.width)
        )
        made = _combined(samples, closure, forces, vanishing)
        return made and Made(Text(forces.of, " goes to zero: ", made.step), made.assumes)
    return made


def _combined(samples: Samples, closure: Closure, goal: Goal, vanishing: Sequence[Vanishing]) -> Made | None:
    for block, item in closure.driving:
        if goal.of in item.of and any(
            ca.is_equal(goal.vector, z) for z in item.vectors if z.shape == goal.vector.shape
        ):
            inputs = [_made_of(samples, rest, vanishing) for rest in closure.remainders(block, item)]
            if None not in inputs:
                names = dict.fromkeys(name for names in inputs for name in names or ())
                made = listed_text(list(names))
                return Made(Text("a stable linear equation drives it, and its input, made of ", made, ", vanishes"))
    used = _made_of(samples, goal.vector, vanishing)
    if used is not None:
        return Made(Text("it is made of ", listed_text(used)))
    for name, R in full_rank(samples.claim):
        if not _can_have(samples, R):
            continue
        if R.shape[0] == goal.vector.shape[0]:
            seen = R.T @ goal.vector
            used = _made_of(samples, seen, vanishing)
            if used is not None:
                whole = around(goal.of, f"{name}'({{}})", rf"{name.latex}^\top ({{}})", f"{name.unicode}ᵀ({{}})")
                how = "goes to zero" if used == [whole] else Text("is made of ", listed_text(used))
                step = sentence("{whole} {made}, and {name} has full row rank", whole=whole, made=how, name=name)
                return Made(step, (_keeps_rank(name),))
        if R.shape[0] > goal.vector.shape[0]:
            for gone in vanishing:
                if _made_of(samples, goal.vector, list(_parts(gone, R, goal.vector.numel()))) is not None:
                    transposed = around(name, "{}'", r"{}^\top", "{}ᵀ")
                    text = "it is part of what {R} takes to {gone}, and {name} has full row rank"
                    return Made(sentence(text, R=transposed, gone=gone.of, name=name), (_keeps_rank(name),))
    return None


def _keeps_rank(name: Text) -> Text:
    return Text(name, " keeps full row rank, uniformly")


def _parts(item: Vanishing, R: SX, size: int) -> Iterator[Vanishing]:
    """The parts, of a length, of the vectors that R' takes to what vanishes, or next to it."""
    width = R.shape[1]
    for first in range(0, item.vector.numel() - width + 1, width):
        whole = solve_spd(R @ R.T, R @ item.vector[first : first + width])
        yield from (Vanishing(item.of, whole[k : k + size], item.proved) for k in range(whole.numel() - size + 1))


def full_rank(claim: Claim) -> Iterator[tuple[Text, SX]]:
    """The matrices whose rows are declared independent, by their names; of one name in two blocks, with the block."""
    diagram = claim.diagram
    given = [name for model in diagram.models.values() for name in model.equations.outputs]
    for name, model in diagram.models.items():
        for port in model.block.outputs:
            if port.full_rank and port.name in model.equations.outputs:
                R = claim.loop.joined([diagram.resolver.output(name, port.name)])[0]
                yield Text(name_of(port.name), f" ({name})" * (given.count(port.name) > 1)), R


def _can_have(samples: Samples, R: SX) -> bool:
    """True for a matrix whose rows are independent at a random point, as almost everywhere then."""
    sampled, (rows, width) = samples.at([R], 1), R.shape
    if sampled is None:
        return False
    (values,) = sampled
    found = rank([[values[column * rows + row] for column in range(width)] for row in range(rows)], samples.prime)
    return bool(found == rows)


def _made_of(samples: Samples, target: SX, vanishing: Sequence[Vanishing]) -> list[Text] | None:
    """The names of those of which the target is a combination with constant coefficients, element by element."""
    size = target.numel()
    whole = [item for item in vanishing if item.vector.numel() % size == 0]
    names = [item.of for item in whole for _ in range(item.vector.numel() // size)]
    if not names:
        return None
    chosen = list(range(len(names)))
    points = samples.at([target, *(item.vector for item in whole)], len(names) + 1 + MORE)
    if points is None or not _spans(samples.prime, points, size, chosen):
        return None
    for k in range(len(names) - 1, -1, -1):  # the fewest that still do
        if _spans(samples.prime, points, size, [other for other in chosen if other != k]):
            chosen.remove(k)
    return list(dict.fromkeys(names[k] for k in chosen))


def _spans(prime: int, points: Sequence[Sequence[int]], size: int, chosen: Sequence[int]) -> bool:
    """At every element: is the first column a combination of the chosen ones, over all sampled points?"""
    for element in range(size):
        columns = [[point[size * (1 + k) + element] for point in points] for k in chosen]
        target = [point[element] for point in points]
        if not columns or rank([*columns, target], prime) != rank(columns, prime):
            return False
    return True


@final
class _Field(Trial):
    """A field in which signs and sizes are free values too: of them nothing is known but their arguments."""

    def sign(self, value: int) -> int:
        return self.opaque("sign", (value,))

    def size(self, value: int) -> int:
        return self.opaque("fabs", (min(value, self.prime - value),))


@final
class Samples:
    """Values of expressions at random points of a prime field that share their parameters, each computed once.

    The parameters have the graph's own numbers; those in intervals are free.
    """

    def __init__(self, claim: Claim, prime: int, seed: int, uncertain: Collection[str] = ()) -> None:
        self.claim, self.prime = claim, prime
        self._uncertain, self._trial = uncertain, _Field(prime, random.Random(seed))
        self._own = exact_values(claim.diagram)
        self._parameters, self._points = dict[str, list[int]](), list[dict[str, list[int]]]()
        self._values = dict[Any, tuple[SX, Symbols, Tape, list[list[int] | None]]]()

    def at(self, expressions: Sequence[SX], count: int) -> list[list[int]] | None:
        """All elements, at each of so many points; None where a denominator vanishes at nearly all points."""
        found = list[list[int]]()
        for k in range(4 * count):
            columns = [self._at(x, k) for x in expressions]
            if None not in columns:
                found.append([value for column in columns for value in column or ()])
            if len(found) == count:
                return found
        return None

    def _at(self, x: SX, k: int) -> list[int] | None:
        """All elements at the k-th point; None where a denominator vanishes."""
        key = nodes(x)
        if key not in self._values:  # with the expression, which keeps its identity
            symbols = symbols_of(self.claim, self._uncertain)  # with the trajectories' present derivatives
            tape = Tape.from_function(symbols.function("made", [ca.vec(ca.densify(x))]))
            self._values[key] = x, symbols, tape, []
        _, symbols, tape, values = self._values[key]
        for place in range(len(values), k + 1):
            try:
                values += tape.evaluate(self._point(place, symbols), self._trial)
            except ZeroDivision:
                values.append(None)
        return values[k]

    def _point(self, k: int, symbols: Symbols) -> list[list[int]]:
        while len(self._points) <= k:
            self._points.append({})
        return [self._residues(group, self._points[k]) for group in symbols.groups]

    def _residues(self, group: Group, point: dict[str, list[int]]) -> list[int]:
        known = self._parameters if group.kind == "parameter" else point
        if group.label not in known:
            own = known is self._parameters and group.label not in self._uncertain
            values = self._own[group.label] if own else ()
            size = group.symbol.numel()
            known[group.label] = list(map(self._trial.residue, values)) or [self._trial.random() for _ in range(size)]
        return known[group.label]
