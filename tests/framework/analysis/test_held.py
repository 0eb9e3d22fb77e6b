"""Linear loops on a clock: the held flow against runs, the proved interval against SciPy, V along irregular samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest
from flint import arb, arb_mat
from scipy.linalg import expm

import dmframe as dm
from dmframe.analysis.held import HeldLoop, held_loop
from dmframe.analysis.held_storage import HeldStorage, find_storage, proved_interval
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.diagram import Diagram
from dmframe.exact.ball_matrix import exactly, middles
from dmframe.exact.balls import UndecidedError
from dmframe.simulate import simulate

SERVO = """
dmframe: 1
title: One joint with a vertical axis through a servo
robot: {model: ur10, free: [shoulder_pan_joint], tool: ee_link}
clock: 8 ms
duration: 10 s
start: {q: [0 deg]}
blocks:
  path:    {type: sinusoid, center: [0], amplitude: [0.3], rate: [0.5]}
  task:    {type: joint_tracking, alpha_bar: 2}
  inverse: {type: kinematic_command}
  servo:   {type: pi_servo, K_P: 800, K_I: 1760}
  arm:     {type: manipulator, viscous: 5}
"""


class Law(AbstractBlock):
    """u = -k y - i - f, di/dt = c y, df/dt = 5 (y - f): two states that take Euler steps."""

    inputs = (Input("y"),)
    outputs = (Output("u", access=Access.COMMANDED),)
    states: ClassVar[tuple[State, ...]] = (State("i"), State("f"))
    k: Scalar = Real(default=3.0)
    c: Scalar = Real(default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"u": -p.k * u.y - x.i - x.f}, rates={"i": p.c * u.y, "f": 5 * (u.y - x.f)})


class Cart(AbstractBlock):
    """dy/dt = v, dv/dt = 4 (u - v), and the integral of u, which acts on nothing."""

    side = Side.PLANT
    inputs = (Input("u"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states: ClassVar[tuple[State, ...]] = (State("y"), State("v"), State("sum"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": x.v, "v": 4 * (u.u - x.v), "sum": u.u})


def cart(**gains: float) -> Diagram:
    return Diagram.build({"law": Law(**gains), "cart": Cart()})


def numbers(loop: HeldLoop) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return middles(loop.A), middles(loop.E), middles(loop.K)


def flow(loop: HeldLoop, time: float) -> np.ndarray:
    """Transition of (x, v) with held v, dx/dt = (A - E K) x + E v, by SciPy."""
    A, E, K = numbers(loop)
    held = np.zeros((len(K), len(A) + len(K)))
    return np.asarray(expm(np.vstack([np.hstack([A - E @ K, E]), held]) * time))


def after_a_sample(loop: HeldLoop, time: float) -> np.ndarray:
    """The map of x from one sample to the next."""
    K, size = numbers(loop)[2], loop.A.nrows()
    whole = flow(loop, time)[:size]
    return np.asarray(whole[:, :size] + whole[:, size:] @ K)


def largest_equal_period(loop: HeldLoop) -> float:
    """First unstable period of equal intervals, by the spectral radius."""
    for period in np.geomspace(1e-3, 20, 4000):
        if np.max(np.abs(np.linalg.eigvals(after_a_sample(loop, float(period))))) >= 1:
            return float(period)
    return float("inf")


def first_order(k: float) -> HeldLoop:
    """dx/dt = -k x(t_k)."""
    return HeldLoop(("x",), ("u",), exactly([[-k]]), exactly([[1.0]]), exactly([[-k]]))


def drawn(seed: int) -> HeldLoop:
    """A plant with two or three states and one or two commands under state feedback, stable in continuous time."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    while True:
        F, E, K = rng.normal(size=(n, n)), rng.normal(size=(n, m)), 2 * rng.normal(size=(m, n))
        if np.max(np.linalg.eigvals(F + E @ K).real) < -0.2:
            names = tuple(f"x{k}" for k in range(n)), tuple(f"u{k}" for k in range(m))
            return HeldLoop(*names, exactly(F + E @ K), exactly(E), exactly(K))


def test_the_matrices_of_a_pd_law_and_of_a_servo_are_those_by_hand() -> None:
    found = held_loop(dm.load("pd_torque").diagram)
    A, E, K = numbers(found)
    M = 1 / E[1, 0]
    assert found.states == ("arm.q", "arm.dq")
    assert found.held == ("command.tau_c",)
    np.testing.assert_allclose(A, [[0, 1], [-40 / M, -35 / M]])
    np.testing.assert_allclose(K, [[-40, -30]])
    servo = held_loop(dm.load(SERVO).diagram)
    assert servo.states == ("servo.i", "arm.q", "arm.dq")  # q_c acts on nothing
    np.testing.assert_allclose(numbers(servo)[0], [[0, 2, 1], [0, 0, 1], [-1760 / M, -1600 / M, -805 / M]])
    np.testing.assert_allclose(numbers(servo)[2], [[0, -2, 0]])


def test_a_run_with_euler_steps_is_the_flow_with_held_rates_at_every_sample() -> None:
    diagram, period = cart(), 0.13
    loop = held_loop(diagram)
    assert loop.states == ("law.i", "law.f", "cart.y", "cart.v")
    assert loop.held == ("law.u", "d law.i/dt", "d law.f/dt")
    start = {"cart.y": 0.7, "cart.v": -0.3, "law.i": 0.2, "law.f": -0.1}
    run = simulate(diagram, 20 * period, clock=period, start=start)
    x = np.array([start[label] for label in loop.states])
    for k in range(20):
        found = [float(np.ravel(run.states[label][k])[0]) for label in loop.states]
        np.testing.assert_allclose(found, x, atol=1e-8)
        x = after_a_sample(loop, period) @ x


