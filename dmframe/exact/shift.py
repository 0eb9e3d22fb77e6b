r"""Evaluation at two points between which sines, cosines and other bounded functions keep their values.

With these functions frozen, :math:`f(x + u) - f(x)` depends only on how f depends on x outside of them. It vanishes,
at a random point and for random multiples of u, iff f depends on x along u through bounded functions alone. Such an f
stays bounded if, for example, a joint angle increases without bound.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from fractions import Fraction
from typing import final

from dmframe.exact.tape import Tape
from dmframe.exact.trial import Trial, ZeroDivision
from dmframe.program import OPERATIONS

BOUNDED = frozenset(operation.name for operation in OPERATIONS.values() if operation.bounded)
"""Functions with a bounded range; sin, cos and sign are not called by name."""


@final
class _Frozen(Trial):
    """A trial in which each call of a bounded function returns what the same call of the first evaluation returned."""

    def __init__(self, prime: int, rng: random.Random) -> None:
        super().__init__(prime, rng)
        self._recorded: list[tuple[int, int]] = []
        self._next: int | None = None

    def begin(self, *, replay: bool) -> None:
        """Start to record, or to replay the record."""
        if replay:
            self._next = 0
        else:
            self._recorded, self._next = [], None

    def cos_sin(self, angle: int) -> tuple[int, int]:
        return self._recorded_value() or self._record(super().cos_sin(angle))

    def sign(self, value: int) -> int:
        """Return a random number, the same at both points: x - x s is not bounded, for any s."""
        return (self._recorded_value() or self._record((self.random(), 0)))[0]

    def size(self, value: int) -> int:
        """Return the absolute value as an opaque even function, since it has no bound."""
        return self.opaque("fabs", (min(value, self.prime - value),))

    def opaque(self, name: str, arguments: tuple[int, ...]) -> int:
        if name not in BOUNDED:
            return super().opaque(name, arguments)
        return (self._recorded_value() or self._record((super().opaque(name, arguments), 0)))[0]

    def _recorded_value(self) -> tuple[int, int] | None:
        if self._next is None:
            return None
        self._next += 1
        return self._recorded[self._next - 1]

    def _record(self, value: tuple[int, int]) -> tuple[int, int]:
        self._recorded.append(value)
        return value


@final
class Shift:
    """Differences of functions along directions, in a random prime field."""

    def __init__(self, prime: int, rng: random.Random) -> None:
        self.prime = prime
        self._trial = _Frozen(prime, rng)

    def residue(self, value: Fraction) -> int:
        """An exact number as a residue."""
        return self._trial.residue(value)

    def random(self) -> int:
        """A uniformly random residue."""
        return self._trial.random()

    def values(self, tape: Tape, point: Sequence[Sequence[int]]) -> list[int]:
        """All outputs at a point."""
        self._trial.begin(replay=False)
        return [value for output in tape.evaluate(point, self._trial) for value in output]

    def difference(
        self, tape: Tape, point: Sequence[Sequence[int]], moved: Sequence[Sequence[Sequence[int]]]
    ) -> list[list[int]]:
        """All outputs at each of the moved points minus those at the point, bounded functions frozen there.

        Raises `ZeroDivision` where a denominator vanishes.
        """
        here = self.values(tape, point)
        found = []
        for there in moved:
            self._trial.begin(replay=True)
            flat = [value for output in tape.evaluate(there, self._trial) for value in output]
            found.append([(a - b) % self.prime for a, b in zip(flat, here, strict=True)])
        return found


__all__ = ["Shift", "ZeroDivision"]
