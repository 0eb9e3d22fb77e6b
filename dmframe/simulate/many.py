"""Many runs of one diagram with different parameters, on all cores of one process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, TypedDict, TypeVar, Unpack, overload

from dmframe.block.model import SYMBOLIC
from dmframe.common.cores import cores
from dmframe.common.errors import DmframeError, StartError, ValueFault
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.simulate.engine import Choice
from dmframe.simulate.keep import Log
from dmframe.simulate.recording import Recording
from dmframe.simulate.run import Prepared, prepare
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
    start = settings.get("start") or {}
    prepared = chosen_for_all(prepared, diagram, start, engine)
    chosen = prepared.engine(engine, len(variants))

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


def chosen_for_all(prepared: Prepared, diagram: Diagram, start: Mapping[str, Any], choice: Choice) -> Prepared:
    """The setup of many runs whose solver states an accuracy: method and steps of one run with the diagram's numbers.

    They replace the automatic ones: a run whose plant is stiffer takes shorter steps. A notice states them.
    """
    solver, accuracy = prepared.solver, prepared.solver.accuracy
    if accuracy is None:
        return prepared
    plainly = prepared.solved_by(solver.automatic)
    if solver.step is not None:
        return plainly
    found: Recording | None = None
    try:
        with SYMBOLIC:
            state = start_state(diagram, start, prepared.starts, prepared.step.instants)
        found = prepared.complete(diagram, state, choice)
    except StartError:  # other runs may have other starts
        pass
    if found is None or found.estimate is None or found.solver.step is None or found.estimate.error > accuracy:
        notice = f"solver.accuracy: steps are automatic, since no run with the graph's own numbers keeps {accuracy:g}"
        return replace(plainly, notices=(*prepared.notices, notice))
    own = replace(solver.automatic, method=found.solver.method, plain=found.solver.step)
    notice = (
        f"solver.accuracy: {own.method} in steps of {plain(found.solver.step, 's')} for all runs; with the graph's own "
        f"numbers, the estimated error of the joints is {found.estimate.error:.1g} {found.estimate.unit}"
    )
    return replace(prepared.solved_by(own), notices=(*prepared.notices, notice))
