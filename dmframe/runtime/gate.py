"""What may pass from a controller to a robot, and when it is stopped instead.

It is not a safety function: that is the robot maker's safety configuration, and a risk assessment.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, final

import numpy as np

from dmframe.runtime.robot import Sample
from dmframe.units import plain

REFUSED: Final = 3.0
"""A command above so many times a joint's speed limit is a fault, and is not cut but refused."""
MOST_CUTS: Final = 50
"""After so many samples in a row whose commands were cut, the controller does not do what it believes to do."""
_ROUNDING: Final = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Limits:
    """What the gate holds a robot to; (n,) each, by joint.

    Parameters
    ----------
    lower, upper
        Of the joints [rad].
    speed
        Of commands [rad/s].
    acceleration
        Of commands [rad/s^2]; None for any.
    deceleration
        With which joints brake before their limits, and the robot at the end and where a stop is asked for [rad/s^2].
    halt
        With which the robot stops after a fault, where that is more [rad/s^2].
    deviation
        Between measured and target angles at most [rad].
    lost
        Samples in a row that may be lost.
    box
        (2, m), the least and the largest coordinates of the tool [m]; None for any.
    joints
        Their names.
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
        """As JSON can hold it; numbers as texts, which give the same bits again, infinite ones too."""
        return {key: _texts(value) for key, value in vars(self).items()}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Limits:
        """From `data`. Raises `ValueError`, `TypeError` or `KeyError` for what is none."""
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
    """Why a robot is stopped: the rule in a word or two, and what was found."""

    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.text}"


@final
class Gate:
    """The rules, in this order: `admit` those of a sample, `limited` those of a command.

    1. the robot is ready and tells no fault;
    2. its sample is finite;
    3. no more samples in a row were lost than may be;
    4. no joint is far from its target;
    5. the tool is in its box;
    6. the command is finite;
    7. and not far above the speed limits;
    8. above them it is scaled, its direction kept;
    9. a joint near its limit is as slow as it can still brake;
    10. commands change as fast as the acceleration allows;
    11. not too many commands in a row were cut by 8, 9 or 10.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self.limits, self.period = limits, period
        self.cuts = Counter[str]()
        """How many commands each rule has cut."""
        self._last, self._row = np.zeros(len(limits.joints)), 0
        self._near = (np.full(len(limits.joints), math.inf), np.full(len(limits.joints), -math.inf))  # far from limits
        self._by = ""

    def admit(self, sample: Sample) -> Stop | None:
        """Rules 1 to 5; None for a sample to which the controller may answer."""
        limits = self.limits
        if sample.fault:
            return Stop("robot", sample.fault)
        if not sample.ready:
            return Stop("robot", "it is not ready to move")
        given = {"q": sample.q, "dq": sample.dq, "q_c": sample.q_c, "x": sample.x}
        for name, values in given.items():
            if values is not None and not np.isfinite(values).all():
                return Stop("not finite", f"the robot tells {name} = {values.tolist()}")
        if not (math.isfinite(sample.time) and math.isfinite(sample.scaling) and 0 <= sample.scaling <= 1):
            return Stop("not finite", f"the robot tells a time of {sample.time} s and a scaling of {sample.scaling}")
        if sample.missed > limits.lost:
            return Stop("lost samples", f"{sample.missed} in a row, at most {limits.lost} may be")
        if sample.q_c is not None:
            apart = np.abs(sample.q - sample.q_c)
            worst = int(np.argmax(apart))
            if apart[worst] > limits.deviation:
                return Stop(
                    "deviation",
                    f"{limits.joints[worst]} is {plain(apart[worst], 'rad')} from its target, "
                    f"at most {plain(limits.deviation, 'rad')} may be",
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
        """None where a drive may begin at q: rule 9 only slows down what is beyond a limit already."""
        for name, angle, least, most in zip(self.limits.joints, q, self.limits.lower, self.limits.upper, strict=True):
            if not least <= angle <= most:
                return Stop(
                    "joint limit",
                    f"{name} would start at {plain(angle, 'rad')}, its limits are {plain(least, 'rad')} to "
                    f"{plain(most, 'rad')}",
                )
        return None

    def limited(self, command: np.ndarray, out: np.ndarray, missed: int = 0) -> Stop | None:
        """Rules 6 to 11; what may be sent is written to `out`. None, or why nothing may."""
        limits, T = self.limits, self.period
        if not np.isfinite(command).all():
            return Stop("command not finite", f"{command.tolist()} rad/s")
        share = np.abs(command) / limits.speed
        worst = int(np.argmax(share))
        if share[worst] > REFUSED:
            return Stop(
                "command too fast",
                f"{limits.joints[worst]} is told to move at {plain(abs(command[worst]), 'rad/s')}, above "
                f"{REFUSED:g} times its limit of {plain(limits.speed[worst], 'rad/s')}",
            )
        out[:] = command
        cut = False
        if share[worst] > 1 + _ROUNDING:
            out /= share[worst]
            cut = self._noted("speed")
        # what is left after this period must still be enough to brake in: v T + v^2 / (2 a) = room
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
            return Stop("cuts", f"{MOST_CUTS} commands in a row were cut, last by {self._by}")
        return None

    def _noted(self, rule: str) -> bool:
        self.cuts[rule] += 1
        self._by = rule
        return True
