r"""Convergence of errors to zero, derived from vanishing signals of which the errors are linear combinations.

Let every :math:`z_k \to 0`. A vector w converges to zero if, identically and element by element,

.. math:: w = \sum_k c_k z_k \quad\text{or}\quad R^\top w = \sum_k c_k z_k

with constants :math:`c_k`, and R of uniformly full row rank: then :math:`|R^\top w|^2 \ge c |w|^2`. With such an R,
:math:`(R R^\top)^{-1} R z_k`, the least-squares solution of :math:`R^\top w = z_k`, converges to zero too, and so do
combinations of its parts. The constants are computed at random points of a prime field, more points than there are
constants, with the parameters at the graph's own numbers.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final

import casadi as ca

from dmframe.block.certificate import SX, Potential, Square, soft_clip
from dmframe.block.linalg import nodes, solve_spd
from dmframe.certify.claim import Claim
from dmframe.certify.closure import Closure
from dmframe.certify.symbols import Group, Symbols, exact_values, symbols_of
from dmframe.common.text import Text, around, listed_text, name_of, sentence
from dmframe.exact import Tape
from dmframe.exact.linear import rank
from dmframe.exact.trial import Trial, ZeroDivision

MORE = 3
"""Number of points beyond the number of constants; each is a further test."""


@final
@dataclass(frozen=True)
class Vanishing:
    """A vector that converges to zero; `proved` if its derivative is known to be bounded, which that step requires.

    `assumes`: assumptions without which the derivative is not known to be bounded.
    """

    of: Text
    vector: SX
    proved: bool
    assumes: tuple[Text, ...] = ()


@final
@dataclass(frozen=True)
class Goal:
    """An error that should converge to zero; `width` for one in a potential, whose forces contain its soft_clip."""

    of: Text
    vector: SX
    width: SX | None = None


@final
@dataclass(frozen=True)
class Made:
    """The step by which an error converges to zero, and its assumptions."""

    step: Text
    assumes: tuple[Text, ...] = ()


def goals(claim: Claim, closure: Closure) -> list[Goal]:
    """Errors in V, errors named by certificates, and errors driven by a stable linear subsystem."""
    found = {
        term.of: Goal(term.of, term.vector, term.width if isinstance(term, Potential) else None)
        for part in claim.parts
        for term in (*part.certificate.storage, *part.certificate.errors)
        if isinstance(term, Square | Potential)
    }
    for item in closure.linear:
        for name, vector in zip(item.of, item.bounded, strict=True):
            found.setdefault(name, Goal(name, vector))
    return list(found.values())


def combined(field: Combinations, closure: Closure, goal: Goal, vanishing: Sequence[Vanishing]) -> Made | None:
    """Reason why a goal converges to zero, or None: for itself, or for its soft_clip, which has the same zeros."""
    made = _combined(field, closure, goal, vanishing)
    if made is None and goal.width is not None:
        forces = Goal(
            Text(around(goal.of, "soft_clip({})", r"\operatorname{soft\_clip}({})")), soft_clip(goal.vector, goal.width)
        )
        made = _combined(field, closure, forces, vanishing)
        return made and Made(Text(forces.of, " goes to zero: ", made.step), made.assumes)
    return made


def _combined(field: Combinations, closure: Closure, goal: Goal, vanishing: Sequence[Vanishing]) -> Made | None:
    for block, item in closure.driving:
        if goal.of in item.of and any(
            ca.is_equal(goal.vector, z) for z in item.vectors if z.shape == goal.vector.shape
        ):
            inputs = [field.made_of(rest, vanishing) for rest in closure.remainders(block, item)]
            if None not in inputs:
                names = dict.fromkeys(name for names in inputs for name in names or ())
                made = listed_text(list(names))
                step = Text("a stable linear equation drives it, and its input, made of ", made, ", vanishes")
                return Made(step, assumed(names, vanishing))
    used = field.made_of(goal.vector, vanishing)
    if used is not None:
        return Made(Text("it is made of ", listed_text(used)), assumed(used, vanishing))
    for name, R in full_rank(field.claim):
        if not field.can_have(R):
            continue
        if R.shape[0] == goal.vector.shape[0]:
            seen = R.T @ goal.vector
            used = field.made_of(seen, vanishing)
            if used is not None:
                whole = around(goal.of, f"{name}'({{}})", rf"{name.latex}^\top ({{}})", f"{name.unicode}ᵀ({{}})")
                how = "goes to zero" if used == [whole] else Text("is made of ", listed_text(used))
                step = sentence("{whole} {made}, and {name} has full row rank", whole=whole, made=how, name=name)
                return Made(step, (_keeps_rank(name), *assumed(used, vanishing)))
        if R.shape[0] > goal.vector.shape[0]:
            for gone in vanishing:
                if field.made_of(goal.vector, list(_parts(gone, R, goal.vector.numel()))) is not None:
                    transposed = around(name, "{}'", r"{}^\top", "{}ᵀ")
                    text = "it is part of what {R} takes to {gone}, and {name} has full row rank"
                    assumes = (_keeps_rank(name), *gone.assumes)
                    return Made(sentence(text, R=transposed, gone=gone.of, name=name), assumes)
    return None


def assumed(names: Iterable[Text], vanishing: Sequence[Vanishing]) -> tuple[Text, ...]:
    """Assumptions of the vanishing vectors with these names."""
    used = set(names)
    return tuple(dict.fromkeys(text for item in vanishing if item.of in used for text in item.assumes))


def _keeps_rank(name: Text) -> Text:
    return Text(name, " keeps full row rank, uniformly")


def _parts(item: Vanishing, R: SX, size: int) -> Iterator[Vanishing]:
    """Parts, of a given length, of the least-squares solutions of R' w = z for vanishing z."""
    for whole in solutions(R, item.vector):
        yield from (Vanishing(item.of, whole[k : k + size], item.proved) for k in range(whole.numel() - size + 1))


