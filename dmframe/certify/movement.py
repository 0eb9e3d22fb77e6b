"""Changes of expressions along directions of the state space, at two random points of a prime field."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

from dmframe.block.certificate import SX
from dmframe.block.linalg import nodes
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import Claim
from dmframe.certify.symbols import Group, exact_values, symbols_of
from dmframe.common.errors import ValueFault
from dmframe.common.slices import slices
from dmframe.diagram.pieces import rows_of
from dmframe.exact import Tape, random_prime
from dmframe.exact.shift import Shift, ShiftTrial, ZeroDivision

ATTEMPTS: Final = 20
BITS: Final = 149

MOVING: Final = ("state", "time")
"""Kinds of symbols that a direction changes."""


@final
class Movement:
    """Two random points of one field, with the same parameters.

    Parameters
    ----------
    anywhere
        If true, parameters have random values; otherwise the graph's own, except for those in intervals.
    zeros
        Labels of parameters that are zero.
    """

    def __init__(self, claim: Claim, numbers: Numbers, seed: int, *, anywhere: bool, zeros: frozenset[str]) -> None:
        self._claim, self._numbers, self._free, self._zeros = claim, numbers, anywhere, zeros
        self._symbols = symbols_of(claim, numbers.uncertain)
        rng = random.Random(seed + 3)
        self.trial: Final = ShiftTrial(random_prime(rng, BITS), rng)
        self._shifts = dict[tuple[int, int], Shift]()
        self._points: list[dict[str, list[int]]] = [{}, {}]
        self.tapes = list[tuple[Sequence[Group], Tape]]()
        self.read, self._places = list[SX](), dict[tuple[Any, ...], tuple[int, int]]()
        self._extend()

    def _extend(self) -> None:
        """Draw values for new symbols; a derivative may have added a trajectory's next one."""
        first, second = self._points
        own = exact_values(self._claim.diagram)
        for group in self._symbols.groups:
            if group.label not in first:
                size = group.symbol.numel()
                if group.label in self._zeros:
                    first[group.label] = [0] * size
                elif group.kind == "parameter" and not self._varies(group):
                    first[group.label] = [self.trial.residue(value) for value in own[group.label]]
                else:
                    first[group.label] = [self.trial.random() for _ in range(size)]
                shared = group.kind in ("parameter", "weight")
                second[group.label] = first[group.label] if shared else [self.trial.random() for _ in range(size)]

    def _varies(self, group: Group) -> bool:
        """True for a parameter without a fixed number, such as one with an interval; rotations stay orthogonal."""
        if group.label in self._numbers.uncertain:
            return True
        return self._free and group.values is None

    def _moved(self, groups: Sequence[Group], point: Mapping[str, Sequence[int]], u: Sequence[int]) -> list[list[int]]:
        """A point with its states and its time shifted along u."""
        steps = {"t": u[-1:]} | {v.label: u[rows] for v, rows in rows_of(self._claim.loop.variables)}
        return [
            [(a + b) % self.trial.prime for a, b in zip(point[group.label], steps[group.label], strict=True)]
            if group.kind in MOVING
            else list(point[group.label])
            for group in groups
        ]

    def _found(self, expressions: Sequence[SX]) -> list[tuple[int, int]]:
        """Tape and output of each expression; new expressions are compiled, together, into a new tape."""
        keys = list(map(nodes, expressions))
        new = {key: item for key, item in zip(keys, expressions, strict=True) if key not in self._places}
        if new:
            known = sum(group.kind == "trajectory" for group in self._symbols.groups)
            if known < len(self._claim.diagram.resolver.trajectories):
                self._symbols = symbols_of(self._claim, self._numbers.uncertain)
                self._extend()
            self.read += new.values()  # keeps the nodes, so that their identities stay unique
            self._places |= {key: (len(self.tapes), output) for output, key in enumerate(new)}
            tape = Tape.from_function(self._symbols.function("closure", list(new.values())))
            self.tapes.append((self._symbols.groups, tape))
        return [self._places[key] for key in keys]

    def values(self, expressions: Sequence[SX], place: int) -> list[int]:
        """Elements of columns at one of the two points."""
        (found,) = self._evaluated(expressions, place, lambda shift, _, outputs: [shift.values(outputs)])
        return found

    def along(self, expressions: Sequence[SX], direction: Sequence[int]) -> list[list[int]]:
        """Change of each element of columns along a direction, at the first point."""
        (flat,) = self.differences(expressions, 0, [direction])
        return [flat[part] for part in slices(expression.numel() for expression in expressions)]

    def differences(
        self, expressions: Sequence[SX], place: int, directions: Sequence[Sequence[int]]
    ) -> list[list[int]]:
        """Changes of each element of columns along each direction, at one of the two points."""

        def changes(shift: Shift, groups: Sequence[Group], outputs: Sequence[int]) -> list[list[int]]:
            return shift.differences(outputs, [self._moved(groups, self._points[place], u) for u in directions])

        for _ in range(ATTEMPTS):
            try:
                return self._evaluated(expressions, place, changes)
            except ZeroDivision:
                directions = [[2 * x % self.trial.prime for x in u] for u in directions]
        raise ValueFault("a denominator vanishes at every random point")

    def _evaluated(
        self,
        expressions: Sequence[SX],
        place: int,
        evaluate: Callable[[Shift, Sequence[Group], Sequence[int]], list[list[int]]],
    ) -> list[list[int]]:
        """Rows of all elements, evaluated tape by tape at a point."""
        places = self._found(expressions)
        parts = dict[tuple[int, int], list[list[int]]]()
        for number in dict.fromkeys(number for number, _ in places):
            groups, tape = self.tapes[number]
            outputs = list(dict.fromkeys(output for of, output in places if of == number))
            rows = evaluate(self._shift(number, place), groups, outputs)
            for output, part in zip(outputs, slices(tape.outputs[output].size for output in outputs), strict=True):
                parts[number, output] = [row[part] for row in rows]
        count = len(next(iter(parts.values()), [[]]))
        return [[x for at in places for x in parts[at][row]] for row in range(count)]

    def _shift(self, number: int, place: int) -> Shift:
        """A tape at one of the two points."""
        if (number, place) not in self._shifts:
            groups, tape = self.tapes[number]
            point, moving = self._points[place], [k for k, group in enumerate(groups) if group.kind in MOVING]
            self._shifts[number, place] = Shift(tape, [point[group.label] for group in groups], self.trial, moving)
        return self._shifts[number, place]
