"""Rehearsal: simulation of a controller with the non-idealities of a real robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from dmframe.common.columns import columns
from dmframe.common.errors import DriveError
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.config.sections import tolerance_in
from dmframe.drive.drive import RAMP, scaled_controller
from dmframe.drive.error_bounds import ErrorBounds, Measured, farthest, quarters
from dmframe.drive.identity import Identity, identity
from dmframe.drive.limits import own_limits
from dmframe.drive.record import recording_of
from dmframe.drive.rival import Law, Rival, law_of
from dmframe.drive.robots import clock_of, simulated_robot, usual_payload
from dmframe.results.metrics import euclidean, goal_of, tracking_error
from dmframe.runtime.driving import DriveResult, Plan, drive
from dmframe.runtime.gate import Gate, Limits
from dmframe.runtime.scaled import ScaledController
from dmframe.runtime.simulated import SimulatedRobot
from dmframe.simulate.engine import Choice

IDEAL: Final = "the ideal robot"
LONGEST: Final = 40.0
"""Default duration of a rehearsal of a longer graph [s]."""
WORSE: Final = 3.0
"""Largest error under a condition, as a multiple of the ideal robot's error, unless it is below `SMALL`."""
SMALL: Final = {"m": 2e-3, "rad": 2e-3}
GROWS: Final = 2.0
"""Largest growth of the error from the second quarter to the last, as a multiple of the ideal robot's growth."""
NEEDED: Final = 2
"""Required robustness to delay [samples]: robot controllers have a latency of 10 to 35 ms."""


@final
@dataclass(frozen=True)
class Condition:
    """Change of the ideal robot.

    Parameters
    ----------
    options
        Options of `SimulatedRobot`.
    needed
        True if the controller must pass under this condition.
    ramp
        Time in which the first motion accelerates [s].
    """

    about: str
    options: dict[str, Any]
    needed: bool = True
    ramp: float = 0.0


@final
@dataclass(frozen=True)
class Outcome:
    """Result under a condition.

    Parameters
    ----------
    error
        RMS error in the last quarter; None if the run was stopped.
    why
        Reason of a failure; empty if the controller passed.
    rival, still
        Errors of the kinematic inverse of J under this condition, and of a stationary robot; None if no rival is
        applicable, or its run was stopped.
    """

    condition: Condition
    error: float | None
    why: str
    rival: float | None = None
    still: float | None = None


@final
@dataclass(frozen=True, repr=False)
class Rehearsal:
    """Result of a rehearsal: a table and a sentence.

    Parameters
    ----------
    unit
        Unit of the errors.
    seconds
        Duration of each run [s].
    required
        Duration that a valid rehearsal needs [s].
    until
        Duration of the graph [s]; of a long graph, the first `LONGEST` are rehearsed.
    identity
        Identity for which the rehearsal is valid; None if the caller chose the conditions: valid for no drive.
    field_hash
        `Diagram.fingerprint` of the diagram.
    bar
        Reference values of the errors.
    """

    name: str
    signal: str
    unit: str
    seconds: float
    required: float
    outcomes: Sequence[Outcome]
    until: float = 0.0
    identity: Identity | None = None
    field_hash: str = ""
    bar: ErrorBounds = field(default_factory=ErrorBounds)

    @property
    def whole(self) -> bool:
        """True if the runs are long enough."""
        return self.seconds >= self.required

    @property
    def passed(self) -> bool:
        """True if the controller passed under all needed conditions."""
        return not any(item.why for item in self.outcomes if item.condition.needed)

    @property
    def sentence(self) -> str:
        """Conclusion: whether this controller may drive a robot."""
        failed = [item for item in self.outcomes if item.why and item.condition.needed]
        if not failed and not self.whole:
            runs, short = plain(self.required, "s"), plain(self.seconds, "s")
            return f"{self.name} passes for {short}; a rehearsal with runs of {runs} is required to drive a robot."
        if not failed:
            return (
                f"{self.name} passes the rehearsal and may drive a robot. It was not tested on hardware, and the gate "
                "is not a safety function."
            )
        first, why = failed[0].condition, failed[0].why
        reason = f"it fails with {first.about} ({why})" if first.options else f"on {IDEAL}, {why}"
        return f"{self.name} may not drive a robot: {reason}."

    @property
    def summary(self) -> dict[str, Any]:
        """JSON data."""
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
                "yes" if not item.why else "NO" if item.condition.needed else "no, not required",
                item.why,
            )
            for item in self.outcomes
        ]
        head = (f"{self.name}, {plain(self.seconds, 's')}", f"|{self.signal}| RMS, last quarter", "rival", "passed", "")
        table = columns([head, *rows], indent="", right=(1, 2))
        return "\n".join([table, *self._notes(), self.sentence])

    def _notes(self) -> Iterator[str]:
        still = self.outcomes[0].still if self.outcomes else None
        rival = self.bar.rival or f"none ({self.bar.lacking})"
        stationary = f"; stationary robot: {plain(still, self.unit)}" if still is not None else ""
        yield f"rival: {rival}{stationary}"
        if self.bar.tolerance is not None:
            yield f"tolerance of the graph: {plain(self.bar.tolerance, self.unit)}"


