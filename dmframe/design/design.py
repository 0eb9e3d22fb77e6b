"""Design of a controller: a race of laws on the robot, then proof and rehearsal of the best one, in one folder."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.build.compiler import find_compiler
from dmframe.common.errors import RobotError, ValueFault, listed
from dmframe.common.files import write_text, writing
from dmframe.design.checks import checks_of
from dmframe.design.contest import Contest
from dmframe.design.decide import Candidate, worth
from dmframe.design.designed import LIMITS, RACE, RESULTS, SUMMARY, Designed
from dmframe.design.family import Family, identified, makers
from dmframe.design.handover import command_of, handed_over, set_aside
from dmframe.design.limits import limits_text
from dmframe.design.motion import Motion, first_path, motion_of, own_motion, tool_motion
from dmframe.design.obstacle import obstacle
from dmframe.design.path_file import PathFile, read_path
from dmframe.design.points import points_of
from dmframe.design.progress import Progress, Say
from dmframe.design.race_text import ADAPTIVE, FIRST, race_text
from dmframe.design.request import CLOCK, Request
from dmframe.graph.first import FirstGraph, first_graph
from dmframe.graph.graph import Graph
from dmframe.identification.found import Identified
from dmframe.identification.identify import identify
from dmframe.identification.race_text import clock_of
from dmframe.identification.robot_file import TOOL
from dmframe.identification.write import robot_text
from dmframe.race.plan import Cell, Race, Run
from dmframe.race.read import load_race
from dmframe.race.run import Finished, run_race
from dmframe.robot.chain import SerialChain
from dmframe.study.execute import State

LOG: Final = "identified"
"""Folder of an identification."""
AXES: Final = (2, 7)
"""Least and most moving joints of a robot file."""
TWIN: Final = "twin.urdf"
"""The identified robot."""
LOAD: Final = ("payload", "payload_at")
"""Parameters of the arm that the handed-over graph does not have."""

PARTLY: Final = "are proved, and the stability of the loop is tested by runs alone"


def design(request: Request, out: str | Path, *, workers: int | None = None, say: Say = lambda text: None) -> Designed:
    """Design a controller for a robot in a folder; an interrupted design continues there.

    Laws without a model and adaptive laws are tuned by one protocol on two servos, and compared on other servos,
    friction, delays, loads and paths, behind the channel of a UR. The best adaptive law is handed over if it is clearly
    better than the best simple one, proved, and passes a rehearsal with delay, jitter, lost samples and the payload.
    Else the best simple law is, if it does not diverge in a rehearsal.

    A graph that the folder has from an earlier design or that was edited is not lost: see `set_aside`.

    Raises
    ------
    DmframeError
        There is no such robot, the path cannot be read, or the folder cannot be written.
    """
    folder, progress = Path(out), Progress(say)
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    clock, payload = request.clock or CLOCK, request.payload or 0.0
    found = Designed("blocked", "", folder, Path(request.robot).name, clock, payload)
    found = replace(found, command=command_of(request, out), log=request.log or "", task=request.task or "joints")
    try:
        found = _designed(request, found, workers, progress)
    except RobotError as error:
        found = replace(found, reason=error.text)
    if found.outcome == "blocked":
        found = replace(found, files=tuple(set_aside(folder, "", None)))
    say("writing the report")
    _write(found)
    return found


def _designed(request: Request, found: Designed, workers: int | None, progress: Progress) -> Designed:
    if find_compiler() is None:
        return replace(found, reason="there is no C compiler, without which the comparison takes hours; install gcc")
    progress.say("robot", "reading the robot")
    first = first_graph(request.robot, found.folder, request.tool, dict(request.hold), axes=AXES)
    found = replace(found, assumed=first.notes)
    chain = _saved(first, found.folder)
    if reason := _sliding(chain):
        return replace(found, reason=reason)
    path = None if request.path is None else read_path(request.path, chain)
    found = replace(found, task=request.task or (path.kind if path else "joints"))
    motion = _motion(request, path, first, chain)
    log = None
    if request.log is not None:
        graph = str(found.folder / FIRST)  # with the tool and the held joints of the request
        log = identify(request.log, graph, out=found.folder / LOG, say=lambda text: progress.say("robot", text))
        if not (log.known and log.twin):
            reason = (
                "no class of servo, or no robot with physical bodies, explains the log: see identified/report.html; "
                "without --log the servo is assumed"
            )
            return replace(found, reason=reason)
        first, found = _identified(log, request, found)
        chain = _saved(first, found.folder)
        motion = _motion(request, path, first, chain)
    if request.payload is None:
        found = replace(found, payload=_moving_mass(chain) / 20)
    if log is None:
        family = makers(first, found.payload, motion.seconds)
    else:
        family = identified(log, found.payload, motion.seconds, found.clock)
    found = replace(found, notes=motion.notes, seconds=motion.seconds)
    write_text(found.folder / LIMITS, limits_text(motion, chain))
    finished = _raced(first, family, motion, found, workers, progress)
    contest = Contest(finished, (finished.race.file.entrant, ADAPTIVE), workers)
    return _chosen(contest, finished.race, motion, family, replace(found, ranking=contest.ranking), progress)


def _sliding(chain: SerialChain) -> str:
    """Why a robot with prismatic joints gets no controller, and what to do; empty for another robot."""
    names = [joint.name for joint in chain.joints if joint.kind == "prismatic"]
    if not names:
        return ""
    many = len(names) > 1
    why = f"joint{'s' * many} {listed(names)} {'are' if many else 'is'} prismatic, and such a robot cannot be rehearsed"
    if chain.n - len(names) < AXES[0]:
        return (
            f"{why}; without {'them' if many else 'it'} {chain.n - len(names)} of at least {AXES[0]} joints would move"
        )
    words = [word for name in names for word in ("--hold", f"{name}=POSITION")]
    return f"{why}; hold {'them' if many else 'it'} with {shlex.join(words)}"


def _saved(first: FirstGraph, folder: Path) -> SerialChain:
    """Write a first graph; returns its robot."""
    for name, text in first.robot.items():
        write_text(folder / name, text)
    write_text(folder / FIRST, first.text)
    robot = Graph.read(folder / FIRST).robot
    assert isinstance(robot, SerialChain)
    return robot


def _identified(log: Identified, request: Request, found: Designed) -> tuple[FirstGraph, Designed]:
    """First graph of the identified robot, and its sampling period."""
    write_text(found.folder / TWIN, robot_text(log))
    count = len(log.fit.unknowns.model.chain.joints)
    first = first_graph(str(found.folder / TWIN), found.folder, TOOL, axes=(count, count))
    return first, replace(found, clock=request.clock or max(clock_of(log), CLOCK))


def _motion(request: Request, path: PathFile | None, first: FirstGraph, chain: SerialChain) -> Motion:
    """Paths of the task: those of the user's file, or some that the robot can follow."""
    if path is None:
        if request.task in (None, "joints"):
            return motion_of(first)
        return tool_motion(first, chain, turns=request.task == "pose")
    if request.task == "joints" and path.kind != "joints":
        raise ValueFault(f"task: expected position or pose, since {path.name} is a path of the tool; found joints")
    if request.task == "pose" and path.kind == "position":
        raise ValueFault(
            f"task: expected position, since {path.name} has no orientation: qx, qy, qz, qw or rx, ry, rz; found pose"
        )
    if request.task == "position" and path.kind == "pose":
        path = replace(path, kind="position", rows=path.rows[:, :3])
    task = request.task or path.kind
    near = np.array(first_path(first)["center"], dtype=float)
    return own_motion(points_of(path, chain, near), "joints" if task == "joints" else "tool")


