"""(f): a batch of runs over a grid of gains, all cores, against Jaxonomy's `simulate_batch` and JAX's `vmap`."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from tests.benchmarks.closed_loop import TOLERANCE
from tests.benchmarks.loop import Array, Loop
from tests.benchmarks.machine import of
from tests.benchmarks.peers import find
from tests.benchmarks.table import Row, Section
from tests.benchmarks.worker import Failed, measure

GRAPH = "ur10_fast"


def grid(size: int) -> Array:
    """(gamma, Gamma, Lambda) of each run; for `size` runs the first of 1000."""
    gamma, Gamma, Lambda = np.linspace(0.5, 1.5, 10), np.logspace(0, 1, 10), np.logspace(-3, -2, 10)
    return np.array(list(product(gamma, Gamma, Lambda)))[:: max(1, 1000 // size)][:size]


def in_simd(size: int, seconds: float, step: float) -> dict[str, Any]:
    """`dmframe.batch`: stores figures of the error and the last pose; values, starts and steps are part of its time."""
    from dataclasses import replace

    from dmframe.batch.batch import Batch
    from dmframe.batch.figures import MeasuredSignals
    from dmframe.graph.graph import Graph

    loaded = Graph.read(GRAPH)
    settings = {**loaded.settings, "solver": replace(loaded.solver, step=step)}
    batch = Batch.of(loaded.diagram, seconds, wanted=MeasuredSignals(("arm.q",)), engine="compiled", **settings)
    gamma, Gamma, Lambda = grid(size).T
    values = {"task.gamma": gamma, "dynamics.Gamma": Gamma, "inverse.Lambda": Lambda}
    batch.measure({label: column[:2] for label, column in values.items()})
    begin = time.perf_counter()
    found = batch.measure(values)
    return {"wall": time.perf_counter() - begin, "q": found.signals["arm.q"].last}


def whole(size: int, seconds: float, step: float) -> dict[str, Any]:
    """`simulate_many`, of which the last pose of each run is stored."""
    from dataclasses import replace

    from dmframe.graph.graph import Graph
    from dmframe.simulate import simulate_many

    loaded = Graph.read(GRAPH)
    diagram = loaded.diagram
    variants = [
        {"task.gamma": gamma, "dynamics.Gamma": Gamma, "inverse.Lambda": Lambda} for gamma, Gamma, Lambda in grid(size)
    ]

    def go(chosen: list[dict[str, float]]) -> Any:
        return simulate_many(
            diagram,
            chosen,
            seconds,
            clock=loaded.file.clock,
            solver=replace(loaded.solver, step=step),
            start=loaded.start,
            engine="compiled",
            reduce=lambda run: run["arm.q"][-1],
        )

    go(variants[:2])
    begin = time.perf_counter()
    found = go(variants)
    return {"wall": time.perf_counter() - begin, "q": np.array(found)}


def gains(loop: Loop, size: int) -> dict[str, Array]:
    """The values of the grid, in the shapes of the loop, with the run as first axis."""
    values = grid(size)
    return {
        "gamma": values[:, 0],
        "Gamma": np.repeat(values[:, 1:2], loop.gains["Gamma"].size, axis=1),
        "Lambda": np.repeat(values[:, 2:3], loop.n, axis=1),
    }


def by_jaxonomy(size: int, seconds: float, step: float, *, together: bool = False) -> dict[str, Any]:
    """`simulate_batch`; compiled again at each call, so its time includes compilation."""
    import logging

    import jaxonomy as jx

    from tests.benchmarks.peers.jaxonomy_blocks import diagram

    logging.getLogger("jaxonomy").setLevel(logging.WARNING)
    loop = Loop.read(GRAPH)
    system, port = diagram(loop)
    ticks = loop.ticks(seconds)
    options = jx.SimulatorOptions(
        math_backend="jax",
        ode_solver_method="rk4",
        max_minor_step_size=loop.T / loop.substeps(step),
        max_major_steps=2 * ticks + 10,
        buffer_length=ticks * (loop.substeps(step) + 2) + 10,
    )
    sweep = {f"controller.{key}": value for key, value in gains(loop, size).items()}
    begin = time.perf_counter()
    found = jx.simulate_batch(
        system, (0.0, ticks * loop.T), sweep, options=options, recorded_signals={"x": port}, use_vmap=together
    )
    x = np.asarray(found.outputs["x"])
    return {"wall": time.perf_counter() - begin, "q": x[:, -1, 2 * loop.n : 3 * loop.n]}


def by_vmap(size: int, seconds: float, step: float) -> dict[str, Any]:
    """Hand-written JAX, all runs in one vectorised loop; its time excludes compilation."""
    import jax
    import jax.numpy as jnp

    from tests.benchmarks.jax_loop import functions, integrated

    loop = Loop.read(GRAPH)
    control, rate, z, x = functions(loop)
    ticks, substeps, n = loop.ticks(seconds), loop.substeps(step), loop.n
    h = loop.T / substeps

    def one(changed: Any) -> Any:
        gain = {**{key: jnp.asarray(value) for key, value in loop.gains.items()}, **changed}

        def tick(k: Any, state: Any) -> Any:
            z, x = state
            dq_c, z = control(k * loop.T, z, x, gain)
            return z, integrated(rate, x, dq_c, h, substeps)

        return jax.lax.fori_loop(0, ticks, tick, (z, x))[1][2 * n : 3 * n]

    sweep = {key: jnp.asarray(value) for key, value in gains(loop, size).items()}
    together = jax.jit(jax.vmap(one)).lower(sweep).compile()
    begin = time.perf_counter()
    q = np.asarray(together(sweep))
    return {"wall": time.perf_counter() - begin, "q": q}


PEERS = {"jaxonomy": "jaxonomy_blocks", "jax": "jax_by_hand"}

METHODS: dict[str, tuple[str, dict[str, Any], str, str]] = {
    "dmframe, figures in SIMD batches": (
        "in_simd",
        {},
        "dmframe",
        "several runs at once in vector registers, on all cores; the error's figures and the last pose are kept",
    ),
    "dmframe, simulate_many": (
        "whole",
        {},
        "dmframe",
        "threads of one process; each run's whole log is made, its last pose kept",
    ),
    "Jaxonomy, simulate_batch": (
        "by_jaxonomy",
        {},
        "jaxonomy",
        "one run after the other; it compiles at each call, which is in its time; records the plant's state",
    ),
    "Jaxonomy, simulate_batch(use_vmap=True)": ("by_jaxonomy", {"together": True}, "jaxonomy", "as above, vectorised"),
    "JAX, vmap by hand": ("by_vmap", {}, "jax", "scalar code, vectorised; without compilation, and without a record"),
}


def section(
    size: int, seconds: float, step: float, limit: float, report: Callable[[str], None] = lambda text: None
) -> Section:
    """One row for each method."""
    rows, reference = list[Row](), dict[str, Any]()
    for name, (job, options, package, note) in METHODS.items():
        report(f"(f) {name}")
        lacking = "" if package == "dmframe" else find(PEERS[package]).missing()
        if lacking:
            rows.append(Row("f", name, status="missing", agreement=lacking.split(": ", 1)[1], note=note))
            continue
        try:
            found = measure(f"batch:{job}", limit, cores=0, size=size, seconds=seconds, step=step, **options)
        except Failed as failure:
            rows.append(Row("f", name, status="failed", agreement=str(failure), version=of(package), note=note))
            continue
        reference = reference or (found if not rows else {})
        rows.append(row(name, found, reference, seconds * size, of(package), note))
    return Section(
        "f",
        f"{size} runs of {GRAPH} over a grid of three gains, {seconds:g} s each, all cores; plant at {step * 1e3:g} ms",
        "how many times as long as dmframe's",
        tuple(rows),
        (f"A row counts if no last joint angle of a run differs by more than {TOLERANCE:g} rad from dmframe's.",),
    )


def row(name: str, found: dict[str, Any], ours: dict[str, Any], simulated: float, version: str, note: str) -> Row:
    """One method's row."""
    if not ours or found is ours:
        ratio, distance, agrees = None, 0.0, True
    else:
        distance = float(np.max(np.abs(found["q"] - ours["q"])))
        agrees = bool(distance <= TOLERANCE)
        ratio = found["wall"] / ours["wall"] if agrees else None
    agreement = "the reference" if found is ours else f"{distance:.1e} rad"
    note = f"{note}; {simulated / found['wall']:.0f} x real time"
    return Row("f", name, found["wall"], "s", ratio, "ok" if agrees else "disagrees", version, agreement, note)
