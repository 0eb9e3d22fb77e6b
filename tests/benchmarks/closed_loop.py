"""(a) and (b): the closed loop over a given time, in dmframe and in every other tool."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer
from tests.benchmarks.peers import PEERS, find
from tests.benchmarks.table import Row, Section
from tests.benchmarks.worker import Failed, measure

TOLERANCE = 1e-4
"""Largest distance of any joint angle at any sample from that of dmframe, for comparable rows [rad]."""

SIX_JOINTS = ("ours_compiled", "ours_interpreted", "cpp_pinocchio", "jax_by_hand", "numpy_pinocchio")
ENOUGH, MOST = 1.0, 15

Run = Callable[[str, str, float, float, float], dict[str, Any]]


def timed(key: str, graph: str, seconds: float, step: float) -> dict[str, Any]:
    """Joint angles of one tool and the seconds of its fastest run; runs are repeated for at least one second."""
    from tests.benchmarks.loop import Loop

    begin = time.perf_counter()
    peer = find(key)(Loop.read(graph), step)
    peer.warm(seconds)
    ready = time.perf_counter() - begin
    best, spent, count, q = np.inf, 0.0, 0, np.zeros(0)
    while count == 0 or (spent < ENOUGH and count < MOST):
        begin = time.perf_counter()
        q = peer.run(seconds)
        wall = time.perf_counter() - begin
        best, spent, count = min(best, getattr(peer, "wall", None) or wall), spent + wall, count + 1
    return {"q": q, "wall": best, "ready": ready}


def elsewhere(key: str, graph: str, seconds: float, step: float, limit: float) -> dict[str, Any]:
    """`timed` in a separate process."""
    return measure("closed_loop:timed", limit, key=key, graph=graph, seconds=seconds, step=step)


def section(
    part: str,
    graph: str,
    seconds: float,
    step: float,
    limit: float,
    *,
    peers: Iterable[str] = PEERS,
    run: Run = elsewhere,
    look: Callable[[str], type[Peer]] = find,
    progress: Callable[[str], None] = lambda text: None,
) -> Section:
    """The rows of one graph, dmframe first."""
    found, missing = dict[str, dict[str, Any]](), dict[str, str]()
    order = list(peers)
    for key in order:
        progress(f"({part}) {graph}: {look(key).title}")
        missing[key] = look(key).missing()
        if missing[key]:
            continue
        try:
            found[key] = run(key, graph, seconds, step, limit)
        except Failed as failure:
            missing[key] = f"failed: {failure}"
    reference = next((key for key in order if key.startswith("ours") and key in found), None)
    if reference is not None and len(found) > 1:
        # Every ratio depends on this one, so it is measured at both ends of the run, in case one was disturbed.
        progress(f"({part}) {graph}: {look(reference).title}, again")
        with suppress(Failed):
            again = run(reference, graph, seconds, step, limit)
            found[reference]["wall"] = min(float(found[reference]["wall"]), float(again["wall"]))
    rows = [row(part, look(key), seconds, missing[key], found.get(key), found.get(reference or "")) for key in order]
    name = look(reference).title if reference else "ours"
    return Section(
        part,
        f"{graph}, {seconds:g} s, one core; plant at {step * 1e3:g} ms",
        f"how many times as fast {name} is",
        tuple(rows),
        (
            f"A row counts if no joint angle at any sampling instant differs by more than {TOLERANCE:g} rad from that "
            "of dmframe. Compiling and building before the first step are excluded, for dmframe too: see (e). "
            f"The time is that of the best of up to {MOST} runs, and that of dmframe is measured before and after the "
            "others.",
        ),
    )


def row(
    part: str, peer: type[Peer], seconds: float, missing: str, found: dict[str, Any] | None, ours: dict[str, Any] | None
) -> Row:
    """The row of one tool."""
    note = "; ".join(text for text in (peer.method, peer.note) if text)
    if found is None:
        status = "failed" if missing.startswith("failed") else "missing"
        return Row(part, peer.title, status=status, agreement=missing.split(": ", 1)[1], note=note)  # type: ignore[arg-type]
    speed = seconds / float(found["wall"])
    ratio, agreement, agrees = None, "", True
    if ours is not None and found is not ours:
        agrees, agreement = agreed(found["q"], ours["q"])
        ratio = float(found["wall"]) / float(ours["wall"]) if agrees else None
    return Row(
        part,
        peer.title,
        speed,
        "x real time",
        ratio,
        "ok" if agrees else "disagrees",
        peer.version(),
        agreement or "the reference",
        f"{note}; {float(found['ready']):.1f} s before the first step",
    )


def agreed(q: Array, ours: Array) -> tuple[bool, str]:
    """Whether a trajectory equals that of dmframe, and the largest distance."""
    if q.shape != ours.shape:
        return False, f"{q.shape[0]} samples for {ours.shape[0]}"
    distance = float(np.max(np.abs(q - ours)))
    if not np.isfinite(distance):
        return False, "not finite everywhere"
    return distance <= TOLERANCE, f"{distance:.1e} rad"