def _raced(
    first: FirstGraph, family: Family, motion: Motion, found: Designed, workers: int | None, progress: Progress
) -> Finished:
    text = race_text(first, family, motion, found.clock)
    write_text(found.folder / RACE, text)
    kept = dict[str, float]()

    def report(stage: str, state: State) -> None:
        name, share = "tuning" if stage == "tuning" else "comparison", state.kept / max(state.runs, 1)
        if name not in kept:
            kept[name] = share
            progress.keep(name, share)
        rest = f": {state.kept} of {state.runs} runs after {state.seconds:.0f} s"
        progress.say(name, f"comparing laws, {stage}{rest}", share)

    progress.say("robot", "reading laws, plants and paths")
    return run_race(load_race(found.folder / RACE), found.folder / RESULTS, workers=workers, report=report)


def _chosen(
    contest: Contest, race: Race, motion: Motion, family: Family, found: Designed, progress: Progress
) -> Designed:
    """The best adaptive law that is worth it and passes its checks, else the best simple one."""
    simple = contest.ranking.best(adaptive=False)
    reasons = dict[str, str]()  # the first against each adaptive law: that of its best values
    for candidate in contest.candidates(adaptive=True):
        found = replace(found, ranking=contest.ranking.including(candidate))
        if why := worth(candidate, simple):
            reasons.setdefault(candidate.law, why)
            break
        graph = _graph_of(race, candidate, motion, family)
        checks = list(checks_of(graph, candidate, found, progress))
        failed = [check for check in checks if not check.passed]
        if not failed:
            proof = "the loop is proved" if checks[0].whole else f"the estimates of {candidate.law} {PARTLY}"
            reason = f"{_against(candidate, simple, found.unit)}; {proof}"
            designed = replace(found, outcome="adaptive", reason=reason)
            return handed_over(graph, designed, candidate, simple, checks, progress)
        reasons.setdefault(candidate.law, f"{candidate.law} has a smaller error, but {failed[0].text}")
    why = "; ".join(reasons.values()) or "each adaptive law diverged on one of the plants"
    found = replace(found, ranking=contest.ranking)
    return _simple(contest, race, motion, family, found, why, progress)


