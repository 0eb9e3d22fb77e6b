"""A rehearsal: whether a controller bears what a real robot does to it, tried in simulation."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.columns import columns
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.drive.drive import steered_controller
from dmframe.drive.identity import Identity, identity
from dmframe.drive.limits import own_limits
from dmframe.drive.record import recording_of
from dmframe.drive.robots import clock_of, simulated_robot, usual_payload
from dmframe.errors import DriveError
from dmframe.results.metrics import tracking_error
from dmframe.runtime.driving import Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.simulate.engine import Choice
from dmframe.units import plain

LONGEST: Final = 40.0
"""What is rehearsed of a longer graph, where nobody says otherwise [s]."""
WORSE: Final = 3.0
"""A condition is borne where its error is at most so many times that without it, or below `SMALL`."""
SMALL: Final = {"m": 2e-3, "rad": 2e-3}
GROWS: Final = 2.0
"""And where its error has grown at most so many times as much as that one, from the second quarter to the last."""
NEEDED: Final = 2
"""Samples of delay that a controller must bear: makers' controllers answer 10 to 35 ms late, and cables do, too."""


@final
@dataclass(frozen=True)
class Condition:
    """What is changed of the ideal robot.

    Parameters
    ----------
    options
        As of `SimulatedRobot`.
    needed
        Whether it must be borne.
    """

    about: str
    options: dict[str, Any]
    needed: bool = True


@final
@dataclass(frozen=True)
class Outcome:
    """What came of a condition.

    Parameters
    ----------
    error
        Root mean square in the last quarter; None where it did not come to its end.
    why
        Why it is not borne; empty where it is.
    """

    condition: Condition
    error: float | None
    why: str


@final
@dataclass(frozen=True, repr=False)
class Rehearsal:
    """A table and a sentence.

    Parameters
    ----------
    unit
        Of the errors.
    seconds
        How long each run was [s].
    asked
        How long it must be to decide anything [s].
    until
        How long the graph is to be driven [s]; of a long one the first `LONGEST` are rehearsed.
    identity
        What it is valid for; None where conditions were chosen by the caller, so that it is valid for no drive.
    field_hash
        `Diagram.fingerprint` of the diagram that was driven.
    """

    name: str
    signal: str
    unit: str
    seconds: float
    asked: float
    outcomes: Sequence[Outcome]
    until: float = 0.0
    identity: Identity | None = None
    field_hash: str = ""

    @property
    def whole(self) -> bool:
        """True where no run was cut short."""
        return self.seconds >= self.asked

    @property
    def passed(self) -> bool:
        """True where everything that must be borne is."""
        return not any(item.why for item in self.outcomes if item.condition.needed)

    @property
    def sentence(self) -> str:
        """Whether this controller may meet a robot."""
        failed = [item for item in self.outcomes if item.why and item.condition.needed]
        if not failed and not self.whole:
            runs, short = plain(self.asked, "s"), plain(self.seconds, "s")
            return f"{self.name} bears what it must for {short}; runs of {runs} decide whether it may meet a robot."
        if not failed:
            return (
                f"{self.name} may meet a robot, as far as a simulation can tell: it was tried on no hardware, and the "
                "gate is not a safety function."
            )
        return f"{self.name} may not meet a robot: it does not bear {failed[0].condition.about} ({failed[0].why})."

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "graph": self.name,
            "field_hash": self.field_hash,
            "passed": self.passed,
            "sentence": self.sentence,
            "seconds": self.seconds,
            "error": self.signal,
            "unit": self.unit,
            "conditions": [
                {
                    "condition": item.condition.about,
                    "needed": item.condition.needed,
                    "rms": item.error,
                    "borne": not item.why,
                    "why": item.why,
                }
                for item in self.outcomes
            ],
        }

    def __repr__(self) -> str:
        return f"<Rehearsal of {self.name}: {'passed' if self.passed else 'not passed'}>"

    def __str__(self) -> str:
        rows = [
            (
                item.condition.about,
                "-" if item.error is None else plain(item.error, self.unit),
                "yes" if not item.why else "NO" if item.condition.needed else "no, not asked for",
                item.why,
            )
            for item in self.outcomes
        ]
        head = (f"{self.name}, {plain(self.seconds, 's')}", f"|{self.signal}| RMS, last quarter", "borne", "")
        return "\n".join([columns([head, *rows], indent="", right=(1,)), self.sentence])


