"""Design of a controller: a race of laws on the robot, then proof and rehearsal of the best one, in one folder."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from dmframe.build.compiler import find_compiler
from dmframe.common.errors import DmframeError, OutputError, RobotError
from dmframe.common.files import write_text, writing
from dmframe.common.units import plain
from dmframe.design.contest import Contest
from dmframe.design.decide import Candidate, worth
from dmframe.design.designed import GRAPH, SUMMARY, Check, Designed
from dmframe.design.family import Family, identified, makers
from dmframe.design.motion import NEVER, motion_of
from dmframe.design.race_text import ADAPTIVE, FIRST, duration_of, race_text
from dmframe.design.request import CLOCK, Request
from dmframe.graph.first import FirstGraph, first_graph
from dmframe.graph.graph import Graph
from dmframe.identification.identify import identify
from dmframe.identification.race_text import clock_of
from dmframe.identification.robot_file import TOOL
from dmframe.identification.write import robot_text
from dmframe.race.plan import Cell, Race, Run
from dmframe.race.read import load_race
from dmframe.race.run import Finished, run_race
from dmframe.study.execute import State
from dmframe.study.packing import write_graph

RACE: Final = "race.yaml"
RESULTS: Final = "race"
PAGE: Final = "page.html"
CONTROLLER: Final = "controller"
REHEARSALS: Final = "rehearsals"
COMMANDS: Final = "commands.txt"
LOG: Final = "identified"
"""Folder of an identification."""
TWIN: Final = "twin.urdf"
"""The identified robot."""
LOAD: Final = ("payload", "payload_at")
"""Parameters of the arm that the handed-over graph does not have."""
LIMIT: Final = 0.1
"""Largest error of a simple law in a rehearsal, that above which a run of the race counts as diverged [rad]."""
REHEARSED: Final = 40.0
"""Duration of the rehearsal's runs [s]."""

Say = Callable[[str], None]


def design(request: Request, out: str | Path, *, workers: int | None = None, say: Say = lambda text: None) -> Designed:
    """Design a controller for a robot in a folder; an interrupted design continues there.

    Laws without a model and adaptive laws are tuned by one protocol on two servos, and compared on other servos,
    friction, delays, loads and paths, behind the channel of a UR. The best adaptive law is handed over if it is clearly
    better than the best simple one, proved, and passes a rehearsal with delay, jitter, lost samples and the payload.
    Else the best simple law is, if it does not diverge in a rehearsal.

    Raises
    ------
    DmframeError
        There is no such robot, or the folder cannot be written.
    """
    folder = Path(out)
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    clock, payload = request.clock or CLOCK, request.payload or 0.0
    found = Designed("blocked", "", folder, Path(request.robot).name, clock, payload)
    found = replace(found, command=command_of(request, out), log=request.log or "")
    try:
        found = _designed(request, found, workers, say)
    except RobotError as error:
        found = replace(found, reason=error.text)
    say("writing the report")
    _write(found)
    return found


def _designed(request: Request, found: Designed, workers: int | None, say: Say) -> Designed:
    if request.task != "joints":
        reason = f"a path of the tool for any arm is missing: `--task {request.task}` is not available; take joints"
        return replace(found, reason=reason)
    if find_compiler() is None:
        return replace(found, reason="there is no C compiler, without which the comparison takes hours; install gcc")
    log = None if request.log is None else identify(request.log, request.robot, out=found.folder / LOG, say=say)
    if log is not None and not log.known:
        return replace(found, reason="no class of servo explains the log: see identified/report.html")
    say("reading the robot")
    if log is None:
        first = first_graph(request.robot, found.folder, request.tool, dict(request.hold))
    else:
        write_text(found.folder / TWIN, robot_text(log))
        first = first_graph(str(found.folder / TWIN), found.folder, TOOL)
        found = replace(found, clock=request.clock or max(clock_of(log), CLOCK))
    for name, text in first.robot.items():
        write_text(found.folder / name, text)
    write_text(found.folder / FIRST, first.text)
    if request.payload is None:
        found = replace(found, payload=_moving_mass(Graph.read(found.folder / FIRST)) / 20)
    if log is None:
        family = makers(first, found.payload, duration_of())
    else:
        family = identified(log, found.payload, duration_of(), found.clock)
    finished = _raced(first, family, found, workers, say)
    contest = Contest(finished, (finished.race.file.entrant, ADAPTIVE), workers)
    found = replace(found, ranking=contest.ranking)
    simple = contest.ranking.best(adaptive=False)
    why = "each adaptive law diverged on one of the plants"
    for candidate in contest.adaptive():
        found = replace(found, ranking=contest.ranking.including(candidate))
        if why := worth(candidate, simple):
            break
        graph = _graph_of(finished.race, candidate, family)
        checks = list(_checks(graph, candidate, found, say))
        failed = [check for check in checks if not check.passed]
        if not failed:
            reason = f"{_against(candidate, simple, found.unit)}; {checks[0].text}"
            designed = replace(found, outcome="adaptive", reason=reason)
            return _handed_over(graph, designed, candidate, simple, checks, say)
        why = f"{candidate.law} has a smaller error, but {failed[0].text}"
    return _simple(finished.race, family, found, why, say)


