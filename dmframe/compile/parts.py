"""What a closed loop is made of, as CasADi functions: the one set of expressions from which every engine runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Parts:
    """The functions of one tick; the state is the controller's part z, then what is integrated, x.

    In continuous time z is empty and x is everything.

    Parameters
    ----------
    trajectory
        (t, p) -> w: what moves by itself.
    control
        (state, w, p) -> (dz, u): the controller's rates and its commands.
    rate
        (x, u, w, p) -> dx under held commands.
    outputs
        (state, w, p) -> y: what is recorded beside the state.
    clip
        (state, p) -> the state projected onto its boxes.
    """

    trajectory: Any
    control: Any
    rate: Any
    outputs: Any
    clip: Any

    @property
    def moved(self) -> bool:
        """Do trajectories act on what is integrated, within a tick?"""
        return bool(self.rate.jac_sparsity(0, 2).nnz() > 0)

    @property
    def sizes(self) -> dict[str, int]:
        """How many numbers each column holds, by its name in the C source."""
        return {
            "Z": self.control.numel_out(0),
            "X": self.rate.numel_in(0),
            "U": self.rate.numel_in(1),
            "W": self.rate.numel_in(2),
            "P": self.rate.numel_in(3),
            "Y": self.outputs.numel_out(0),
        }
