"""Many runs of one diagram with different numbers, on all cores of one process."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, overload

from dmframe.block.model import SYMBOLIC
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.errors import DmframeError, ValueFault
from dmframe.simulate.engine import Choice
from dmframe.simulate.keep import Log
from dmframe.simulate.run import Recording, prepare
from dmframe.simulate.start import start_state
from dmframe.simulate.step import Solver

START = "start"
"""The key of a variant that holds start values."""

T = TypeVar("T")


@overload
def simulate_many(
    diagram: Diagram,
    variants: Sequence[Mapping[str, Any]],
    duration: float,
    *,
    clock: float | None = ...,
    solver: Solver | None = ...,
    start: Mapping[str, Any] | None = ...,
    engine: Choice = ...,
    log: Log | None = ...,
    threads: int | None = ...,
    seed: int = ...,
    jitter: float = ...,
) -> list[Recording | DmframeError]: ...
@overload
def simulate_many(
    diagram: Diagram,
    variants: Sequence[Mapping[str, Any]],
    duration: float,
    *,
    reduce: Callable[[Recording], T],
    clock: float | None = ...,
    solver: Solver | None = ...,
    start: Mapping[str, Any] | None = ...,
    engine: Choice = ...,
    log: Log | None = ...,
    threads: int | None = ...,
    seed: int = ...,
    jitter: float = ...,
) -> list[T | DmframeError]: ...
def simulate_many(
    diagram: Diagram,
    variants: Sequence[Mapping[str, Any]],
    duration: float,
    *,
    reduce: Callable[[Recording], Any] | None = None,
    clock: float | None = None,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    engine: Choice = "auto",
    log: Log | None = None,
    threads: int | None = None,
    seed: int = 0,
    jitter: float = 0.0,
) -> list[Any]:
    """Run a closed loop once for each variant; the loop is built and compiled once.

    Parameters
    ----------
    variants
        Parameters by label, ``{"dynamics.Gamma": 10, "start": {"q": [...]}}``; the rest is the diagram's and `start`'s.
    reduce
        Makes of each run what is kept of it, so that thousands need no memory; without it the runs are kept whole.
    threads
        How many run at once; by default as many as the process may use cores. The interpreted engine uses one.
    seed, jitter
        As of `simulate`; the same numbers are drawn in every run, so that runs compare.

    Returns
    -------
    list
        In the order of the variants: the run or what `reduce` made of it; for one that could not be run, its fault.
    """
    if threads is not None and threads < 1:
        raise ValueFault(f"threads: expected at least 1, found {threads}")
    prepared = prepare(
        diagram, duration, clock=clock, solver=solver or Solver(), log=log or Log(), seed=seed, jitter=jitter
    )
    chosen = prepared.engine(engine, len(variants))

    def one(variant: Mapping[str, Any]) -> Any:
        try:
            numbers = {key: value for key, value in variant.items() if key != START}
            begin = {**(start or {}), **variant.get(START, {})}
            with SYMBOLIC:
                varied = with_values(diagram, numbers)
                state = start_state(varied, begin, prepared.starts, prepared.step.instants)
            run = prepared.complete(varied, state, engine, shared=chosen)
            if reduce is None:
                return run
            with SYMBOLIC:
                return reduce(run)
        except DmframeError as fault:
            return fault

    if chosen.name != "compiled":
        return [one(variant) for variant in variants]
    pool = ThreadPoolExecutor(threads or cores())
    try:
        return list(pool.map(one, variants))
    finally:
        pool.shutdown(cancel_futures=True)  # at Ctrl-C, those that run end, and no other begins


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
