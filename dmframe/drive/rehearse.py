"""A rehearsal: whether a controller bears what a real robot does to it, tried in simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from dmframe.columns import columns
from dmframe.config.experiment import Experiment
from dmframe.config.sections import tolerance_in
from dmframe.diagram import Diagram
from dmframe.drive.bar import Bar, Measured, farthest, quarters
from dmframe.drive.drive import steered_controller
from dmframe.drive.identity import Identity, identity
from dmframe.drive.limits import own_limits
from dmframe.drive.record import recording_of
from dmframe.drive.rival import Law, Rival, law_of
from dmframe.drive.robots import clock_of, simulated_robot, usual_payload
from dmframe.errors import DriveError
from dmframe.results.metrics import euclidean, tracking_error
from dmframe.runtime.driving import Driven, Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.simulated import SimulatedRobot
from dmframe.simulate.engine import Choice
from dmframe.units import plain

IDEAL: Final = "the ideal robot"
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
    rival, still
        The error of the kinematic inverse of J under this condition, and of a robot that holds still; None where there
        is no fair rival, or it did not come to its end.
    """

    condition: Condition
    error: float | None
    why: str
    rival: float | None = None
    still: float | None = None


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
    bar
        What the errors were compared with.
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
    bar: Bar = field(default_factory=Bar)

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
        first, why = failed[0].condition, failed[0].why
        told = f"it does not bear {first.about} ({why})" if first.options else f"on {IDEAL}, {why}"
        return f"{self.name} may not meet a robot: {told}."

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
            "tolerance": self.bar.tolerance,
            "rival": self.bar.rival or None,
            "no_rival": self.bar.lacking or None,
            "conditions": [
                {
                    "condition": item.condition.about,
                    "needed": item.condition.needed,
                    "rms": item.error,
                    "rival": item.rival,
                    "still": item.still,
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
                *("-" if value is None else plain(value, self.unit) for value in (item.error, item.rival)),
                "yes" if not item.why else "NO" if item.condition.needed else "no, not asked for",
                item.why,
            )
            for item in self.outcomes
        ]
        head = (f"{self.name}, {plain(self.seconds, 's')}", f"|{self.signal}| RMS, last quarter", "rival", "borne", "")
        table = columns([head, *rows], indent="", right=(1, 2))
        return "\n".join([table, *self._notes(), self.sentence])

    def _notes(self) -> Iterator[str]:
        still = self.outcomes[0].still if self.outcomes else None
        rival = self.bar.rival or f"none ({self.bar.lacking})"
        held = f"; holding still: {plain(still, self.unit)}" if still is not None else ""
        yield f"rival: {rival}{held}"
        if self.bar.tolerance is not None:
            yield f"tolerance of the graph: {plain(self.bar.tolerance, self.unit)}"


def conditions(clock: float, duration: float, payload: float) -> list[Condition]:
    """What is tried, the ideal robot first."""
    most = plain(clock / 4, "s")
    found = [Condition(f"nothing, {IDEAL}", {})]
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
    law, lacking = law_of(experiment, diagram)
    trial = _Trial(experiment, diagram, duration, held, engine, law)
    outcomes, ideal, bar = list[Outcome](), None, Bar(lacking=lacking)
    signal = unit = ""
    for condition in given:
        tell(condition.about)
        found, rival = trial.measured(condition.options), trial.rival(condition.options)
        if ideal is None:  # the first one
            ideal, signal, unit = found, found.signal, found.unit
            stated = tolerance_in(unit, experiment.file, experiment.document)
            bar = Bar(stated, str(law) if law is not None else "", lacking)
        why = found.stopped or bar.above(found, rival, ideal=ideal is found) or _why(found, ideal)
        error, other = (None if each is None or each.stopped else each.last for each in (found, rival))
        outcomes.append(Outcome(condition, error, why, other, found.still))
    until = experiment.file.duration
    field = diagram.fingerprint
    return Rehearsal(experiment.name, signal, unit, duration, asked, outcomes, until, parts, field, bar)


def _why(run: Measured, ideal: Measured) -> str:
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


@final
@dataclass(frozen=True)
class _Trial:
    """Drives a graph's own robot under a condition, with the graph's controller and with a rival."""

    experiment: Experiment
    diagram: Diagram
    duration: float
    limits: Limits
    engine: Choice
    law: Law | None

    def measured(self, options: dict[str, Any]) -> Measured:
        """The errors of the graph's controller."""
        steered = steered_controller(self.experiment, self.diagram, self.engine)
        found, robot, gate = self._driven(steered, options)
        plan = Plan(self.duration)
        recording = recording_of(
            self.diagram, steered, found, robot=robot.name, plan=plan, gate=gate, solver=robot.solver
        )
        error = tracking_error(recording) if recording is not None else None
        if recording is None or error is None:
            raise DriveError(
                f"{self.experiment.name}: expected a graph that follows a path, so that its error can be told"
            )
        still = recording[error.actual][0] - recording[error.desired]
        shares, still = recording.time / self.duration, euclidean(still)
        stopped = _stopped(found, float(recording.time[-1]))
        parts = quarters(shares, error.norm, still)
        return Measured(error.signal, error.unit, *parts, stopped, farthest(shares, still))

    def rival(self, options: dict[str, Any]) -> Measured | None:
        """Those of the rival; None where there is no fair one."""
        if self.law is None:
            return None
        robot = self.diagram.robot
        found, _, _ = self._driven(Rival(self.law, robot.n, clock_of(self.experiment)), options)
        journal, name = found.journal, "q" if self.law.shown is None else "x"
        times = np.array(journal.reference)
        shown = np.array([getattr(sample, name) for sample in journal.samples])
        wanted = np.array([self.law.goal(t)[0].full().ravel() for t in times])
        parts = quarters(times / self.duration, euclidean(shown - wanted), euclidean(shown[0] - wanted))
        return Measured("", "", *parts, _stopped(found, float(times[-1])))

    def _driven(self, steered: Any, options: dict[str, Any]) -> tuple[Driven, SimulatedRobot, Gate]:
        robot = simulated_robot(self.experiment, self.diagram, self.duration, self.engine, **options)
        gate = Gate(self.limits, robot.period)
        return drive(steered, robot, gate, Plan(self.duration), lambda: ""), robot, gate


def _stopped(found: Driven, time: float) -> str:
    return f"stopped after {plain(time, 's')}, {found.stop}" if found.stop else ""
