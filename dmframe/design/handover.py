"""Files of a design: graph, C code, live page, the commands that repeat it. Earlier graphs are kept."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Final

from dmframe.common.errors import DmframeError, OutputError
from dmframe.common.files import write_text, writing
from dmframe.common.units import plain
from dmframe.design.checks import REHEARSED
from dmframe.design.decide import Candidate
from dmframe.design.designed import COMMANDS, CONTROLLER, GRAPH, LIMITS, PAGE, RACE, RESULTS, Check, Designed
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
    folder = found.folder
    files = [(GRAPH, "the controller on the nominal servo: run, verify, analyse, rehearse, drive")]
    files += set_aside(folder, graph.text)
    write_graph(graph, folder / GRAPH)
    saved = Graph.read(folder / GRAPH)
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
    return replace(found, chosen=chosen, other=other, checks=tuple(checks), files=tuple(files))


def set_aside(folder: Path, text: str | None) -> list[tuple[str, str]]:
    """Move a graph with another text, which a user may have edited, with its C code and page to a folder ``before``.

    Parameters
    ----------
    text
        The graph that will be written; None if there is none.

    Returns
    -------
    list
        The file of the graph and what it is; empty if none was moved.
    """
    graph = folder / GRAPH
    if not graph.exists() or (text is not None and graph.read_text(encoding="utf-8", errors="replace") == text):
        return []
    place = next(place for k in range(1, 10_000) if not (place := folder / BEFORE / str(k)).exists())
    with writing(folder, "folder"):
        place.mkdir(parents=True)
        for name in (CONTROLLER, PAGE, COMMANDS, GRAPH):
            if (folder / name).exists():
                (folder / name).rename(place / name)
    return [(f"{BEFORE}/{place.name}/{GRAPH}", "the graph that was here before, with its C code and page")]


def commands(found: Designed) -> str:
    """The commands that repeat a design."""
    folder = shlex.quote(str(found.folder))
    lines = [
        found.command,
        f"dmframe race {folder}/{RACE} --out {folder}/{RESULTS}",
        f"dmframe verify {folder}/{GRAPH}",
        f"dmframe analyse {folder}/{GRAPH}",
        f"dmframe rehearse {folder}/{GRAPH} --until {REHEARSED:g} --payload '{found.payload:.6g} kg' "
        f"--limits {folder}/{LIMITS}",
        f"dmframe run {folder}/{GRAPH}",
    ]
    return "\n".join(lines) + "\n"


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
