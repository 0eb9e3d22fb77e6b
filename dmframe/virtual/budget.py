"""Resource limits of a script, so that no script stops the robot for other clients."""

from __future__ import annotations

from typing import Any, Final, final

from dmframe.virtual.words import ScriptError

MOST_ELEMENTS: Final = 10_000
"""Elements of one value, including those of nested lists; eight characters of a text count as one."""
MOST_NESTED: Final = 20
"""Nesting depth of lists."""
MOST_STORED: Final = 200_000
"""Elements of all variables of a script, including those of active calls."""
MOST_THREADS: Final = 50
"""Threads of a script."""
MOST_SECONDARY: Final = 8
"""Secondary programs that run at the same time."""
SECONDARY_FRACTION: Final = 1 / MOST_SECONDARY
"""Operation budget of a secondary program, as a fraction of the main program's."""
BURST: Final = 20_000
"""Operations without a wait. One operation is a loop iteration, a call, or four elements: about 2 us."""
RATE: Final = 200_000.0
"""Average operations in a second of the robot's time: less than half of the cycle time."""
LEAST_BURST: Final = 1_000
"""Operations with which a program begins at least."""
BURSTS: Final = 4 * BURST
"""Operations with which programs in close succession begin together."""
COUNTED: Final = MOST_STORED
"""Copied elements between two counts of the stored elements."""

INVERSE: Final = 50
"""Operations of one step of the inverse kinematics."""
COSTS: Final = {
    **dict.fromkeys(("movej", "movel", "servoj", "socket_open"), 200),
    **dict.fromkeys("pose_add pose_sub pose_trans pose_inv pose_dist point_dist get_forward_kin".split(), 30),
    **dict.fromkeys("get_actual_tcp_pose get_target_tcp_pose get_actual_tcp_speed get_target_tcp_speed".split(), 30),
    **dict.fromkeys("socket_send_string socket_send_line textmsg popup norm".split(), 10),
}
"""Operations that a call of a function costs, without its arguments; 1 for other functions."""


@final
class Budget:
    """Budget of operations, or of words (token bucket).

    Parameters
    ----------
    refill
        Amount that each cycle adds.
    begin, most
        Amount at the beginning, and at most.
    """

    def __init__(self, refill: float, begin: float = BURST, most: float = BURST) -> None:
        self.left, self._refill, self._most, self.copied = begin, refill, most, 0

    def cycle(self) -> None:
        """Refill the budget at the beginning of a cycle."""
        self.left = min(self._most, self.left + self._refill)

    def spend(self, operations: int) -> None:
        """Take operations. Raises `ScriptError` if they exceed the budget."""
        self.left -= operations
        if self.left < 0:
            raise ScriptError(
                "a loop without sync() or another wait, or too many operations in each cycle: expected at most "
                f"{BURST} operations (loop iterations, calls) without a wait, and {RATE:.0f} in a second"
            )

    def drawn(self) -> float:
        """Take the operations with which a program begins."""
        found = min(max(self.left, LEAST_BURST), BURST)
        self.left = max(self.left - found, 0.0)
        return found

    def sized(self, value: Any) -> Any:
        """Check a value's size and take its elements from the budget. Raises `ScriptError`."""
        if isinstance(value, list | str):
            count = elements(value, MOST_ELEMENTS)
            if count > MOST_ELEMENTS:
                raise ScriptError(f"expected a value of no more than {MOST_ELEMENTS} elements, found a larger one")
            self.copied += count
            self.spend(count // 4)
        return value


def weight(value: Any) -> int:
    """Operations that a function needs to read an argument."""
    if isinstance(value, list):
        return elements(value, MOST_ELEMENTS) // 2
    return len(value) // 512 if isinstance(value, str) else 0


def elements(value: Any, most: int) -> int:
    """Count the elements of a value, up to `most` + 1. A list that occurs several times counts each time."""
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
    """Copy a value deeply. Raises `ScriptError` for lists that are nested too deeply."""
    if not isinstance(value, list):
        return value
    if level >= MOST_NESTED:
        raise ScriptError(f"expected no more than {MOST_NESTED} nested lists, found more")
    return type(value)([copied(part, level + 1) for part in value])
