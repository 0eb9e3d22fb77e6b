"""With q_r = q_d and a PI servo the arm misses its goal: by hand, by the closed form of the equilibrium, and by V."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from dmframe.block.model import symbols_in
from dmframe.certify import Verdict, verify
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate

Array = NDArray[np.float64]
GOAL, K_P, K_I, B = np.array([0.3, 0.4]), np.array([20.0, 10.0]), np.array([40.0, 20.0]), np.array([1.0, 0.5])
GAMMA, LAMBDA, LAMBDA_I, DURATION = 1.0, 0.01, 1.0, 20.0
RESTING = np.array([-0.13733102, -0.06096486])  # [rad] q - q_d at the equilibrium
G = 9.81  # [m/s^2]


def arm(q: Array, dq: Array) -> tuple[Array, Array, Array]:
    """M, C dq and g of the arm, by hand: lengths 0.45 and 0.4 m, 6 and 3.5 kg at 0.2 and 0.17 m of the joints."""
    b = 3.5 * 0.45 * 0.17 * np.cos(q[1])
    h = 3.5 * 0.45 * 0.17 * np.sin(q[1])
    a_2 = 0.05 + 3.5 * 0.17**2
    a_1 = 0.12 + 6 * 0.2**2 + 3.5 * 0.45**2 + a_2
    M = np.array([[a_1 + 2 * b, a_2 + b], [a_2 + b, a_2]])
    velocity = np.array([-h * (2 * dq[0] * dq[1] + dq[1] ** 2), h * dq[0] ** 2])
    return M, velocity, gravity(q) @ [6 * 0.2, 0, 3.5, 3.5 * 0.17, 0]


def gravity(q: Array) -> Array:
    """The non-zero columns of Y_d(q, dq, 0, 0): first moments of link 1, mass and moments of link 2."""
    c, s, c_12, s_12 = np.cos(q[0]), np.sin(q[0]), np.cos(q[0] + q[1]), np.sin(q[0] + q[1])
    return G * np.array([[c, -s, 0.45 * c, c_12, -s_12], [0, 0, 0, c_12, -s_12]])


def rate(_: float, state: Array) -> Array:
    """Eqs. (3), (6), (12) and (14)-(16) with constant q_r = q_d, so that s = dq and Y_d contains gravity only."""
    q, dq, q_c, w, w_I = state[:10].reshape(5, 2)
    a_hat = state[10:]
    Y_d = gravity(q)
    tau = Y_d @ a_hat
    dq_c = w_I * (GOAL - q_c) + w * tau
    u = -K_P * (dq - dq_c) - K_I * (q - q_c)
    M, velocity, g = arm(q, dq)
    ddq = np.linalg.solve(M, u - velocity - B * dq - g)
    adapted = (-LAMBDA * tau * dq, LAMBDA_I * (q_c - GOAL) * dq, -GAMMA * Y_d.T @ dq)
    return np.concatenate([dq, ddq, dq_c, *adapted])


@cache
def by_hand() -> Array:
    """The last state: q, dq, q_c, w, w_I and five of a_d_hat. The robot starts at its goal, the estimates at zero."""
    start = np.concatenate([GOAL, np.zeros(2), GOAL, np.zeros(2), np.ones(2), np.zeros(5)])
    return np.asarray(
        scipy.integrate.solve_ivp(rate, (0, DURATION), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    )


@cache
def done(*overrides: str) -> tuple[Graph, Recording, Verdict]:
    graph = Graph.read("lesson_q_r_is_q_d", overrides)
    diagram = graph.diagram
    run = simulate(diagram, graph.file.duration, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    return graph, run, verify(diagram)


def error(run: Recording) -> Array:
    return np.asarray(run["arm.q"][-1] - run["path.q_d"][-1])


def test_the_arm_stops_where_an_independent_simulation_stops() -> None:
    graph, run, _ = done()
    assert graph.file.duration == DURATION
    q, dq, _, w, w_I = by_hand()[:10].reshape(5, 2)
    assert np.abs(dq).max() < 1e-10
    np.testing.assert_allclose(q - GOAL, RESTING, atol=1e-7)
    np.testing.assert_allclose(error(run), RESTING, atol=1e-7)
    np.testing.assert_allclose(run["inverse.w"][-1], w, atol=1e-9)
    np.testing.assert_allclose(run["inverse.w_I"][-1], w_I, atol=1e-8)


def test_the_resting_error_is_the_equilibriums_closed_form() -> None:
    r"""At equilibrium the servo holds gravity, K_I (q_c - q) = g, with zero command: w_I (q_d - q_c) + w tau_dc = 0."""
    _, run, _ = done()
    q, tau = run["arm.q"][-1], run["dynamics.tau_dc"][-1]
    _, _, g = arm(q, np.zeros(2))
    closed = -g / K_I + run["inverse.w"][-1] * tau / run["inverse.w_I"][-1]
    np.testing.assert_allclose(error(run), closed, atol=1e-9)
    assert np.abs(run["arm.dq"][-1]).max() < 1e-9
    assert np.linalg.norm(closed) > 0.15  # [rad]: larger than rounding


def test_the_identity_is_proved_and_the_error_is_bounded_as_v_states() -> None:
    _, run, verdict = done()
    assert verdict.outcome == "proved"
    # V(0) of eq. (18) without the kinematics: at the goal, at rest, all errors are estimation errors
    masses, moments = [6, 3.5], [6 * 0.2, 3.5 * 0.17]
    inertias = [0.01, 0.004, *2 * [0.12 + 6 * 0.2**2], *2 * [0.05 + 3.5 * 0.17**2]]
    V_0 = np.sum(np.square([*masses, *moments, *inertias, *B])) / (2 * GAMMA)
    V_0 += np.sum(1 / K_P) / (2 * LAMBDA) + np.sum(K_P * (1 - K_I / K_P) ** 2) / (2 * LAMBDA_I)
    assert np.sum(K_I * error(run) ** 2) < 2 * V_0


def moves_with_the_position(verdict: Verdict) -> bool:
    """True if dV/dt dissipates a square in q, from which convergence of the position could follow."""
    assert verdict.claim is not None
    (q,) = (variable.symbol for variable in verdict.claim.loop.plant if variable.label == "arm.q")
    spent = [term for part in verdict.claim.parts for term in part.certificate.dissipation if hasattr(term, "vector")]
    return any(symbols_in([term.vector]) & symbols_in([q]) for term in spent)


def positions_said_to_vanish(verdict: Verdict) -> list[str]:
    """Statements that a function of q converges to zero; dq is not one."""
    found = [item.signal for item in verdict.statements if "zero" in item.says]
    return [signal for signal in found if re.search(r"(?<![a-zA-Z_])q(?![a-zA-Z])", signal)]


def test_no_output_claims_that_the_position_error_goes_to_zero() -> None:
    _, _, verdict = done()
    assert not moves_with_the_position(verdict)
    assert any("zero" in item.says for item in verdict.statements)  # the velocity error
    assert positions_said_to_vanish(verdict) == []


def test_with_the_term_in_the_error_it_goes_to_zero_and_dv_dt_dissipates_it() -> None:
    _, run, verdict = done("task.type=joint_tracking", "task.alpha_bar=2")
    assert verdict.outcome == "proved"
    assert moves_with_the_position(verdict)
    assert positions_said_to_vanish(verdict)
    assert np.linalg.norm(error(run)) < 1e-3 * np.linalg.norm(RESTING)


PID = (
    *("servo.type=pid_servo", "servo.K_D=[20, 10]", "servo.K_P=[40, 20]", "servo.K_I=[20, 10]"),
    *("inverse.type=pid_inverse", "inverse.K_c=1", "inverse.Lambda_P=1", "inverse.w_P=1", "inverse.tie=velocity"),
)


def test_over_a_pid_servo_with_a_tied_velocity_the_paper_is_right() -> None:
    """Here dV/dt dissipates q - q_r, and q_r equals q_d if the robot starts on its path."""
    _, run, verdict = done("duration=60 s", *PID)
    assert verdict.outcome == "proved"
    assert moves_with_the_position(verdict)
    assert positions_said_to_vanish(verdict)
    assert np.linalg.norm(error(run)) < 1e-3 * np.linalg.norm(RESTING)
