"""Many runs of one diagram with different parameters, on all cores of one process."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypedDict, TypeVar, Unpack, overload

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.simulate.engine import Choice
from dmframe.simulate.keep import Log
from dmframe.simulate.recording import Recording
from dmframe.simulate.run import prepare
from dmframe.simulate.solver import Solver
from dmframe.simulate.start import start_state

START = "start"
"""Key of a variant's initial values."""

T = TypeVar("T")


class Settings(TypedDict, total=False):
    """Settings of `simulate`, and `threads`: how many runs are computed at once, by default one per core."""

    clock: float | None
    solver: Solver | None
    start: Mapping[str, Any] | None
    engine: Choice
    log: Log | None
    threads: int | None
    seed: int
    jitter: float


@overload
def simulate_many(
    diagram: Diagram, variants: Sequence[Mapping[str, Any]], duration: float, **settings: Unpack[Settings]
) -> list[Recording | DmframeError]: ...
@overload
def simulate_many(
    diagram: Diagram,
    variants: Sequence[Mapping[str, Any]],
    duration: float,
    *,
    reduce: Callable[[Recording], T],
    **settings: Unpack[Settings],
) -> list[T | DmframeError]: ...
def simulate_many(
    diagram: Diagram,
    variants: Sequence[Mapping[str, Any]],
    duration: float,
    *,
    reduce: Callable[[Recording], Any] | None = None,
    **settings: Unpack[Settings],
) -> list[Any]:
    """Run a closed loop once for each variant; the loop is built and compiled once.

    Parameters
    ----------
    variants
        Parameters by label, ``{"dynamics.Gamma": 10, "start": {"q": [...]}}``; others are those of the diagram
        and `start`.
    reduce
        Reduces each run to a result, to save memory; without it the recordings are returned.
    settings
        See `Settings`. The interpreted engine uses one thread. All runs use the same random numbers, so that they can
        be compared.

    Returns
    -------
    list
        In the order of the variants: the recording, the result of `reduce`, or the fault of a failed start.
    """
    threads, engine = settings.get("threads"), settings.get("engine", "auto")
    if threads is not None and threads < 1:
        raise ValueFault(f"threads: expected at least 1, found {threads}")
    prepared = prepare(
        diagram,
        duration,
        clock=settings.get("clock"),
        solver=settings.get("solver") or Solver(),
        log=settings.get("log") or Log(),
        seed=settings.get("seed", 0),
        jitter=settings.get("jitter", 0.0),
    )
    chosen, start = prepared.engine(engine, len(variants)), settings.get("start") or {}

    def one(variant: Mapping[str, Any]) -> Any:
        try:
            numbers = {key: value for key, value in variant.items() if key != START}
            with SYMBOLIC:
                varied = with_values(diagram, numbers)
                state = start_state(
                    varied, {**start, **variant.get(START, {})}, prepared.starts, prepared.step.instants
                )
            run = prepared.complete(varied, state, engine, shared=chosen)
            with SYMBOLIC:
                return run if reduce is None else reduce(run)
        except DmframeError as fault:
            return fault

    if chosen.name != "compiled":
        return [one(variant) for variant in variants]
    pool = ThreadPoolExecutor(threads or cores())
    try:
        return list(pool.map(one, variants))
    finally:
        pool.shutdown(cancel_futures=True)  # at Ctrl-C, pending runs are cancelled


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
