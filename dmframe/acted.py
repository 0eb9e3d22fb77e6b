"""What a block takes for the command that acted in a sample, and what of the plant it has to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from dmframe.condition import SX
from dmframe.fields import check_fields


@final
@dataclass(frozen=True, eq=False)
class Acted:
    """The command of the sample that is over, as rows hold it: a delay that is configured, of which the plant decides.

    Parameters
    ----------
    held
        What the rows hold as that command: a column of sampled states of the block.
    command
        What the plant applies between two samples: a column of its own signals.
    seen
        The measured position by which the block knows what the sample did.
    position
        The position itself: a column of states of the plant.
    """

    held: SX
    command: SX
    seen: SX
    position: SX

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def pieces(self) -> tuple[SX, ...]:
        """Its expressions."""
        return self.held, self.command, self.seen, self.position

    def with_pieces(self, pieces: Sequence[SX]) -> Acted:
        """The same of other expressions."""
        return Acted(*pieces)
