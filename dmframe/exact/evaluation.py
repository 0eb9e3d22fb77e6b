"""A tape at one point of a prime field, and again where little has changed: only what depends on that is recomputed."""

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
    """The residues of all instructions of a tape.

    Functions that the field does not have keep the values that the trial has chosen, so that what is recomputed is what
    a full evaluation at the other point would give, number by number.

    Parameters
    ----------
    moving
        Positions of the inputs that may change.
    places
        The instructions to evaluate, in order, with all that they need; all of them by default.

    Raises
    ------
    ZeroDivision
        A denominator vanishes, here or at the other point.
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
        self._again_at = dict[int, list[tuple[int, Node]]]()
        self.values = [0] * len(tape)
        nodes = tape.nodes
        tape.compute(((place, nodes[place]) for place in self._places), self.values, self._inputs, trial)

    @property
    def outputs(self) -> list[list[int]]:
        """The outputs, dense and column-major."""
        return self._tape.outputs_of(self.values, self._trial)

    def changed(self, inputs: Mapping[int, Sequence[int]]) -> list[int]:
        """The residues of all instructions with other ones of some of the inputs that may change, by position."""
        given = list(self._inputs)
        for position, values in inputs.items():
            given[position] = values
        return self._again(sum(self._moving[k] for k in inputs), given)

    def sign_anew(self) -> None:
        """Evaluate with the trial's present choice of signs."""
        self.values = self._again(_SIGNS, self._inputs)

    def _again(self, mask: int, inputs: Sequence[Sequence[int]]) -> list[int]:
        if mask not in self._again_at:
            nodes = self._tape.nodes
            found = sorted(place for own, places in self._depending.items() if own & mask for place in places)
            self._again_at[mask] = [(place, nodes[place]) for place in found]
        values = self.values.copy()
        self._tape.compute(self._again_at[mask], values, inputs, self._trial)
        return values

    @cached_property
    def _depending(self) -> Mapping[int, Sequence[int]]:
        """The places of instructions by what they depend on: bits of the inputs that may change, and of the signs."""
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
