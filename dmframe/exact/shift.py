r"""Evaluation at two points between which sines, cosines and other bounded functions keep their values.

With these functions frozen, :math:`f(x + u) - f(x)` depends only on how f depends on x outside of them. It vanishes,
at a random point and for random multiples of u, iff f depends on x along u through bounded functions alone. Such an f
stays bounded if, for example, a joint angle increases without bound.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from typing import Final, final

from dmframe.exact.tape import Tape
from dmframe.exact.trial import Trial, ZeroDivision
from dmframe.program import INPUT, OPERATIONS, by_code

_FROZEN: Final = frozenset(
    by_code(dict.fromkeys(("sin", "cos", "sign", *(item.name for item in OPERATIONS.values() if item.bounded)), 0))
)
"""Functions with a bounded range."""


@final
class ShiftTrial(Trial):
    """A trial for points that are shifted."""

    def sign(self, value: int) -> int:
        """Return a random number: x - x s is not bounded, for any s."""
        return self.random()

    def size(self, value: int) -> int:
        """Return the absolute value as an opaque even function, since it has no bound."""
        return self.opaque("fabs", (min(value, self.prime - value),))


@final
class Shift:
    """A tape at one point of a prime field, and at points to which it is shifted.

    Bounded functions keep their values, so that only the instructions are evaluated again that depend on moving inputs
    in another way. Raises `ZeroDivision` where a denominator vanishes, as `differences` does.

    Parameters
    ----------
    moving
        Positions of the inputs that a shift may change.
    """

    def __init__(self, tape: Tape, point: Sequence[Sequence[int]], trial: ShiftTrial, moving: Collection[int]) -> None:
        self._tape, self._trial, self._inputs = tape, trial, frozenset(moving)
        self._values = [0] * len(tape)
        tape.compute(enumerate(tape.nodes), self._values, point, trial)
        self._needed = dict[tuple[int, ...], list[int]]()

    def values(self, outputs: Sequence[int]) -> list[int]:
        """All elements of some outputs at the point."""
        return [value for output in outputs for value in self._of(self._values, output)]

    def differences(self, outputs: Sequence[int], moved: Sequence[Sequence[Sequence[int]]]) -> list[list[int]]:
        """All elements of some outputs at each of the moved points minus those at the point."""
        nodes, places, here = self._tape.nodes, self._places(tuple(outputs)), self.values(outputs)
        found = []
        for there in moved:
            values = self._values.copy()
            self._tape.compute(((place, nodes[place]) for place in places), values, there, self._trial)
            flat = (value for output in outputs for value in self._of(values, output))
            found.append([(a - b) % self._trial.prime for a, b in zip(flat, here, strict=True)])
        return found

    def _of(self, values: Sequence[int], output: int) -> list[int]:
        """An output, dense and column-major."""
        pattern, matrix = self._tape.outputs[output], [0] * self._tape.outputs[output].size
        for place, source in zip(pattern.places, self._tape.program.sources[output], strict=True):
            matrix[place] = values[source] % self._trial.prime
        return matrix

    @cached_property
    def _moving(self) -> list[int]:
        """Instructions that depend on moving inputs outside of bounded functions, in order."""
        found = set[int]()
        for place, (code, a, b, _, _) in enumerate(self._tape.nodes):
            if a in self._inputs if code == INPUT else code not in _FROZEN and (a in found or b in found):
                found.add(place)
        return sorted(found)

    def _places(self, outputs: tuple[int, ...]) -> list[int]:
        """Those of them on which some outputs depend."""
        if outputs not in self._needed:
            required = {source for output in outputs for source in self._tape.program.sources[output]}
            for place in reversed(self._moving):
                if place in required:
                    required.update(self._tape.nodes[place].operands)
            self._needed[outputs] = [place for place in self._moving if place in required]
        return self._needed[outputs]


__all__ = ["Shift", "ShiftTrial", "ZeroDivision"]
