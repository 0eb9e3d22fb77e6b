"""``dm.experiment``: an excitation of a robot with which ``dm.identify`` determines its servo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.drive.limits import load_limits
from dmframe.identification.excitation import Excitation, Room, excitation
from dmframe.identification.experiment_files import write_experiment
from dmframe.identification.joint_box import Obstacles, box_around, free_posture
from dmframe.identification.log import Array
from dmframe.identification.model import model_of
from dmframe.identification.predict import Predicted, predicted
from dmframe.identification.subject import Subject, subject_of
from dmframe.identification.twin import twins_of
from dmframe.robot.chain import pin_configuration
from dmframe.runtime.gate import Limits

PERIOD: Final = 0.008
"""Default sampling period [s]."""
PERIODS: Final = (0.0005, 0.05)
"""Range of sampling periods [s]: a servo's delay and gains are invisible at longer ones."""
SECONDS: Final = (6.0, 30.0)
"""Range of durations [s]."""
SPEED: Final = {"revolute": 0.4, "prismatic": 0.1}
"""Fastest steps [rad/s, m/s]."""
SHARE: Final = 0.5
"""Fraction of a joint's velocity limit that steps use."""
CANDIDATES: Final = 4
"""Number of random excitations; the most informative one is proposed."""
POSTURES: Final = 40
"""Random postures in which shapes that always overlap are found."""
TABLE: Final = 0.02
"""Height above which a proposed posture keeps joints and tool, if there is such a posture [m]."""
CHECKED: Final = 0.02
"""Interval at which the path is checked for collisions [s]."""


@final
@dataclass(frozen=True, eq=False)
class Experiment:
    """A proposed excitation.

    Parameters
    ----------
    subject
        The robot.
    room
        The box of joint positions in which it moves, its speeds and accelerations.
    plan
        The commands.
    predicted
        Half intervals that `identify` will give for a nominal servo.
    fastest
        Largest speed of the tool along the commands [m/s].
    notices
        What was not checked.
    """

    subject: Subject
    room: Room
    plan: Excitation
    predicted: Predicted
    fastest: float
    notices: tuple[str, ...]

    @property
    def summary(self) -> dict[str, Any]:
        """The proposal for programs, as ``dmframe experiment --json`` prints it."""
        return {
            "robot": self.subject.chain.name,
            "joints": list(self.subject.chain.joint_names),
            "period": self.plan.period,
            "duration": self.plan.period * (self.plan.count - 1),
            "start": self.room.start.tolist(),
            "box": [self.room.lower.tolist(), self.room.upper.tolist()],
            "speed": np.max(np.abs(self.plan.dq_c), axis=0).tolist(),
            "tool_speed": self.fastest,
            "predicted": {
                "k_P": self.predicted.k_P.tolist(),
                "k_I": self.predicted.k_I.tolist(),
                "delay": self.predicted.delay,
            },
            "notices": list(self.notices),
        }

    def __str__(self) -> str:
        plan, chain = self.plan, self.subject.chain
        lines = [f"notice: {text}" for text in self.notices]
        lines.append(
            f"{chain.name}: {plan.period * (plan.count - 1):g} s at {1000 * plan.period:g} ms; the tool moves at most "
            f"{self.fastest:.2g} m/s"
        )
        speeds = np.max(np.abs(plan.dq_c), axis=0)
        for j, joint in enumerate(chain.joints):
            unit = "rad" if joint.kind == "revolute" else "m"
            lines.append(
                f"{joint.name}: start {self.room.start[j]:.4g} {unit}, between {np.min(plan.q_c[:, j]):.4g} and "
                f"{np.max(plan.q_c[:, j]):.4g} {unit}, at most {speeds[j]:.3g} {unit}/s"
            )
        lines.append(
            "predicted intervals with an encoder of 17 bits and a nominal PID servo: k_P +-"
            + ", ".join(f"{100 * x:.2g}" for x in self.predicted.k_P)
            + " %, k_I +-"
            + ", ".join(f"{100 * x:.2g}" for x in self.predicted.k_I)
            + f" %, delay +-{self.predicted.delay:.2g} samples"
        )
        return "\n".join(lines)


