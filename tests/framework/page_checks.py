"""Functions of a live page, compared with a run, the interpreter and the verdict."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from in_wasm import Loaded

from dmframe.certify.claim import claim_of
from dmframe.codegen import loop_module
from dmframe.diagram.closed_loop import stack
from dmframe.exact.rational import as_float
from dmframe.page.functions import Functions, functions_of
from dmframe.report.verification import Verification
from dmframe.results.along import along
from dmframe.results.metrics import tracking_error
from dmframe.simulate import simulate
from dmframe.simulate.instants import Instants
from dmframe.simulate.start import start_state


def functions(found: Verification) -> Functions:
    graph = found.graph
    uncertain = graph.intervals(found.diagram)
    return functions_of(found.diagram, graph.file.clock, graph.start, found.verdict, uncertain=uncertain)


def check_functions(found: Verification) -> None:
    """At the file's own numbers, the page's functions agree with the rest of the framework."""
    made, loop = functions(found), found.diagram.loop
    clock = found.graph.file.clock
    p, instants = loop.p_values, Instants.of(loop, clock) if clock else None
    state = start_state(found.diagram, found.graph.start, instants=instants)
    check_start(found, made, state, p)
    check_judged(found, made, pose_of(found, made, state), p)
    check_module(found, made, state, p)


def check_start(found: Verification, made: Functions, state: np.ndarray, p: np.ndarray) -> None:
    """The whole start follows from the pose; and a pose that is searched is on the path."""
    period = found.graph.file.clock or found.graph.solver.output
    pose = pose_of(found, made, state)
    np.testing.assert_allclose(made.begin(pose, period, p).full().ravel(), state, rtol=1e-12, atol=1e-12)
    if made.reach is not None:
        assert np.abs(made.reach(pose, p)[0].full()).max() < 1e-8


def pose_of(found: Verification, made: Functions, state: np.ndarray) -> np.ndarray:
    """The pose in a state."""
    if made.posed is None:
        return np.zeros(0)
    labels = [v.label for v in found.diagram.loop.variables]
    sizes = [v.symbol.numel() for v in found.diagram.loop.variables]
    at = sum(sizes[: labels.index(made.posed.label)])
    return state[at : at + made.posed.symbol.numel()]


def check_judged(found: Verification, made: Functions, pose: np.ndarray, p: np.ndarray) -> None:
    """Each condition's least margin is the value that was decided exactly."""
    period = found.graph.file.clock or found.graph.solver.output
    judged, verdict = made.judged(pose, period, p).full().ravel(), found.verdict
    for condition, place, reads in zip(made.conditions, made.margins, made.reads, strict=False):
        if place is None:  # a search or random motions decide it, at the file's numbers only
            assert "stays exponentially stable" in condition.name or (condition.how == "sampled" and reads)
            continue
        least = judged[place[0] : sum(place)].min() if place[1] else 0.0
        assert (least > 0 if condition.strict and place[1] else least >= 0) == condition.holds, condition.name
        if condition.value is not None and place[1] and "dominates the cascade's cross term" not in condition.name:
            assert abs(least - condition.value) <= 1e-8 * (1 + abs(least)), condition.name
    if verdict.outcome == "proved" and verdict.kappa is not None and made.kappa is not None:
        assert np.isclose(judged[made.kappa], as_float(verdict.kappa.least), rtol=1e-12)


def flow(found: Verification) -> Any:
    """(state, t, T, p) -> the rates of the plant's continuous states, from the loop's expressions."""
    loop = found.diagram.loop
    rates = loop.on_path(loop.acting([stack(loop.rates_of(loop.flowing))])[0])
    if loop.noises:
        rates = ca.substitute(rates, loop.drawn, 0 * loop.drawn)
    return ca.Function("flow", [loop.state, loop.time, loop.period, loop.p], [ca.densify(rates)])


def check_module(found: Verification, made: Functions, state: np.ndarray, p: np.ndarray) -> None:
    """In WebAssembly each function has CasADi's values, at a random state too."""
    loaded = Loaded(loop_module(made.parts, made.exported))
    rng = np.random.default_rng(0)
    for function in (flow(found), *made.exported):
        given = [rng.uniform(0.2, 1.0, function.numel_in(i)) for i in range(function.n_in())]
        if function.name() in ("flow", "shown", "stored"):
            given[0] = state + rng.uniform(-0.01, 0.01, state.size)
        given[-1] = p
        sizes = [function.numel_out(j) for j in range(function.n_out())]
        results = [np.zeros(made.parts.sizes["X"] if function.name() == "flow" else size) for size in sizes]
        loaded(function.name(), *given, *results)
        expected = function(*map(ca.DM, given))
        for mine, theirs in zip(results, expected if isinstance(expected, tuple) else [expected], strict=True):
            wanted = theirs.full().ravel(order="F")
            np.testing.assert_allclose(mine[mine.size - wanted.size :], wanted, rtol=1e-9, atol=1e-9)


def check_along_a_run(found: Verification) -> None:
    """Error and V of the page's functions are those of a run, instant by instant."""
    made, graph = functions(found), found.graph
    run = simulate(
        found.diagram, 0.5, clock=graph.file.clock, solver=graph.solver, start=graph.start, engine="interpreted"
    )
    states = np.hstack([run.states[v.label] for v in found.diagram.loop.variables])
    period = graph.file.clock or graph.solver.output
    rows = np.array(
        [
            made.shown(x, t, period, run.diagram.loop.p_values).full().ravel()
            for x, t in zip(states, run.time, strict=True)
        ]
    )
    drawn = {group.kind: group for group in made.groups}
    error = tracking_error(run)
    assert error is not None
    np.testing.assert_allclose(_of(rows, drawn["error"]), error.values, atol=1e-12)
    kappa = found.verdict.kappa
    followed = along(claim_of(found.diagram), run, as_float(kappa.chosen) if kappa else 1.0)
    np.testing.assert_allclose(_of(rows, drawn["storage"]).sum(axis=1), followed.V, rtol=1e-9)


def _of(rows: np.ndarray, group: Any) -> np.ndarray:
    return rows[:, group.first : group.first + group.size]