def conditions(clock: float, duration: float, payload: float) -> list[Condition]:
    """What is tried, the ideal robot first."""
    most = plain(clock / 4, "s")
    found = [Condition("nothing, the ideal robot", {})]
    for delay in (1, 2, 3):
        late = plain(delay * clock, "s")
        about = f"{delay} sample{'s' * (delay > 1)} of delay, {late}"
        found.append(Condition(about, {"delay": delay}, needed=delay <= NEEDED))
    found += [
        Condition(f"a jitter of {most}", {"jitter": clock / 4}),
        Condition("1 % of samples lost", {"lost": 0.01}),
        Condition("10 % of samples lost", {"lost": 0.1}, needed=False),
        Condition("half of its speed, from the middle on", {"scaling": 0.5, "slowed_from": duration / 2}),
        Condition("a tenth of its speed, from the middle on", {"scaling": 0.1, "slowed_from": duration / 2}),
        Condition("a sample of delay, a jitter, 1 % lost", {"delay": 1, "jitter": clock / 4, "lost": 0.01}),
    ]
    if payload:
        found.insert(-1, Condition(f"a payload of {plain(payload, 'kg')} that it is not told", {"payload": payload}))
    return found


def rehearsed(
    experiment: Experiment,
    diagram: Diagram,
    *,
    seconds: float | None = None,
    payload: float | None = None,
    limits: Limits | None = None,
    engine: Choice = "auto",
    tell: Callable[[str], None] = lambda _: None,
    tried: Sequence[Condition] | None = None,
) -> Rehearsal:
    """Drive a graph's own robot as it is, then late, with jitter, loaded, slowed down.

    Parameters
    ----------
    seconds
        Of each run; the graph's duration, 40 s at most, without it.
    payload
        A point mass at the tool [kg]; a twentieth of what moves without it.
    limits
        Of the gate, which is the one of a drive.
    tried
        Instead of `conditions`.

    Raises
    ------
    DmframeError
        The graph drives no robot, or follows no path.
    """
    asked = min(experiment.file.duration, LONGEST)
    duration = asked if seconds is None else seconds
    clock, held = clock_of(experiment), limits or own_limits(diagram.robot)
    load = usual_payload(diagram) if payload is None else payload
    given = tried if tried is not None else conditions(clock, duration, load)
    # before the runs: a file that changes meanwhile is not what they rehearse
    parts = identity(experiment, steered_controller(experiment, diagram, engine), held, load) if tried is None else None
    run = functools.partial(_quarters, experiment, diagram, duration, held, engine)
    outcomes, ideal = list[Outcome](), None
    signal = unit = ""
    for condition in given:
        tell(condition.about)
        found = run(condition.options)
        signal, unit = found.signal, found.unit
        ideal = ideal or found  # the first one
        outcomes.append(Outcome(condition, None if found.stopped else found.last, _why(found, ideal)))
    until = experiment.file.duration
    return Rehearsal(experiment.name, signal, unit, duration, asked, outcomes, until, parts, diagram.fingerprint)


@final
@dataclass(frozen=True)
class _Run:
    signal: str
    unit: str
    second: float
    last: float
    stopped: str


def _why(run: _Run, ideal: _Run) -> str:
    """Why a condition is not borne; empty where it is."""
    if run.stopped:
        return run.stopped
    small = SMALL.get(run.unit, 0.0)
    most = max(WORSE * ideal.last, small)
    if not run.last <= most:
        return f"the error is above {plain(most, run.unit)}"
    usual = max(1.0, ideal.last / ideal.second) if ideal.second else 1.0
    if run.last > GROWS * usual * run.second and run.last > small:
        return f"the error grows, from {plain(run.second, run.unit)} in the second quarter"
    return ""


def _quarters(
    experiment: Experiment, diagram: Diagram, duration: float, limits: Limits, engine: Choice, options: dict[str, Any]
) -> _Run:
    """The error of a drive in its second and in its last quarter."""
    steered = steered_controller(experiment, diagram, engine)
    robot = simulated_robot(experiment, diagram, duration, engine, **options)
    plan, gate = Plan(duration), Gate(limits, robot.period)
    found = drive(steered, robot, gate, plan, lambda: "")
    recording = recording_of(diagram, steered, found, robot=robot.name, plan=plan, gate=gate, solver=robot.solver)
    error = tracking_error(recording) if recording is not None else None
    if recording is None or error is None:
        raise DriveError(f"{experiment.name}: expected a graph that follows a path, so that its error can be told")
    squares, times = error.norm**2, recording.time / duration
    second, last = (
        float(np.sqrt(np.mean(squares[part]))) if part.any() else 0.0
        for part in ((times >= 0.25) & (times < 0.5), times >= 0.75)
    )
    stopped = f"stopped after {plain(float(recording.time[-1]), 's')}, {found.stop}" if found.stop else ""
    return _Run(error.signal, error.unit, second, last, stopped)