def conditions(clock: float, duration: float, payload: float, ramp: float) -> list[Condition]:
    """Conditions of a rehearsal, the ideal robot first."""
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
        Condition("half of its speed, second half", {"scaling": 0.5, "slowed_from": duration / 2}),
        Condition("a tenth of its speed, second half", {"scaling": 0.1, "slowed_from": duration / 2}),
        Condition("a sample of delay, a jitter, 1 % lost", {"delay": 1, "jitter": clock / 4, "lost": 0.01}),
    ]
    if ramp:
        found.insert(-1, Condition(f"a ramp of {plain(ramp, 's')}", {}, ramp=ramp))
    if payload:
        found.insert(-1, Condition(f"an unmodelled payload of {plain(payload, 'kg')}", {"payload": payload}))
    return found


def rehearsed(
    graph: BaseGraph,
    *,
    seconds: float | None = None,
    payload: float | None = None,
    limits: Limits | None = None,
    ramp: float | None = None,
    patience: float | None = None,
    engine: Choice = "auto",
    report: Callable[[str], None] = lambda _: None,
    tried: Sequence[Condition] | None = None,
) -> Rehearsal:
    """Drive a graph's robot in simulation: ideal, then with delay, jitter, a payload, and speed scaling.

    Parameters
    ----------
    seconds
        Duration of each run; by default the graph's, at most 40 s.
    payload
        Point mass at the tool [kg]; by default a twentieth of the moving mass.
    limits
        Limits of the gate, as for a drive.
    ramp
        Time in which the first motion of the drive accelerates [s], as under one condition; by default `RAMP`.
    patience
        Timeout of a sample in the drive [s], which no simulated robot reaches.
    report
        Called with the description of each condition before its run.
    tried
        Conditions to use instead of `conditions`.

    Raises
    ------
    DmframeError
        The graph cannot drive a robot, or does not follow a path.
    """
    required = min(graph.file.duration, LONGEST)
    duration = required if seconds is None else seconds
    clock, limits = clock_of(graph), limits or own_limits(graph.diagram.robot)
    ramp = RAMP if ramp is None else ramp
    load = usual_payload(graph.diagram) if payload is None else payload
    given = tried if tried is not None else conditions(clock, duration, load, ramp)
    parts = None
    if tried is None:  # before the runs, since a file may change meanwhile
        scaled = scaled_controller(graph, engine)
        parts = identity(graph, scaled, limits, payload=load, ramp=ramp, patience=patience)
    law, lacking = law_of(graph)
    trial = _Trial(graph, duration, limits, engine, law)
    outcomes, ideal, bar = list[Outcome](), None, ErrorBounds(lacking=lacking)
    signal = unit = ""
    for condition in given:
        report(condition.about)
        found, rival = trial.measured(condition), trial.rival(condition)
        if ideal is None:  # the first condition
            ideal, signal, unit = found, found.signal, found.unit
            stated = tolerance_in(unit, graph.file, graph.document)
            bar = ErrorBounds(stated, str(law) if law is not None else "", lacking)
        why = found.stopped or bar.above(found, rival, ideal=ideal is found) or _why(found, ideal)
        error, other = (None if each is None or each.stopped else each.last for each in (found, rival))
        outcomes.append(Outcome(condition, error, why, other, found.still))
    until = graph.file.duration
    field = graph.diagram.fingerprint
    return Rehearsal(graph.name, signal, unit, duration, required, outcomes, until, parts, field, bar)


