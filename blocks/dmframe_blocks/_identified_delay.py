"""A delay that `delay_probe` identifies while the loop runs: ports of the blocks that use it, and selections by it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol

import casadi as ca

from dmframe.block import SX, Input, Signals, named, operation

MOST_DELAY: Final = 8
"""Largest delay in samples."""

DELAY_HAT: Final = Input("delay_hat", optional=True)
IDENTIFIED: Final = Input("identified", optional=True)
"""The identified delay in samples, and 1 once it is identified, 0 before."""


class Delayed(Protocol):
    """A block with a configured delay, or an identified one up to a largest value."""

    @property
    def delay(self) -> int:
        """The configured delay."""

    @property
    def delay_up_to(self) -> int | None:
        """The largest identified delay; None if the delay is configured."""


class Aimed(NamedTuple):
    """The servo's target at the beginning of a sample, and the sum of T times its errors before."""

    target: SX
    z: SX

    def after(self, command: SX, middle: SX, T: SX) -> Aimed:
        """After a sample with that command and middle pose."""
        return Aimed(self.target + T * command, self.z + T * (middle - self.target - T * command / 2))


def with_shorter_delay(aimed: Aimed, queue: SX, delay: SX, T: SX) -> Aimed:
    """Target and z for the identified delay, from those for the longest delay; z up to a constant.

    With the smaller delay, commands in the first columns of the queue act that do not act with the longest one.
    """
    target, z, D = aimed.target, aimed.z, queue.shape[1] - 1
    for k in range(D):
        acted = T * (delay < D - k)
        z = named(f"z_early_{k}", z - acted * (target + T * queue[:, k] / 2))
        target = named(f"target_early_{k}", target + acted * queue[:, k])
    return Aimed(target, z)


def longest(block: Delayed) -> int:
    """The largest delay of a block."""
    return block.delay if block.delay_up_to is None else block.delay_up_to


def check_delay(block: Delayed) -> None:
    """Raise ValueError if both a configured delay and the range of an identified one are given."""
    if block.delay_up_to is not None and block.delay:
        raise ValueError(
            f"expected delay: 0 with delay_up_to, since the input delay_hat gives the delay; found {block.delay}"
        )


def needs_delay(block: Delayed, port: str) -> bool:
    """Whether a block needs one of the two ports."""
    return block.delay_up_to is not None and port in (DELAY_HAT.name, IDENTIFIED.name)


def acting(block: Delayed, u: Signals, queue: SX) -> SX:
    """The commands from the one that acted in the last completed sample to the newest one, each in its column.

    `queue` holds the last longest + 1 commands. With a smaller identified delay the last one is repeated at the end.
    """
    return queue if block.delay_up_to is None else later(queue, u.delay_hat)


def chosen(values: Sequence[SX], index: SX) -> SX:
    """The value with that number."""
    found = values[0]
    for k, value in enumerate(values[1:], start=1):
        found = ca.if_else(index < k, found, value)
    return found


@operation
def later(queue: Any, delay: Any) -> Any:
    """The columns of a queue from the one before `delay` others on; the last column is repeated at the end."""
    D = queue.shape[1] - 1
    views = [ca.horzcat(queue[:, D - d :], ca.repmat(queue[:, D], 1, D - d)) for d in range(D + 1)]
    return chosen(views, delay)