def _simple(race: Race, family: Family, found: Designed, why: str, say: Say) -> Designed:
    """The best simple law that passes; none is handed over that diverges."""
    assert found.ranking is not None
    adaptive, reasons = found.ranking.best(adaptive=True), list[str]()
    for candidate in found.ranking.ordered(adaptive=False):
        graph = _graph_of(race, candidate, family)
        checks = list(_checks(graph, candidate, found, say))
        if failed := [check for check in checks if not check.passed]:
            reasons.append(f"{candidate.law}: {failed[0].text}")
            continue
        reason = f"take {candidate.law}, with {_error(candidate, found.unit)}: {why}"
        return _handed_over(graph, replace(found, outcome="simple", reason=reason), candidate, adaptive, checks, say)
    left = "; ".join(reasons) or "each law without a model diverged on one of the plants"
    return replace(found, reason=f"{why}; {left}", other=adaptive)


def _raced(first: FirstGraph, family: Family, found: Designed, workers: int | None, say: Say) -> Finished:
    text = race_text(first, family, motion_of(first), found.clock)
    write_text(found.folder / RACE, text)

    def report(stage: str, state: State) -> None:
        done = state.kept / max(state.runs, 1)
        rest = f", about {state.seconds * (1 - done) / done:.0f} s left" if 0.1 < done < 1 else ""
        say(f"comparing laws, {stage}: {state.kept} of {state.runs} runs after {state.seconds:.0f} s{rest}")

    say("reading laws, plants and paths")
    return run_race(load_race(found.folder / RACE), found.folder / RESULTS, workers=workers, report=report)


def _graph_of(race: Race, candidate: Candidate, family: Family) -> Graph:
    """The tuned law on the nominal servo, along a path that never repeats, without the channel."""
    run = race.held_out[0]
    cell = Cell(run.clock, NEVER, family.nominal, run.reality)
    graph = race.graph(Run(candidate.law, cell, tuple(candidate.values.items()), race.file.seed + 1))
    arm = {key: value for key, value in race.file.plants[family.nominal].blocks["arm"].items() if key not in LOAD}
    title = f"{candidate.law} for a path of the joints of {graph.robot.name}"
    kind = arm["type"] if "bodies" in arm else "manipulator"
    return graph.set({"reality": None, "title": title, "blocks.arm": {**arm, "type": kind}})


def _checks(graph: Graph, candidate: Candidate, found: Designed, say: Say) -> Iterator[Check]:
    """Proof of an adaptive law, and rehearsal; the second only if the first passed."""
    if candidate.adaptive:
        say(f"proving {candidate.law}")
        verification = graph.verify()
        yield Check("proof", verification.headline, verification.proved)
        if not verification.proved:
            return
    say(f"rehearsing {candidate.law}")
    yield _rehearsed(graph, candidate, found)


def _rehearsed(graph: Graph, candidate: Candidate, found: Designed) -> Check:
    """A rehearsal, which is kept in the folder.

    A simple law passes if it is not stopped and its error is at most `LIMIT`.
    """
    key = sha256(f"{graph.text}{found.payload}".encode()).hexdigest()
    file = found.folder / REHEARSALS / f"{candidate.law}_{key[:8]}.json"
    kept = _kept(file, key)
    if kept is None:
        try:
            kept = graph.rehearse(REHEARSED, payload=found.payload).summary
        except DmframeError as error:
            return Check("rehearsal", f"it cannot be rehearsed: {error.text}", passed=False)
        file.parent.mkdir(exist_ok=True)
        write_text(file, json.dumps({**kept, "key": key}, indent=1) + "\n")
    if candidate.adaptive or kept["passed"]:
        passed = bool(kept["passed"])
        return Check("rehearsal", "passed under all conditions" if passed else _failure(kept), passed)
    lost = [row for row in kept["conditions"] if row["needed"] and (row["rms"] is None or not row["rms"] <= LIMIT)]
    if lost:
        how = "is stopped" if lost[0]["rms"] is None else f"has an error of {plain(lost[0]['rms'], kept['unit'])}"
        return Check("rehearsal", f"{candidate.law} {how} with {lost[0]['condition']}", passed=False)
    text = (
        f"{candidate.law} is not stopped, and its error is at most {plain(LIMIT, kept['unit'])}, under all conditions"
    )
    return Check("rehearsal", f"{text}; as a controller for a drive {_failure(kept)}", passed=True)


