"""The vector field of the proof is that of a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from closed_loops import field_of, loop_of, loops, states_of

from dmframe.certify import claim_of
from dmframe.certify.assemble import assembled
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.prove.identity import identity
from dmframe.robot.library import load
from dmframe.simulate import Solver, simulate

KAPPA = 0.7


def at_time(diagram: Diagram, expression: Any, kappa: Any) -> Any:
    """An expression of a claim as a function of (state, t, p, kappa), inside the boxes."""
    loop = diagram.loop
    for projection in loop.projections:
        expression = ca.substitute(expression, projection.correction, ca.SX.zeros(projection.correction.shape))
    weight = ca.SX.sym("weight") if kappa.is_constant() else kappa
    return ca.Function("f", [loop.state, loop.time, loop.p, weight], [loop.on_path(expression)])


@pytest.mark.parametrize("loop", loops(), ids=lambda loop: loop.name)
def test_dv_dt_of_the_claim_is_how_v_moves_along_what_a_run_integrates(loop: Any) -> None:
    diagram = loop.diagram
    claim, p = claim_of(diagram), diagram.loop.p_values
    V = diagram.loop.on_path(claim.V)  # in reverse mode, where the claim's rate is in forward mode
    slopes = [ca.gradient(V, part) for part in (diagram.loop.state, diagram.loop.time)]
    slope, by_time = (at_time(diagram, part, claim.kappa) for part in slopes)
    rate = at_time(diagram, claim.flow.unrecorded(claim.V), claim.kappa)
    field = field_of(diagram)
    for state, t in states_of(diagram, 2, 11):
        terms = slope(state, t, p, KAPPA).full().ravel() * field(state, t)
        moved = terms.sum() + float(by_time(state, t, p, KAPPA))
        assert moved == pytest.approx(float(rate(state, t, p, KAPPA)), abs=1e-8 * np.abs(terms).sum())


def test_a_claim_holds_the_loop_of_its_diagram_and_no_copy() -> None:
    diagram = loops()[0].diagram
    assert claim_of(diagram).loop is diagram.loop


@pytest.mark.parametrize("side", ["controller", "plant"])
def test_what_is_changed_in_the_loop_that_runs_changes_what_is_proved(side: str) -> None:
    honest = loop_of(load("arm2"), "joint", "PID").diagram
    variables = getattr(honest.loop, side)
    changed = tuple(replace(v, own_rate=v.own_rate * 1.01) for v in variables)
    broken = replace(honest, loop=replace(honest.loop, **{side: changed}))
    (state, t), *_ = states_of(honest, 1, 5)
    size = sum(v.symbol.numel() for v in honest.loop.controller)
    part = slice(0, size) if side == "controller" else slice(size, None)
    np.testing.assert_allclose(
        field_of(broken)(state, t)[part], 1.01 * field_of(honest)(state, t)[part], rtol=1e-6, atol=1e-6
    )
    claims = [claim_of(diagram) for diagram in (honest, broken)]
    verdicts = [identity(assembled(claim), trials=1, seed=0).zero for claim in claims]
    assert verdicts == [True, False]


@pytest.mark.parametrize("name", ["arm2_joint", "pendulum"])
def test_v_falls_along_a_run_in_continuous_time(name: str) -> None:
    diagram = Graph.read(name).diagram
    claim = claim_of(diagram)
    run = simulate(diagram, 2.0, solver=Solver("cvodes", output=0.01, tolerance=1e-11), start={})
    V = at_time(diagram, claim.V, claim.kappa)
    labels = [variable.label for variable in diagram.loop.variables]
    states = np.hstack([run.states[label] for label in labels])
    values = np.array([float(V(x, t, diagram.loop.p_values, 1.0)) for x, t in zip(states, run.time, strict=True)])
    steps = np.diff(values)
    assert values[0] > values[-1] > 0
    assert steps.max() <= 1e-9 * values[0]
    assert (steps < 0).mean() > 0.9
