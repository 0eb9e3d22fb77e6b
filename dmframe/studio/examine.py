"""Examine the text of a graph in stages: faults, diagram, numbers, verdict, live page."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from dmframe.certify import Verdict
from dmframe.common.errors import DmframeError
from dmframe.common.units import plain
from dmframe.config.document import read_document
from dmframe.config.plausible import implausible
from dmframe.diagram.values import changed_numbers, with_values
from dmframe.drawing import svg
from dmframe.graph.graph import Graph
from dmframe.page import Page
from dmframe.report.verdict_text import verdict_text

Stage = dict[str, Any]

PLACE: Final = re.compile(r":(\d+):(\d+)(?: with .*)?$")
"""Line and column at the end of a fault's location."""
_INTERNAL: Final = (KeyboardInterrupt, MemoryError)


def drawn(text: str, name: str, base: str | None = None) -> Iterator[Stage]:
    """The stages of a text that need no proof, each as plain data with its name under ``stage``.

    ``faults``, each with message, line, column (from 1; 0 if unknown) and block, after which there are no more; or
    ``numbers``, see below, and ``diagram``, a drawing.

    Parameters
    ----------
    text, name
        The text, and the path of its file, in whose folder other files are searched.
    base
        The text of a page that is displayed. If the two differ in parameters of the same equations only, ``numbers``
        has the parameters with which that page shows this text until its own page is complete; else there is no such
        stage.
    """
    try:
        graph = graph_of(text, name)
    except _INTERNAL:
        raise
    except BaseException as error:  # a user's block may raise anything
        yield {"stage": "faults", "faults": faults_of(error)}
        return
    numbers = _numbers(graph, base, name)
    if numbers is not None:
        yield {"stage": "numbers", "p": numbers}
    yield _diagram(graph)


def proved(text: str, name: str) -> Iterator[Stage]:
    """The stages ``verdict`` and ``page``, with the HTML, or the reason why there is none; none for a faulty text."""
    try:
        graph = graph_of(text, name)
    except _INTERNAL:
        raise
    except BaseException:  # reported by `drawn`
        return
    try:
        verdict = graph.verdict(copies=True)
        yield verdict_of(graph, verdict)
    except _INTERNAL:
        raise
    except BaseException as error:
        yield {"stage": "faults", "faults": faults_of(error)}
        return
    try:
        yield {"stage": "page", "html": Page(graph, verdict).html}
    except _INTERNAL:
        raise
    except BaseException as error:
        yield {"stage": "page", "reason": "; ".join(fault["text"] for fault in faults_of(error))}


def graph_of(text: str, name: str) -> Graph:
    """The graph of a text, with its diagram built. Raises its faults, or anything that a user's block raises."""
    graph = Graph.of(read_document(text, name))
    graph.intervals(graph.diagram)
    return graph


def faults_of(error: BaseException) -> list[dict[str, Any]]:
    """Each fault of an error with its place in the text."""
    if not isinstance(error, DmframeError):
        words = " ".join(str(error).split())
        text = f"{type(error).__name__}: {words}; a defect of dmframe or of a block"
        return [{"text": text, "line": 0, "column": 0, "block": None}]
    found = list[dict[str, Any]]()
    for fault in error.faults:
        place = PLACE.search(fault.location)
        line, column = (int(number) for number in place.groups()) if place else (0, 0)
        where = f"{fault.location}: " if fault.location and not place else ""
        block = fault.path[1] if fault.path[:1] in (("blocks",), ("baseline",)) and len(fault.path) > 1 else None
        found.append({"text": where + fault.text, "line": line, "column": column, "block": block})
    return found


def _diagram(graph: Graph) -> Stage:
    clock = "continuous time" if graph.clock is None else f"sampled every {plain(graph.clock, 's')}"
    return {
        "stage": "diagram",
        "svg": svg(graph.diagram),
        "title": graph.title,
        "about": f"{len(graph.diagram.blocks)} blocks, {clock}, for {plain(graph.duration, 's')}",
    }


def _numbers(graph: Graph, base: str | None, name: str) -> list[float] | None:
    """Parameters of the graph in the order of the loop of `base`; None if they differ in more than parameters."""
    if base is None:
        return None
    try:
        other = Graph.of(read_document(base, name), like=graph)
        changed = changed_numbers(other.blocks, graph.blocks)
        if changed is None or _settings(graph) != _settings(other):
            return None
        p = with_values(other.diagram, changed).loop.p_values
    except DmframeError:
        return None
    values: list[float] = [float(value) for value in p]
    finite = json.dumps(values).find("N") < 0 and json.dumps(values).find("I") < 0
    return values if finite else None


def _settings(graph: Graph) -> Mapping[str, Any]:
    """The parts of a graph file other than its blocks."""
    return {key: value for key, value in graph.data.items() if key not in ("blocks", "baseline", "title")}


def verdict_of(graph: Graph, verdict: Verdict) -> Stage:
    """The verdict as plain data; `blocks` are those that it names as a cause.

    A proof in continuous time says so in the headline, since the controller may be sampled.
    """
    sampled = graph.clock is not None and verdict.flow_claim is not None
    headline = verdict.headline.replace("proved", "proved in continuous time", 1) if sampled else verdict.headline
    clock = f"The proof does not cover the sampling every {plain(graph.clock, 's')}" if graph.clock and sampled else ""
    doubtful = implausible(graph)
    return {
        "stage": "verdict",
        "outcome": verdict.outcome,
        "headline": headline if verdict.outcome == "proved" else verdict.headline,
        "restriction": "; ".join(filter(None, [clock, *doubtful])) if verdict.outcome == "proved" else "",
        "reason": verdict.reason.unicode,
        "blocks": _named(graph, verdict),
        "conditions": [
            {
                "name": item.name.unicode,
                "margin": None if item.value is None else f"{item.value:.4g}",
                "holds": item.holds,
                "how": item.how,
            }
            for item in verdict.conditions
        ],
        "conclusions": [f"{item.signal.unicode} {item.says}" for item in verdict.statements if item.concludes]
        if verdict.outcome == "proved"
        else [],
        "text": verdict_text(graph.name, verdict, notices=doubtful),
    }


def _named(graph: Graph, verdict: Verdict) -> list[str]:
    """Blocks that a failed proof names: those of a refutation, of failed conditions, and of the reason."""
    if verdict.outcome == "proved":
        return []
    known = list(graph.diagram.blocks)
    named = set(verdict.refutation.blame if verdict.refutation is not None else ())
    named |= {str(item.name).partition(":")[0] for item in verdict.conditions if not item.holds}
    named |= {name for name in known if re.search(rf"(?<![\w.]){name}[:.]", verdict.reason)}
    return [name for name in known if name in named]


def opened_files(opened: list[str]) -> list[tuple[str, int, int]]:
    """Path, time of modification and size of files, without those of Python and of installed packages."""
    ours = (str(Path(sys.prefix)), str(Path(sys.base_prefix)), "/proc", "/dev", "/sys")
    found = list[tuple[str, int, int]]()
    for path in dict.fromkeys(opened):
        if path.startswith(ours):
            continue
        try:
            status = Path(path).stat()
        except OSError:
            found.append((path, -1, -1))
        else:
            found.append((path, status.st_mtime_ns, status.st_size))
    return found
