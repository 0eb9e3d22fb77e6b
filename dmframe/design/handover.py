"""Files of a design: graph, C code, live page, the commands that repeat it. Earlier graphs are kept."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Final

from dmframe.common.errors import DmframeError, OutputError
from dmframe.common.files import write_text, writing
from dmframe.common.units import plain
from dmframe.design.checks import REHEARSED
from dmframe.design.decide import Candidate
from dmframe.design.designed import COMMANDS, CONTROLLER, GRAPH, LIMITS, PAGE, RACE, RESULTS, SUMMARY, Check, Designed
from dmframe.design.progress import Progress
from dmframe.design.request import Request
from dmframe.graph.graph import Graph
from dmframe.study.packing import write_graph

BEFORE: Final = "before"
"""Folder of what was in the place of a newer file."""


def handed_over(
    graph: Graph,
    found: Designed,
    chosen: Candidate,
    other: Candidate | None,
    checks: list[Check],
    progress: Progress,
) -> Designed:
    """Write the graph, its C code and its page; a graph that was there is kept."""
    folder, found = found.folder, replace(found, chosen=chosen, other=other)
    assert found.graph is not None
    name = found.graph.name
    files = [(name, "the controller on the nominal servo: run, verify, analyse, rehearse, drive")]
    files += set_aside(folder, name, graph.text)
    write_graph(graph, found.graph)
    saved = Graph.read(found.graph)
    if not (folder / CONTROLLER).exists():
        progress.say("export", "writing C")
        saved.export(folder / CONTROLLER)
    files.append((LIMITS, "limits around the path, for drive and rehearse"))
    files.append((f"{CONTROLLER}/", "the controller as C99, with an example and a test"))
    progress.say("page", "writing the live page")
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
    return replace(found, checks=tuple(checks), files=tuple(files))


def set_aside(folder: Path, name: str, text: str | None) -> list[tuple[str, str]]:
    """Move the graph of an earlier design, with its C code and page, to a folder ``before``.

    It stays if it has the same name and text; otherwise a user may have edited it.

    Parameters
    ----------
    name, text
        Of the graph that will be written; None for the text if there is none.

    Returns
    -------
    list
        The file of the graph and what it is; empty if none was moved.
    """
    graph = _earlier(folder)
    same = graph.name == name and text is not None
    if not graph.exists() or (same and graph.read_text(encoding="utf-8", errors="replace") == text):
        return []
    place = next(place for k in range(1, 10_000) if not (place := folder / BEFORE / str(k)).exists())
    with writing(folder, "folder"):
        place.mkdir(parents=True)
        for each in (CONTROLLER, PAGE, COMMANDS, graph.name):
            if (folder / each).exists():
                (folder / each).rename(place / each)
    return [(f"{BEFORE}/{place.name}/{graph.name}", "the graph that was here before, with its C code and page")]


def _earlier(folder: Path) -> Path:
    """The graph of the design that the folder has; it may not exist."""
    try:
        name = Path(json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["graph"]).name
    except (OSError, ValueError, KeyError, TypeError):
        name = GRAPH
    return folder / name


def commands(found: Designed) -> str:
    """The commands that repeat a design."""
    folder, graph = shlex.quote(str(found.folder)), shlex.quote(str(found.graph))
    limits = f"--limits {folder}/{LIMITS}"
    lines = {
        "all of it": found.command,
        "the comparison of the laws": f"dmframe race {folder}/{RACE} --out {folder}/{RESULTS}",
        "the proof": f"dmframe verify {graph}",
        "the linearised loop": f"dmframe analyse {graph}",
        "delay, jitter, lost samples and the load": f"dmframe rehearse {graph} --until {REHEARSED:g} --payload "
        f"'{found.payload:.6g} kg' {limits}",
        "a run": f"dmframe run {graph}",
        "the virtual robot": f"dmframe drive {graph} --robot sim {limits}",
    }
    return "".join(f"# {about}\n{line}\n" for about, line in lines.items())


def command_of(request: Request, out: str | Path) -> str:
    """The command of a request."""
    words = ["dmframe", "design", request.robot, "--out", str(out)]
    words += ["--task", request.task] if request.task is not None else []
    words += ["--path", request.path] if request.path is not None else []
    words += ["--log", request.log] if request.log is not None else []
    words += ["--period", plain(request.clock, "s")] if request.clock is not None else []
    words += ["--payload", f"0..{request.payload:g}"] if request.payload is not None else []
    words += ["--tool", request.tool] if request.tool else []
    words += [word for joint, value in request.hold for word in ("--hold", f"{joint}={value:g}")]
    return shlex.join(words)