def _why(run: Measured, ideal: Measured) -> str:
    """Reason of a failure relative to the ideal robot; empty if there is none."""
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


MODEL: Final = ("payload", "jitter")
"""Options of a condition that change the simulated robot's model."""


@final
@dataclass(frozen=True)
class _Trial:
    """Simulated drives under a condition, with the graph's controller and with its rival."""

    graph: BaseGraph
    duration: float
    limits: Limits
    engine: Choice
    law: Law | None
    _robots: dict[Any, SimulatedRobot] = field(default_factory=dict)

    @cached_property
    def _scaled(self) -> ScaledController:
        return scaled_controller(self.graph, self.engine)

    def measured(self, condition: Condition) -> Measured:
        """Errors of the graph's controller."""
        scaled = self._scaled
        found, robot, gate = self._simulated_drive(scaled, condition)
        plan = self._plan(condition)
        diagram = self.graph.diagram
        goal = goal_of(diagram.loop)
        only = [] if goal is None else [goal.desired, goal.actual]
        recording = recording_of(
            diagram, scaled, found, robot=robot.name, plan=plan, gate=gate, solver=robot.solver, only=only
        )
        error = tracking_error(recording) if recording is not None else None
        if recording is None or error is None:
            raise DriveError(f"{self.graph.name}: expected a graph that follows a path")
        times = recording.time / self.duration
        still = euclidean(recording[error.actual][0] - recording[error.desired])
        stopped = _stopped(found, float(recording.time[-1]))
        parts = quarters(times, error.norm, still)
        return Measured(error.signal, error.unit, *parts, stopped, farthest(times, still))

    def rival(self, condition: Condition) -> Measured | None:
        """Errors of the rival; None if none is applicable."""
        if self.law is None:
            return None
        robot = self.graph.diagram.robot
        found, _, _ = self._simulated_drive(Rival(self.law, robot.n, clock_of(self.graph)), condition)
        journal, name = found.journal, "q" if self.law.shown is None else "x"
        times, shown = journal["reference"], journal[name]
        wanted = np.array([self.law.goal(t)[0].full().ravel() for t in times])
        parts = quarters(times / self.duration, euclidean(shown - wanted), euclidean(shown[0] - wanted))
        return Measured("", "", *parts, _stopped(found, float(times[-1])))

    def _plan(self, condition: Condition) -> Plan:
        return Plan(self.duration, ramp=condition.ramp)

    def _simulated_drive(self, scaled: Any, condition: Condition) -> tuple[DriveResult, SimulatedRobot, Gate]:
        options = dict(condition.options)
        model = {name: options.pop(name) for name in MODEL if name in options}
        key = tuple(model.items())
        if key not in self._robots:  # the model takes longer than a drive
            self._robots[key] = simulated_robot(self.graph, self.duration, self.engine, **model)
        robot = self._robots[key].again(**options)
        gate = Gate(self.limits, robot.period)
        return drive(scaled, robot, gate, self._plan(condition), lambda: ""), robot, gate


def _stopped(found: DriveResult, time: float) -> str:
    return f"stopped after {plain(time, 's')}, {found.stop}" if found.stop else ""