def solutions(R: SX, z: SX) -> Iterator[SX]:
    """Least-squares solutions w of R' w = z, for each piece of z with as many elements as R has columns."""
    width = R.shape[1]
    for first in range(0, z.numel() - width + 1, width):
        yield solve_spd(R @ R.T, R @ z[first : first + width])


def full_rank(claim: Claim) -> Iterator[tuple[Text, SX]]:
    """Matrices whose rows are declared independent, by name; a name in two blocks is printed with the block."""
    diagram = claim.diagram
    given = [name for model in diagram.models.values() for name in model.equations.outputs]
    for name, model in diagram.models.items():
        for port in model.block.outputs:
            if port.full_rank and port.name in model.equations.outputs:
                R = claim.loop.joined([diagram.resolver.output(name, port.name)])[0]
                yield Text(name_of(port.name), f" ({name})" * (given.count(port.name) > 1)), R


@final
class Combinations:
    """Constant coefficients, computed at random points of a prime field with the graph's own parameters.

    Parameters
    ----------
    uncertain
        Labels of parameters with intervals, which are free.
    """

    def __init__(self, claim: Claim, prime: int, seed: int, uncertain: frozenset[str] = frozenset()) -> None:
        self.claim, self._uncertain, self._trial = claim, uncertain, _Free(prime, random.Random(seed))
        self._own = {k: x for k, x in exact_values(claim.diagram).items() if k not in uncertain}
        self._parameters, self._points = dict[str, list[int]](), list[dict[str, list[int]]]()
        self._known = dict[Any, tuple[SX, Symbols, Tape, list[list[int] | None]]]()

    def can_have(self, R: SX) -> bool:
        """True for a matrix whose rows are independent at a random point, and therefore almost everywhere."""
        points, (rows, width) = self._sampled([R], 1), R.shape
        if points is None:
            return False
        columns = [[points[0][column * rows + row] for column in range(width)] for row in range(rows)]
        return bool(rank(columns, self._trial.prime) == rows)

    def is_part(self, target: SX, whole: SX) -> bool:
        """True if the target is made of parts of a vector, each of the target's size."""
        size = target.numel()
        parts = [Vanishing(Text("part"), whole[k : k + size], True) for k in range(whole.numel() - size + 1)]
        return self.made_of(target, parts) is not None

    def made_of(self, target: SX, vanishing: Sequence[Vanishing]) -> list[Text] | None:
        """Names of the vectors of which the target is a combination with constant coefficients, element by element."""
        size = target.numel()
        whole = [item for item in vanishing if item.vector.numel() % size == 0]
        names = [item.of for item in whole for _ in range(item.vector.numel() // size)]
        if not names:
            return None
        chosen = list(range(len(names)))
        points = self._sampled([target, *(item.vector for item in whole)], len(names) + 1 + MORE)
        if points is None or not self._spans(points, size, chosen):
            return None
        for k in range(len(names) - 1, -1, -1):  # a minimal set
            if self._spans(points, size, [other for other in chosen if other != k]):
                chosen.remove(k)
        return list(dict.fromkeys(names[k] for k in chosen))

    def _spans(self, points: Sequence[Sequence[int]], size: int, chosen: Sequence[int]) -> bool:
        """Whether, for every element, the target is a combination of the chosen vectors, over all sampled points."""
        for element in range(size):
            columns = [[point[size * (1 + k) + element] for point in points] for k in chosen]
            target, prime = [point[element] for point in points], self._trial.prime
            if not columns or rank([*columns, target], prime) != rank(columns, prime):
                return False
        return True

    def _sampled(self, expressions: Sequence[SX], count: int) -> list[list[int]] | None:
        """All elements at random points with common parameters; None if a denominator vanishes at most points."""
        found = list[list[int]]()
        for k in range(4 * count):
            columns = [self._value(x, k) for x in expressions]
            if None not in columns:
                found.append([value for column in columns for value in column or ()])
            if len(found) == count:
                return found
        return None

    def _value(self, x: SX, k: int) -> list[int] | None:
        """All elements at the k-th point, common to all expressions; None if a denominator vanishes."""
        key = nodes(x)
        if key not in self._known:  # the stored expression keeps the identities of its nodes unique
            symbols = symbols_of(self.claim, self._uncertain)  # includes the present derivatives of trajectories
            self._known[key] = x, symbols, Tape.from_function(symbols.function("made", [ca.vec(ca.densify(x))])), []
        _, symbols, tape, values = self._known[key]
        for place in range(len(values), k + 1):
            try:
                values += tape.evaluate(self._point(place, symbols), self._trial)
            except ZeroDivision:
                values.append(None)
        return values[k]

    def _point(self, k: int, symbols: Symbols) -> list[list[int]]:
        while len(self._points) <= k:
            self._points.append({})
        return [self._drawn(group, self._points[k]) for group in symbols.groups]

    def _drawn(self, group: Group, point: dict[str, list[int]]) -> list[int]:
        known, trial = self._parameters if group.kind == "parameter" else point, self._trial
        if group.label not in known:
            own = self._own.get(group.label) if group.kind == "parameter" else None
            free = [trial.random() for _ in range(group.symbol.numel())] if not own else []
            known[group.label] = free or [trial.residue(value) for value in own or ()]
        return known[group.label]


@final
class _Free(Trial):
    """A field in which signs and absolute values are free values too, one for each argument."""

    def sign(self, value: int) -> int:
        return self.opaque("sign", (value,))

    def size(self, value: int) -> int:
        return self.opaque("fabs", (min(value, self.prime - value),))
