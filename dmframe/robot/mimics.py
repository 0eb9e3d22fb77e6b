"""Mimic joints of a URDF: q = multiplier q_leader + offset."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple, final

from dmframe.common.errors import RobotError

SAME = 1e-9
"""Tolerance between a held angle and the one that the leader determines [rad or m]."""


@final
class Mimic(NamedTuple):
    """Law of a mimic joint."""

    leader: str
    multiplier: float
    offset: float


def with_mimics(
    mimics: Mapping[str, Mimic], hold: Mapping[str, float], kept: Collection[str], where: str
) -> dict[str, float]:
    """Angles of held joints, including mimic joints; a joint without an angle is held at 0.

    Raises
    ------
    RobotError
        A mimic joint follows a free joint, is held at another angle than its leader determines, or follows itself.
    """
    found = dict(hold)
    for name, law in mimics.items():
        if name in kept:
            continue
        follows, scale, offset, seen = law.leader, law.multiplier, law.offset, {name}
        while follows in mimics and follows not in hold:
            if follows in seen:
                raise RobotError(f"{where}: joint {name} follows itself through {follows}", path=("robot", "model"))
            seen.add(follows)
            above = mimics[follows]
            follows, scale, offset = above.leader, scale * above.multiplier, offset + scale * above.offset
        if follows in kept:
            if name in hold:
                continue
            raise RobotError(
                f"{where}: joint {name} follows {follows}, which is free; hold {follows}, or {name} at an angle",
                path=("robot", "free"),
            )
        place = scale * hold.get(follows, 0.0) + offset
        if name in hold and follows in hold and not math.isclose(hold[name], place, abs_tol=SAME):
            raise RobotError(
                f"{where}: joint {name} follows {follows}: expected it held at {place:.6g}, found {hold[name]:.6g}; "
                f"omit {name}",
                path=("robot", "hold"),
            )
        found.setdefault(name, place)
    return found
