"""``dmframe drive``, ``rehearse`` and ``replay``: run a controller on a robot, rehearse it and replay its record."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from dmframe.cli import STOPPED
from dmframe.cli.run import placed_folder, written
from dmframe.cli.signals import deferred_signals
from dmframe.cli.streams import tell
from dmframe.common.errors import DmframeError, DriveError, ValueFault
from dmframe.common.units import seconds as time_of
from dmframe.common.units import shorten, to_unit
from dmframe.drive.robots import kind_of
from dmframe.graph.graph import Graph
from dmframe.results.folder import drawing
from dmframe.results.place import SAMPLES, complete
from dmframe.results.run import table_of

NOT_BORNE = 1
FAILED = 1


def drive_graph(
    graph: Graph,
    *,
    robot: str,
    seconds: str | None,
    limits: Path | None,
    ramp: str | None,
    patience: str | None,
    payload: str | None,
    shadow: bool,
    rehearsed: bool,
    out: Path | None,
    formats: Sequence[str],
    force: bool,
    as_json: bool,
) -> int:
    """Drive a robot, write and print the results; returns the exit status.

    Signals are stored and polled at each sample, so that the robot stops in a controlled way.
    """
    graph = graph if seconds is None else graph.until(time_of("--until", seconds))
    _ = graph.diagram
    given = _options(ramp, patience, payload)
    if kind_of(robot)[0].real:
        tell(f"{robot}: notice: its driver is untested on hardware, and the gate is not a safety function", aside=True)
    with ExitStack() as stack:
        place = stack.enter_context(placed_folder(out, [graph], force=force))
        with deferred_signals() as came:
            try:
                run = graph.drive(
                    robot,
                    limits=limits,
                    **given,
                    shadow=shadow,
                    rehearsed=rehearsed,
                    asked=lambda: _named(came[0]) if came else "",
                    record=place.folder / SAMPLES,
                )
            except DriveError as error:  # without recorded samples
                if not came:
                    raise
                tell(f"dmframe: {error}", aside=True)
                return STOPPED
            draw = stack.enter_context(drawing([run] if formats else (), formats))
            summaries = written(place, [run])
        tell(json.dumps(summaries[0], indent=2) if as_json else f"{table_of([run])}\nresults: {place.path}")
        if formats and not came:
            draw(place, [run])
        complete(place)
    if came:
        return STOPPED
    return FAILED if run.recording.interrupted else 0


def _named(number: int) -> str:
    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name


def _options(ramp: str | None, patience: str | None, payload: str | None) -> dict[str, Any]:
    """Options that a drive and its rehearsal share."""
    return {
        "ramp": None if ramp is None else _not_negative("--ramp", ramp, "s"),
        "patience": None if patience is None else time_of("--patience", patience),
        "payload": None if payload is None else _not_negative("--payload", payload, "kg"),
    }


def _not_negative(option: str, text: str, unit: str) -> float:
    try:
        found = to_unit(text, unit)
    except DmframeError as error:
        raise ValueFault(f"{option} {shorten(text)}: {error.text}") from None
    if found < 0:
        raise ValueFault(f"{option} {shorten(text)}: expected a number in {unit} of 0 or above")
    return found


def rehearse_graph(
    graph: Graph,
    *,
    seconds: str | None,
    payload: str | None,
    limits: Path | None,
    ramp: str | None,
    patience: str | None,
    as_json: bool,
) -> int:
    """Rehearse a graph and print the result; a passed rehearsal with full runs is kept for `drive`."""
    from dmframe.drive.records import store

    _ = graph.diagram
    until = None if seconds is None else time_of("--until", seconds)
    found = graph.rehearse(until, limits=limits, **_options(ramp, patience, payload))
    kept = store(found)
    if as_json:
        tell(json.dumps({**found.summary, "kept": kept}, indent=2))
    else:
        tell(str(found))
        if found.passed and not found.whole:
            tell(f"not kept for drive: that requires runs of {found.required:g} s")
    return 0 if found.passed else NOT_BORNE


def replay_log(log: Path, graph: Graph, *, as_json: bool) -> int:
    """Recompute the commands of a record and print differences; returns 1 if there are any."""
    found = graph.replay(log)
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
    return 0 if found.differs is None else 1