def _simple(
    contest: Contest, race: Race, motion: Motion, family: Family, found: Designed, why: str, progress: Progress
) -> Designed:
    """The best simple law that passes; none is handed over that diverges."""
    assert found.ranking is not None
    adaptive, reasons = found.ranking.best(adaptive=True), dict[str, str]()
    for candidate in contest.candidates(adaptive=False):
        if not math.isfinite(candidate.error):
            continue
        graph = _graph_of(race, candidate, motion, family)
        checks = list(checks_of(graph, candidate, found, progress))
        if failed := [check for check in checks if not check.passed]:
            reasons.setdefault(candidate.law, failed[0].text)
            continue
        reason = f"take {candidate.law}, with {_error(candidate, found.unit)}: {why}"
        found = replace(found, outcome="simple", reason=reason, ranking=found.ranking.including(candidate))
        return handed_over(graph, found, candidate, adaptive, checks, progress)
    laws = {why: [law for law, other in reasons.items() if other == why] for why in reasons.values()}
    left = "; ".join(f"{listed(names)}: {why}" for why, names in laws.items())
    left = left or "each law without a model diverged on one of the plants"
    lost = not any(math.isfinite(item.error) for item in contest.ranking.candidates)
    if lost and (cause := obstacle(race, contest.hardest)):
        return replace(found, reason=cause, other=None)
    return replace(found, reason=f"{why}; {left}", other=adaptive)


def _graph_of(race: Race, candidate: Candidate, motion: Motion, family: Family) -> Graph:
    """The tuned law on the nominal servo, along the path that is handed over, without the channel."""
    run = race.held_out[0]
    cell = Cell(run.clock, motion.handed, family.nominal, run.reality)
    graph = race.graph(Run(candidate.law, cell, tuple(candidate.values.items()), race.file.seed + 1))
    arm = {key: value for key, value in race.file.plants[family.nominal].blocks["arm"].items() if key not in LOAD}
    title = f"{candidate.law} for a path of the {motion.error} of {graph.robot.name}"
    kind = arm["type"] if "bodies" in arm else "manipulator"
    return graph.set({"reality": None, "title": title, "blocks.arm": {**arm, "type": kind}})


def _moving_mass(chain: SerialChain) -> float:
    """Mass of the moving links [kg]."""
    return float(sum(body[0] for body in chain.inertia))


def _against(chosen: Candidate, simple: Candidate | None, unit: str) -> str:
    own = f"{chosen.law} has {_error(chosen, unit)} on {len(chosen.errors)} pairs of a servo and a path"
    if simple is None:
        return f"{own}, where each law without a model diverged"
    return f"{own}; {simple.law}, the best law without a model, has {_error(simple, unit)}"


def _error(candidate: Candidate, unit: str) -> str:
    if not math.isfinite(candidate.error):
        return "a divergence"
    return f"an error of {candidate.error:.2g} {unit} in the median and {candidate.worst:.2g} {unit} at worst"


def _write(found: Designed) -> None:
    from dmframe.design.page import as_html

    write_text(found.report, as_html(found))
    write_text(found.folder / SUMMARY, json.dumps(found.summary, indent=1) + "\n")
