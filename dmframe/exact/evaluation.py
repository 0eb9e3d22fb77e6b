"""Evaluation of a tape at a point of a prime field, and update of the dependent instructions at a second point."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import Final, final

from dmframe.exact.tape import Tape
from dmframe.exact.trial import Trial
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, Node

_SIGNED: Final = frozenset(BY_NAME[name].code for name in ("sign", "fabs"))
_SIGNS: Final = 1


@final
class Evaluation:
    """Residues of all instructions of a tape.

    Functions that a field does not have keep the values that the trial has chosen. The recomputed residues are
    therefore equal to those of a full evaluation at the second point.

    Parameters
    ----------
    moving
        Positions of the inputs that may change.
    places
        Instructions to evaluate, in order, including all that they depend on; by default all.

    Raises
    ------
    ZeroDivision
        A denominator vanishes at one of the points.
    """

    def __init__(
        self,
        tape: Tape,
        inputs: Sequence[Sequence[int]],
        trial: Trial,
        moving: Collection[int] = (),
        places: Sequence[int] | None = None,
    ) -> None:
        self._tape, self._inputs, self._trial = tape, list(inputs), trial
        self._places: Sequence[int] = range(len(tape)) if places is None else places
        self._moving = {position: 2 << place for place, position in enumerate(moving)}
        self._recomputed_at = dict[int, list[tuple[int, Node]]]()
        self.values = [0] * len(tape)
        nodes = tape.nodes
        tape.compute(((place, nodes[place]) for place in self._places), self.values, self._inputs, trial)

    @property
    def outputs(self) -> list[list[int]]:
        """The outputs, dense and column-major."""
        return self._tape.outputs_of(self.values, self._trial)

    def changed(self, inputs: Mapping[int, Sequence[int]]) -> list[int]:
        """Residues of all instructions after new values of some of the inputs that may change, by position."""
        given = list(self._inputs)
        for position, values in inputs.items():
            given[position] = values
        return self._recomputed(sum(self._moving[k] for k in inputs), given)

    def recompute_signs(self) -> None:
        """Evaluate with the present choice of signs of the trial."""
        self.values = self._recomputed(_SIGNS, self._inputs)

    def _recomputed(self, mask: int, inputs: Sequence[Sequence[int]]) -> list[int]:
        if mask not in self._recomputed_at:
            nodes = self._tape.nodes
            found = sorted(place for own, places in self._depending.items() if own & mask for place in places)
            self._recomputed_at[mask] = [(place, nodes[place]) for place in found]
        values = self.values.copy()
        self._tape.compute(self._recomputed_at[mask], values, inputs, self._trial)
        return values

    @cached_property
    def _depending(self) -> Mapping[int, Sequence[int]]:
        """Positions of instructions by their dependencies: bits of the inputs that may change, and of the signs."""
        masks, found, nodes = [0] * len(self._tape), dict[int, list[int]](), self._tape.nodes
        moving, arity = self._moving, {code: operation.arity for code, operation in OPERATIONS.items()}
        for place in self._places:
            code, a, b, _, _ = nodes[place]
            if code == INPUT:
                mask = moving.get(a, 0)
            elif code == CONST:
                mask = 0
            else:
                mask = masks[a] | masks[b] if arity[code] == 2 else masks[a]
                if code in _SIGNED:
                    mask |= _SIGNS
            masks[place] = mask
            if mask:
                found.setdefault(mask, []).append(place)
        return found
