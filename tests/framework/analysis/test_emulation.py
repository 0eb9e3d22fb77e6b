"""The largest adaptation gain for a sampling period, compared with a formula and with runs that diverge."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dmframe.analysis import emulation_limits, equilibrium, frozen
from dmframe.graph.graph import Graph
from dmframe.robot.chain import pin_configuration
from dmframe.simulate import simulate

CLOCK = 0.002


def limit(*overrides: str, clock: float = CLOCK, name: str = "arm2_joint") -> Any:
    graph = Graph.read(name, overrides)
    diagram = graph.diagram
    point = equilibrium(frozen(diagram), start=graph.start)
    (found,) = emulation_limits(diagram, clock, point, solver=graph.solver, start=graph.start)
    return found, diagram, point


def test_at_the_set_point_it_is_the_formulas_by_hand() -> None:
    found, diagram, point = limit("path.center=[45 deg, 60 deg]", "path.amplitude=[0, 0]")
    import pinocchio as pin

    model = diagram.robot.model
    q = point[
        [variable.label for variable in diagram.loop.variables for _ in range(variable.symbol.numel())].index("arm.q") :
    ][:2]
    zero = np.zeros(model.nv)
    data = model.createData()
    Y = pin.computeJointTorqueRegressor(model, data, pin_configuration(diagram.robot, q), zero, zero)
    K_P = np.array([60.0, 30.0])  # w = 1/(K K_P)
    largest = np.max(np.linalg.eigvalsh(Y.T @ np.diag(1 / K_P) @ Y))
    assert found.at_rest == pytest.approx(2 / (CLOCK * 100 * largest), rel=1e-9)
    assert found.on_path == pytest.approx(found.at_rest, rel=1e-3)  # the path is constant
    assert found.value == 100


def test_it_falls_with_the_clock_and_with_the_gain() -> None:
    found, _, _ = limit()
    twice, _, _ = limit("dynamics.Gamma=200", clock=2 * CLOCK)
    assert twice.at_rest == pytest.approx(found.at_rest / 4, rel=1e-9)
    assert twice.on_path == pytest.approx(found.on_path / 4, rel=0.05)


def test_runs_diverge_within_a_factor_of_three_of_it() -> None:
    found, _, _ = limit()
    bounded = []
    for share in (1 / 3, 3):
        gain = f"dynamics.Gamma={100 * found.on_path * share}"
        graph = Graph.read("arm2_joint", [gain, "dynamics.a_d_hat_box=null"])  # its box would bound the estimate
        run = simulate(graph.diagram, 4.0, clock=CLOCK, solver=graph.solver, start=graph.start)
        bounded.append(run.divergence is None)
    assert bounded == [True, False]


def test_a_graph_without_estimates_has_none() -> None:
    graph = Graph.read("pendulum_kinematic")
    diagram = graph.diagram
    assert emulation_limits(diagram, CLOCK, equilibrium(frozen(diagram), start=graph.start)) == ()


def test_a_full_gain_is_that_of_its_matrix() -> None:
    plain, _, _ = limit()
    Gamma = np.diag([100.0] * 22)
    Gamma[0, 1] = Gamma[1, 0] = 1e-9
    for share in (1, 2):
        full, _, _ = limit(f"dynamics.Gamma={(share * Gamma).tolist()}", "dynamics.a_d_hat_box=null")
        assert full.value == share * 100
        assert full.at_rest == pytest.approx(plain.at_rest / share, rel=1e-6)