def _failure(kept: dict[str, Any]) -> str:
    """The first condition of a rehearsal that was not passed."""
    row = next(row for row in kept["conditions"] if row["needed"] and row["why"])
    error = "" if row["rms"] is None else f"its error is {plain(row['rms'], kept['unit'])}, "
    return f"it fails the rehearsal with {row['condition']}: {error}{row['why']}"


def _kept(file: Path, key: str) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("key") == key else None


def _handed_over(
    graph: Graph, found: Designed, chosen: Candidate, other: Candidate | None, checks: list[Check], say: Say
) -> Designed:
    """Write the graph, its page and its C code."""
    folder = found.folder
    if not (folder / GRAPH).is_file() or (folder / GRAPH).read_text(encoding="utf-8") != graph.text:
        shutil.rmtree(folder / CONTROLLER, ignore_errors=True)  # the code of another graph
    write_graph(graph, folder / GRAPH)
    files = [(GRAPH, "the controller on the nominal servo: run, verify, analyse, rehearse, drive")]
    saved = Graph.read(folder / GRAPH)
    if not (folder / CONTROLLER).exists():
        say("writing C")
        saved.export(folder / CONTROLLER)
    files.append((f"{CONTROLLER}/", "the controller as C99, with an example and a test"))
    say("writing the live page")
    try:
        saved.page(periods=False).save(folder / PAGE)
        files.append((PAGE, "the closed loop in a browser"))
    except OutputError:
        raise
    except DmframeError as error:
        checks.append(Check("live page", f"none: {error.text}", passed=True))
    write_text(folder / COMMANDS, commands(found))
    files.append((COMMANDS, "the commands that repeat all of it"))
    files.append((f"{RESULTS}/report.html", "the comparison of the laws, cell by cell"))
    return replace(found, chosen=chosen, other=other, checks=tuple(checks), files=tuple(files))


def commands(found: Designed) -> str:
    """The commands that repeat a design."""
    folder = shlex.quote(str(found.folder))
    lines = [
        found.command,
        f"dmframe race {folder}/{RACE} --out {folder}/{RESULTS}",
        f"dmframe verify {folder}/{GRAPH}",
        f"dmframe analyse {folder}/{GRAPH}",
        f"dmframe rehearse {folder}/{GRAPH} --until {REHEARSED:g} --payload '{found.payload:.6g} kg'",
        f"dmframe run {folder}/{GRAPH}",
    ]
    return "\n".join(lines) + "\n"


def command_of(request: Request, out: str | Path) -> str:
    """The command of a request."""
    words = ["dmframe", "design", request.robot, "--out", str(out), "--task", request.task]
    words += ["--log", request.log] if request.log is not None else []
    words += ["--period", plain(request.clock, "s")] if request.clock is not None else []
    words += ["--payload", f"0..{request.payload:g}"] if request.payload is not None else []
    words += ["--tool", request.tool] if request.tool else []
    words += [word for joint, value in request.hold for word in ("--hold", f"{joint}={value:g}")]
    return shlex.join(words)


def _moving_mass(graph: Graph) -> float:
    """Mass of the moving links [kg]."""
    return float(sum(body[0] for body in graph.robot.inertia))


def _against(chosen: Candidate, simple: Candidate | None, unit: str) -> str:
    own = f"{chosen.law} has {_error(chosen, unit)}"
    if simple is None:
        return f"{own}, where each law without a model diverged"
    return f"{own}, the best law without a model, {simple.law}, {_error(simple, unit)}"


def _error(candidate: Candidate, unit: str) -> str:
    if not math.isfinite(candidate.error):
        return "a divergence"
    return f"an error of {candidate.error:.2g} {unit} in the median and {candidate.worst:.2g} {unit} at worst"


def _write(found: Designed) -> None:
    from dmframe.design.page import as_html

    write_text(found.report, as_html(found))
    write_text(found.folder / SUMMARY, json.dumps(found.summary, indent=1) + "\n")
