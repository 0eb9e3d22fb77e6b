"""Gate between controller and robot: checks samples, limits commands, and stops the robot.

The gate is not a safety function. Safety requires the robot's safety configuration and a risk assessment.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, final

import numpy as np

from dmframe.common.units import plain
from dmframe.runtime.robot import Sample

REFUSED: Final = 3.0
"""Multiple of a joint's speed limit above which a command stops the robot instead of being limited."""
MOST_CUTS: Final = 50
"""Consecutive limited commands that stop the robot."""
_ROUNDING: Final = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the gate; arrays are (n,), by joint.

    Parameters
    ----------
    joints
        Names of the joints.
    lower, upper
        Limits of the joint angles [rad].
    speed
        Limits of commands [rad/s].
    acceleration
        Limits of the change of commands [rad/s^2]; None for no limit.
    deceleration
        Deceleration before joint limits, at the end, and after a stop request [rad/s^2].
    halt
        Deceleration after a fault, if larger than `deceleration` [rad/s^2].
    deviation
        Largest difference between measured and target angles [rad].
    lost
        Largest number of consecutive lost samples.
    box
        (2, m) least and largest coordinates of the tool [m]; None for no limit.
    """

    joints: Sequence[str]
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray | None = None
    deceleration: float = 2.0
    halt: float = 20.0
    deviation: float = 0.2
    lost: int = 5
    box: np.ndarray | None = None

    @property
    def data(self) -> dict[str, Any]:
        """JSON representation; floats are texts, which are exact and may be infinite."""
        return {key: _texts(value) for key, value in vars(self).items()}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Limits:
        """Inverse of `data`. Raises `ValueError`, `TypeError` or `KeyError` for invalid data."""
        known = {each.name for each in fields(cls)}
        if known != set(data):
            raise ValueError(f"expected {', '.join(sorted(known))}")
        joints, arrays = list(data["joints"]), ("lower", "upper", "speed", "acceleration", "box")
        made = {key: None if data[key] is None else np.array(data[key], dtype=float) for key in arrays}
        numbers = {key: float(data[key]) for key in ("deceleration", "halt", "deviation")}
        return cls(joints=joints, lost=int(data["lost"]), **numbers, **made)  # type: ignore[arg-type]


def _texts(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_texts(item) for item in value]
    return repr(value) if isinstance(value, float) else value


@final
@dataclass(frozen=True)
class Stop:
    """Reason of a stop: the rule, and the value that violated it."""

    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.text}"


@final
class Gate:
    """Rules in the order of their evaluation; `admit` checks samples (1 to 5), `limited` commands (6 to 11).

    1. the robot is ready and reports no fault;
    2. its sample is finite;
    3. the number of consecutive lost samples is within the limit;
    4. each joint is close to its target;
    5. the tool is in its box;
    6. the command is finite;
    7. the command is at most `REFUSED` times the speed limits;
    8. a command above the speed limits is scaled, its direction unchanged;
    9. the speed near a joint limit allows braking before it;
    10. the change of commands is limited by the acceleration;
    11. rules 8 to 10 limit fewer than `MOST_CUTS` consecutive commands.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self.limits, self.period = limits, period
        self.cuts = Counter[str]()
        """Number of commands that each rule has limited."""
        self._last, self._row = np.zeros(len(limits.joints)), 0
        self._near = (np.full(len(limits.joints), math.inf), np.full(len(limits.joints), -math.inf))  # far from limits
        self._by = ""

    def admit(self, sample: Sample) -> Stop | None:
        """Apply rules 1 to 5; return why the robot must stop, or None."""
        limits = self.limits
        if sample.fault:
            return Stop("robot", sample.fault)
        if not sample.ready:
            return Stop("robot", "it is not ready to move")
        given = {"q": sample.q, "dq": sample.dq, "q_c": sample.q_c, "x": sample.x}
        for name, values in given.items():
            if values is not None and not np.isfinite(values).all():
                return Stop("not finite", f"invalid sample: {name} = {values.tolist()}")
        if not (math.isfinite(sample.time) and math.isfinite(sample.scaling) and 0 <= sample.scaling <= 1):
            return Stop("not finite", f"invalid sample: time = {sample.time} s, speed scaling = {sample.scaling}")
        if sample.missed > limits.lost:
            return Stop("lost samples", f"{sample.missed} in a row, at most {limits.lost} are allowed")
        if sample.q_c is not None:
            deviation = np.abs(sample.q - sample.q_c)
            worst = int(np.argmax(deviation))
            if deviation[worst] > limits.deviation:
                return Stop(
                    "deviation",
                    f"{limits.joints[worst]} is {plain(deviation[worst], 'rad')} from its target, "
                    f"at most {plain(limits.deviation, 'rad')} is allowed",
                )
        if limits.box is not None and sample.x is not None:
            for axis, (x, least, most) in enumerate(zip(sample.x, *limits.box, strict=True)):
                if not least <= x <= most:
                    return Stop(
                        "workspace",
                        f"coordinate {axis + 1} of the tool is at {plain(x, 'm', 4)}, "
                        f"its box is {plain(least, 'm', 4)} to {plain(most, 'm', 4)}",
                    )
        q_c = sample.q if sample.q_c is None else sample.q_c
        self._near = (np.minimum(sample.q, q_c), np.maximum(sample.q, q_c))
        return None

    def begins(self, q: np.ndarray) -> Stop | None:
        """Check the start pose; return why the drive must not begin, or None. Rule 9 does not stop the robot."""
        for name, angle, least, most in zip(self.limits.joints, q, self.limits.lower, self.limits.upper, strict=True):
            if not least <= angle <= most:
                return Stop(
                    "joint limit",
                    f"{name} would start at {plain(angle, 'rad')}, its limits are {plain(least, 'rad')} to "
                    f"{plain(most, 'rad')}",
                )
        return None

    def limited(self, command: np.ndarray, out: np.ndarray, missed: int = 0) -> Stop | None:
        """Apply rules 6 to 11, and write the limited command to `out`; return why the robot must stop, or None."""
        limits, T = self.limits, self.period
        if not np.isfinite(command).all():
            return Stop("command not finite", f"{command.tolist()} rad/s")
        ratio = np.abs(command) / limits.speed
        worst = int(np.argmax(ratio))
        if ratio[worst] > REFUSED:
            return Stop(
                "command too fast",
                f"{limits.joints[worst]} is commanded {plain(abs(command[worst]), 'rad/s')}, above "
                f"{REFUSED:g} times its limit of {plain(limits.speed[worst], 'rad/s')}",
            )
        out[:] = command
        cut = False
        if ratio[worst] > 1 + _ROUNDING:
            out /= ratio[worst]
            cut = self._noted("speed")
        # the distance that remains after this period must suffice for braking: v T + v^2 / (2 a) = room
        a = limits.deceleration if limits.acceleration is None else np.minimum(limits.deceleration, limits.acceleration)
        least, most = (
            np.sqrt((a * T) ** 2 + 2 * a * np.maximum(room, 0)) - a * T
            for room in (self._near[0] - limits.lower, limits.upper - self._near[1])
        )
        if (out < -least - _ROUNDING).any() or (out > most + _ROUNDING).any():
            np.clip(out, -least, most, out=out)
            cut = self._noted("joint limit")
        if limits.acceleration is not None:
            change = limits.acceleration * T * (1 + missed)
            if (np.abs(out - self._last) > change + _ROUNDING).any():
                np.clip(out, self._last - change, self._last + change, out=out)
                cut = self._noted("acceleration")
        self._last[:] = out
        self._row = self._row + 1 if cut else 0
        if self._row >= MOST_CUTS:
            return Stop("cuts", f"{MOST_CUTS} commands in a row were limited, the last one by {self._by}")
        return None

    def _noted(self, rule: str) -> bool:
        self.cuts[rule] += 1
        self._by = rule
        return True