def experiment(
    robot: str,
    *,
    out: str | Path | None = None,
    period: float | None = None,
    seconds: float = 20.0,
    seed: int = 0,
    start: Sequence[float] | None = None,
    limits: str | Path | None = None,
    floor: float | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Experiment:
    """Propose velocity steps of every joint from which `identify` determines a robot's servo.

    The motion begins and ends at rest at the start posture, stays in a box of joint positions and within half of the
    velocity limits. Of several random excitations it is the one with the smallest predicted interval of the worst
    joint's k_P, from the sensitivities of the twin with a nominal servo.

    Parameters
    ----------
    robot
        A robot's name, a URDF, xacro or MJCF file, or a graph whose robot is taken.
    out
        Folder to which ``experiment.csv``, ``experiment.yaml`` and, for six joints, ``experiment.script`` are written.
    period
        Sampling period [s]; by default that of the graph, or 8 ms.
    seconds
        Duration [s], 6 to 30.
    seed
        Seed of the steps.
    start
        (n,), start posture [rad, m]; by default that of the graph, or a dexterous posture.
    limits
        File with tighter limits of position, velocity, acceleration and of the tool, as for ``dmframe drive``.
    floor
        Height in the base frame above which joints and tool stay [m].
    say
        Called with a line of progress.

    Raises
    ------
    DmframeError
        The robot cannot be used, an option is out of range, or no box is free around the start.

    Examples
    --------
    >>> import dmframe as dm
    >>> dm.experiment("ur10_slow", out="e").summary["duration"]     # doctest: +SKIP
    """
    subject = subject_of(robot)
    if period is None:
        period = subject.period if subject.period is not None and subject.period <= PERIODS[1] else PERIOD
    _in_range("period", period, PERIODS, "s")
    _in_range("seconds", seconds, SECONDS, "s")
    if seed < 0:
        raise ValueFault(f"seed: expected a whole number of 0 or above, found {seed}")
    chain = subject.chain
    obstacles = Obstacles(chain, subject.shapes, floor)
    room = _room(subject, start, None if limits is None else load_limits(limits, chain), obstacles, seed)
    twins = twins_of(model_of(chain))
    best: tuple[float, Excitation, Predicted] | None = None
    for attempt in range(CANDIDATES):
        say(f"candidate {attempt + 1} of {CANDIDATES}")
        plan = excitation(room, period, seconds, [seed, attempt])
        if any(obstacles.hit(q) for q in plan.q_c[:: max(1, round(CHECKED / period))]):
            continue
        found = predicted(twins, plan)
        worst = float(np.max(found.k_P))
        if best is None or worst < best[0]:
            best = worst, plan, found
    if best is None:
        raise ValueFault("start: the steps collide; choose another posture with --start, or another --seed")
    _, plan, found = best
    notes = () if out is None else write_experiment(subject, plan, Path(out))
    return Experiment(subject, room, plan, found, _tool_speed(subject, plan), (*obstacles.notes, *notes))


def _in_range(name: str, value: float, ends: tuple[float, float], unit: str) -> None:
    if not ends[0] <= value <= ends[1]:
        raise ValueFault(f"{name}: expected {ends[0]:g} to {ends[1]:g} {unit}, found {value:g}")


def _room(
    subject: Subject, start: Sequence[float] | None, limits: Limits | None, obstacles: Obstacles, seed: int
) -> Room:
    """Box, speeds and accelerations, inside the limits."""
    chain = subject.chain
    q = subject.start if start is None else np.asarray(start, dtype=float)
    if q.shape != (chain.n,) or not np.all(np.isfinite(q)):
        raise ValueFault(f"start: expected {chain.n} finite joint positions, found {list(q.ravel())}")
    lower, upper = (np.array([float(getattr(joint, end)) for joint in chain.joints]) for end in ("lower", "upper"))
    speed = np.array([SPEED[joint.kind] for joint in chain.joints])
    own = np.array([joint.velocity if joint.velocity > 0 else np.inf for joint in chain.joints])
    acceleration = np.full(chain.n, np.inf)
    hit: Callable[[Array], str] = obstacles.hit
    if limits is not None:
        lower, upper, own = limits.lower, limits.upper, limits.speed
        acceleration = np.full(chain.n, np.inf) if limits.acceleration is None else limits.acceleration
        hit = _within(limits.box, subject, obstacles.hit)
    random = np.random.default_rng(seed)
    ends = np.clip(np.array([lower, upper]), -np.pi, np.pi)
    obstacles.without_overlaps([random.uniform(*ends) for _ in range(POSTURES)])
    if start is None and not subject.own:  # a proposed posture
        floor, obstacles.floor = obstacles.floor, TABLE if obstacles.floor is None else obstacles.floor
        found = free_posture(chain, q, lower, upper, hit)
        q = q if found is None else found
        obstacles.floor = floor
    low, high = box_around(chain, q, lower, upper, hit, seed)
    return Room(q, low, high, np.minimum(speed, SHARE * own), acceleration)


def _within(box: Array | None, subject: Subject, hit: Callable[[Array], str]) -> Callable[[Array], str]:
    """A check that also keeps the tool in a box of its task coordinates (2, m)."""
    if box is None:
        return hit
    import pinocchio as pin

    chain, data = subject.chain, subject.chain.model.createData()
    places = ["xyz".index(axis) for axis in chain.axes]

    def both(q: Array) -> str:
        pin.framesForwardKinematics(chain.model, data, pin_configuration(chain, q))
        x = data.oMf[chain.model_tool].translation[places]
        return hit(q) if np.all((box[0] <= x) & (x <= box[1])) else "the tool's box"

    return both


def _tool_speed(subject: Subject, plan: Excitation) -> float:
    import pinocchio as pin

    chain, fastest = subject.chain, 0.0
    data = chain.model.createData()
    for k in range(0, plan.count, max(1, round(CHECKED / plan.period))):
        q = pin_configuration(chain, plan.q_c[k])
        pin.forwardKinematics(chain.model, data, q, plan.dq_c[k])
        pin.updateFramePlacements(chain.model, data)
        moved = pin.getFrameVelocity(chain.model, data, chain.model_tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        fastest = max(fastest, float(np.linalg.norm(moved.linear)))
    return fastest
