"""What one script may use of a robot that others use as well: budgets, each with a fault of that script alone."""

from __future__ import annotations

from typing import Any, Final, final

from dmframe.virtual.words import ScriptError

MOST_ELEMENTS: Final = 10_000
"""Of one value, lists within lists counted through; eight characters of a text count as one."""
MOST_NESTED: Final = 20
"""Lists within lists of one value."""
MOST_HELD: Final = 200_000
"""Elements of all variables of a script, those of calls under way among them."""
MOST_THREADS: Final = 50
"""Of a script."""
MOST_BESIDE: Final = 8
"""Secondary programs at once."""
BESIDE: Final = 1 / MOST_BESIDE
"""What one of them may use, of what the main program may."""
BURST: Final = 20_000
"""Operations that a script may do without a wait. One is a loop's turn, a call, or four elements: some 2 us."""
RATE: Final = 200_000.0
"""Operations in a second of the robot's time that a script may do on average: less than half of the cycles' time."""
COUNTED: Final = MOST_HELD
"""Elements that are copied between two counts of what a script holds."""

COSTS: Final = {
    "get_inverse_kin": 4000,
    "get_inverse_kin_has_solution": 4000,
    "is_within_safety_limits": 4000,
    **dict.fromkeys(("movej", "movel", "servoj", "socket_open"), 200),
    **dict.fromkeys("pose_add pose_sub pose_trans pose_inv pose_dist point_dist get_forward_kin".split(), 30),
    **dict.fromkeys("get_actual_tcp_pose get_target_tcp_pose get_actual_tcp_speed get_target_tcp_speed".split(), 30),
    **dict.fromkeys("socket_send_string socket_send_line textmsg popup norm".split(), 10),
}
"""Operations that a call of a function counts as; 1 for the others. An inverse kinematics may take 100 steps."""


@final
class Allowance:
    """The operations that a script has left. They come back with the robot's time, up to `BURST`.

    Parameters
    ----------
    refill
        Operations that come back in a cycle.
    """

    def __init__(self, refill: float) -> None:
        self._left, self._refill, self.copied = float(BURST), refill, 0

    def cycle(self) -> None:
        """A cycle of the robot begins."""
        self._left = min(BURST, self._left + self._refill)

    def spend(self, operations: int) -> None:
        """Raises `ScriptError` where more are wanted than are left."""
        self._left -= operations
        if self._left < 0:
            raise ScriptError(
                "a loop without sync() or another wait, or too much in each cycle: expected at most "
                f"{BURST} operations, turns and calls at once, and {RATE:.0f} in a second"
            )

    def sized(self, value: Any) -> Any:
        """A value, if a script may hold it; its elements are paid for. Raises `ScriptError`."""
        if isinstance(value, list | str):
            count = elements(value, MOST_ELEMENTS)
            if count > MOST_ELEMENTS:
                raise ScriptError(f"expected a value of no more than {MOST_ELEMENTS} elements, found a larger one")
            self.copied += count
            self.spend(count // 4)
        return value


def elements(value: Any, most: int) -> int:
    """Elements of a value, counted as far as `most` and one more. A list that several lists hold counts each time."""
    count, waiting = 0, [value]
    while waiting and count <= most:
        found = waiting.pop()
        if isinstance(found, list):
            count += 1 + len(found)
            if count <= most:
                waiting += [part for part in found if isinstance(part, list | str)]
        elif isinstance(found, str):
            count += len(found) // 8
    return count


def copied(value: Any, level: int = 0) -> Any:
    """A copy, lists within lists too; texts and numbers never change. Raises `ScriptError` for a value too deep."""
    if not isinstance(value, list):
        return value
    if level >= MOST_NESTED:
        raise ScriptError(f"expected no more than {MOST_NESTED} lists within lists, found more")
    return type(value)([copied(part, level + 1) for part in value])