@pytest.mark.parametrize("k", [0.5, 3.0])
def test_with_one_state_the_interval_is_the_exact_limit(k: float) -> None:
    assert 0.999 * 2 / k < find_storage(first_order(k)).interval < 2 / k


def packaged() -> list[HeldLoop]:
    pid = SERVO.replace("{type: pi_servo, K_P: 800, K_I: 1760}", "{type: pid_servo, K_D: 800, K_P: 1760, K_I: 560}")
    return [*(held_loop(dm.load(graph).diagram) for graph in ("pd_torque", SERVO, pid)), held_loop(cart())]


def test_the_interval_is_below_the_limit_of_equal_intervals_and_near_it() -> None:
    for loop in packaged():
        limit, found = largest_equal_period(loop), find_storage(loop).interval
        assert 0.7 * limit < found < limit, (loop.states, found, limit)


@pytest.mark.parametrize("seed", range(8))
def test_no_drawn_loop_has_an_interval_above_its_limit(seed: int) -> None:
    loop = drawn(seed)
    found = find_storage(loop).interval
    assert 0 < found < largest_equal_period(loop)


def rises(loop: HeldLoop, storage: HeldStorage, rng: np.random.Generator, samples: int = 30) -> int:
    """Number of increases of V between eight instants of each of some irregular intervals and over their ends."""
    _, _, K = numbers(loop)
    x, count, before = rng.normal(size=loop.A.nrows()), 0, np.inf
    for _ in range(samples):
        length, v = storage.interval * (1 - rng.uniform() ** 3), K @ x
        for tau in length * np.linspace(0.01, 1, 8):
            now = (flow(loop, float(tau)) @ np.append(x, v))[: len(x)]
            e = v - K @ now
            psi = storage.gamma / np.tan(storage.gamma * tau)
            V = now @ storage.P @ now + float((psi - storage.beta) * e @ storage.W @ e)
            count += bool(before < V)
            before = V
        x = now
        V = float(x @ storage.P @ x)
        count += bool(before < V)
        before = V
    return count


def test_v_falls_along_and_over_irregular_samples() -> None:
    rng = np.random.default_rng(1)
    for loop in [*packaged(), drawn(2), drawn(5)]:
        storage = find_storage(loop)
        assert sum(rises(loop, storage, rng) for _ in range(5)) == 0
        longer = replace(storage, interval=1.6 * storage.interval)
        assert sum(rises(loop, longer, rng) for _ in range(5)) > 0  # the test sees an interval that is too long


def changed(loop: HeldLoop, **matrices: np.ndarray) -> HeldLoop:
    return replace(loop, **{name: exactly(value) for name, value in matrices.items()})


def test_seeded_faults_leave_no_interval() -> None:
    for loop in [*packaged(), drawn(2)]:
        storage, (A, E, K) = find_storage(loop), numbers(loop)
        assert proved_interval(loop, storage) == storage.interval
        longer = replace(storage, beta=storage.beta / 1.4, gamma=storage.gamma / 1.4)
        assert proved_interval(loop, longer) == 0  # numbers of an interval that is 1.4 times as long
        assert proved_interval(loop, replace(storage, W=storage.W * 30)) == 0
        assert proved_interval(loop, replace(storage, P=-storage.P)) == 0
        assert proved_interval(loop, replace(storage, W=-storage.W)) == 0
        assert proved_interval(changed(loop, A=A + E @ K), storage) == 0  # twice the feedback in continuous time
        assert proved_interval(changed(loop, K=2 * K), storage) == 0  # another growth of the held error
        assert proved_interval(changed(loop, A=-A), storage) == 0


def test_the_interval_is_proved_for_all_matrices_in_an_enclosure() -> None:
    loop = held_loop(cart())
    storage = find_storage(loop)
    A = arb_mat([[arb(float(value), 1e-13) for value in row] for row in numbers(loop)[0]])
    assert proved_interval(replace(loop, A=A), storage) == storage.interval
    A = arb_mat([[arb(float(value), 1.0) for value in row] for row in numbers(loop)[0]])
    assert proved_interval(replace(loop, A=A), storage) == 0


@pytest.mark.parametrize(
    ("graph", "reason"),
    [
        ("joint_tracking_pi", "the law is not linear: dynamics.a_d_hat is projected onto a set"),
        (
            "computed_torque",
            r"slopes are not bounded: the slope of d arm.dq\[0\]/dt depends on torque.tau_c",
        ),
        ("gravity_compensated_servo", "the law is not linear: dynamics.a_d_hat is projected onto a set"),
        ("ur10_slow_sampled", "the loop is not emulated: a block looks ahead"),
        ("ur10_consistent", "the step of dynamics.a_d_hat has a term of second order"),
    ],
)
def test_another_loop_is_refused_by_name(graph: str, reason: str) -> None:
    with pytest.raises(UndecidedError, match=reason):
        held_loop(dm.load(graph).diagram)


def test_a_loop_that_is_unstable_in_continuous_time_has_no_interval() -> None:
    with pytest.raises(UndecidedError, match=r"in continuous time it has a pole at .* 1/s among law.i, law.f, cart.y"):
        find_storage(held_loop(cart(c=40.0)))


def test_a_law_that_reads_nothing_is_refused() -> None:
    class Constant(AbstractBlock):
        outputs = (Output("u", access=Access.COMMANDED),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Any:
            return Equations(outputs={"u": 1.0})

    with pytest.raises(UndecidedError, match="no held signal depends on a state"):
        held_loop(Diagram.build({"law": Constant(), "cart": Cart()}))
