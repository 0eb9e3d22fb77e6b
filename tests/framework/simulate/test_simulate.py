"""Samples, integrators, projection, divergence and interruption, on plants that can be computed by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Box, Interval, Real, Scalar
from dmframe.block.port import TIME, Access, Input, Output, Side, State
from dmframe.common.errors import DmframeError, EngineError, ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, Solver, simulate


class Push(AbstractBlock):
    """r = sin 2 t."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("r", "", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"r": ca.sin(2 * u.t)})


class Adapter(AbstractBlock):
    """v = z + r - y, dz = r - 2 y, with z in a box."""

    inputs = (Input("r", "", ""), Input("y", "", ""))
    outputs = (Output("v", "", "", Access.COMMANDED),)
    states = (State("z", "", "", box="z_box"),)
    z: Scalar = Real(default=0.5)
    z_box: Box = Interval()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": x.z + u.r - u.y}, rates={"z": u.r - 2 * u.y})


class Integrator(AbstractBlock):
    """dy = v: exact for any Runge-Kutta method while v is held."""

    side = Side.PLANT
    inputs = (Input("v", "", ""),)
    outputs = (Output("y", "", "", Access.MEASURED),)
    states = (State("y"),)
    y: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v})


class Alone(AbstractBlock):
    """A plant without a controller, dy = rate(t, y)."""

    side = Side.PLANT
    inputs = (TIME,)
    outputs = (Output("y", "2", "", Access.MEASURED),)
    states = (State("y", "2"),)


class Pendulum(Alone):
    """A driven pendulum."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        rate = ca.vertcat(x.y[1], -ca.sin(x.y[0]) - 0.1 * x.y[1] + ca.cos(u.t))
        return Equations(outputs={"y": x.y}, rates={"y": rate})


class Escape(Alone):
    """The second element is 1 / (1 - t): it diverges at t = 1."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": ca.vertcat(0, x.y[1] * x.y[1])})


class Doubling(Alone):
    """Grows by e^(1000 t): beyond every finite number after 0.7 s."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": ca.vertcat(0, 1000 * x.y[1])})


class Stiff(Alone):
    """dy = -5000 y."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": -5000 * x.y})


class Boxed(Alone):
    """A plant's own state in a box: dy = cos t."""

    states = (State("y", "2", box="y_box"),)
    y_box: Box = Interval("2")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": ca.cos(u.t) * ca.SX.ones(2)})


def toy(**box: Any) -> Diagram:
    return Diagram.build({"push": Push(), "law": Adapter(**box), "cart": Integrator()})


def alone(block: AbstractBlock) -> Diagram:
    return Diagram.build({"plant": block})


def run_alone(block: AbstractBlock, duration: float, y: list[float], **options: Any) -> Recording:
    return simulate(alone(block), duration, start={"y": y}, **options)


def test_three_ticks_are_those_computed_by_hand() -> None:
    run = simulate(toy(), 0.3, clock=0.1, solver=Solver(step=0.1))
    y, z = 1.0, 0.5
    for k in range(3):
        r = np.sin(2 * k * 0.1)
        assert run["cart.y"][k] == pytest.approx(y, abs=1e-15)
        assert run["law.z"][k] == pytest.approx(z, abs=1e-15)
        v = z + r - y  # the command of this instant, from this instant's states and measurement
        assert run["law.v"][k] == pytest.approx(v, abs=1e-15)
        y, z = y + 0.1 * v, z + 0.1 * (r - 2 * y)  # Euler for the law, the command held for the plant
    assert run["cart.y"][3] == pytest.approx(y, abs=1e-15)


def test_ticks_are_integers_times_the_period() -> None:
    run = simulate(toy(), 0.7, clock=0.007)
    assert run.time.size == 101
    assert np.array_equal(run.time, np.arange(101) * 0.007)
    assert run.duration == 100 * 0.007


def test_a_duration_is_rounded_to_whole_ticks() -> None:
    assert simulate(toy(), 0.26, clock=0.1).time[-1] == 3 * 0.1
    assert simulate(toy(), 0.1, clock=0.1).time.size == 2


def test_a_clock_longer_than_the_run_is_refused() -> None:
    with pytest.raises(ValueFault, match="clock: expected at most the simulated time, 10 ms, found 100 ms"):
        simulate(toy(), 0.01, clock=0.1)


@pytest.mark.parametrize("clock", [0.05, None])
def test_a_projected_state_stays_in_its_box_and_leaves_its_end_when_the_rate_turns(clock: float | None) -> None:
    run = simulate(toy(z_box=(0.2, 0.55)), 4.0, clock=clock, solver=Solver(output=0.05))
    free = simulate(toy(), 4.0, clock=clock, solver=Solver(output=0.05))
    z = run["law.z"].ravel()
    assert free["law.z"].min() < 0.2  # the box is active
    assert z.min() == 0.2
    assert z.max() <= 0.55
    rate = (run["push.r"] - 2 * run["cart.y"]).ravel()
    held, left = (z[:-1] == 0.2) & (z[1:] == 0.2), (z[:-1] == 0.2) & (z[1:] > 0.2)
    slack = 0 if clock else 0.1  # in continuous time the rate may change its sign within a sample
    assert np.all(rate[:-1][held] <= slack)
    assert np.all(rate[:-1][left] > -slack)
    assert held.sum() > 5
    assert left.any()


def test_a_start_outside_its_box_is_refused() -> None:
    with pytest.raises(DmframeError) as caught:
        simulate(toy(z_box=(0.7, 0.9)), 0.1, clock=0.1)
    assert str(caught.value) == (
        "law.z: expected a start inside z_box, 0.7 to 0.9, found 0.5; move the start or the box"
    )


def test_a_start_that_misses_its_box_by_rounding_is_put_onto_its_end() -> None:
    run = simulate(toy(z_box=(0.5 + 1e-12, 0.9)), 0.1, clock=0.1)
    assert run["law.z"][0] == 0.5 + 1e-12


@pytest.mark.parametrize("clock", [0.1, None])
def test_a_state_of_the_plant_may_have_a_box(clock: float | None) -> None:
    run = run_alone(Boxed(y_box=(-0.5, 0.5)), 6.0, [0, 0], clock=clock, solver=Solver(output=0.1))
    assert run["plant.y"].max() == pytest.approx(0.5, abs=1e-12)
    t = np.pi * 3 / 2  # since pi/2 it has fallen from 0.5, and reached the other end
    assert run["plant.y"][np.searchsorted(run.time, t) - 1] == pytest.approx(-0.5, abs=1e-9)


def test_rk4_converges_with_the_fourth_order() -> None:
    exact = scipy.integrate.solve_ivp(
        lambda t, y: [y[1], -np.sin(y[0]) - 0.1 * y[1] + np.cos(t)],
        (0, 4),
        [0.5, 0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    ).y[:, -1]
    errors = [
        np.linalg.norm(
            run_alone(Pendulum(), 4.0, [0.5, 0], clock=0.4, solver=Solver(step=0.4 / k))["plant.y"][-1] - exact
        )
        for k in (2, 4, 8, 16)
    ]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(np.abs(orders - 4) < 0.35)


@pytest.mark.parametrize("clock", [0.1, None])
def test_cvodes_and_rk4_agree_on_a_driven_plant(clock: float | None) -> None:
    runs = [
        run_alone(Pendulum(), 4.0, [0.5, 0], clock=clock, solver=Solver(method, 0.001, 0.1, 1e-11))
        for method in ("rk4", "cvodes")
    ]
    np.testing.assert_allclose(runs[0]["plant.y"], runs[1]["plant.y"], atol=1e-8)


@pytest.mark.parametrize(("clock", "how"), [(0.01, "is beyond 1e+10"), (1.0, "is no longer finite")])
def test_a_diverging_run_names_block_state_element_and_time_and_keeps_what_came_before(clock: float, how: str) -> None:
    run = run_alone(Doubling(), 2.0, [1, 1], clock=clock, solver=Solver(step=0.0005))
    assert run.divergence is not None
    assert (run.divergence.block, run.divergence.state, run.divergence.element) == ("plant", "y", 1)
    first = clock * np.ceil(np.log(1e10) / 1000 / clock)
    assert str(run.divergence) == f"plant.y[1] {how} at t = {first:.6g} s"
    assert run.time[-1] == pytest.approx(first - clock)
    assert np.all(np.isfinite(run["plant.y"]))
    np.testing.assert_allclose(run["plant.y"][:, 0], 1)


def test_an_adaptive_integrator_that_gives_up_names_the_state_and_keeps_what_came_before() -> None:
    run = run_alone(Escape(), 2.0, [1, 1], clock=0.003, solver=Solver("cvodes"))
    assert run.divergence is not None
    assert (run.divergence.block, run.divergence.state, run.divergence.element) == ("plant", "y", 1)
    assert "moves too fast for the integrator" in str(run.divergence)
    assert run.divergence.time == pytest.approx(1, abs=0.004)
    np.testing.assert_allclose(run["plant.y"][:300, 1], 1 / (1 - run.time[:300]), rtol=1e-5)


def test_an_integrator_that_fails_at_once_is_an_error() -> None:
    with pytest.raises(EngineError, match="the integrator failed in the first tick"):
        run_alone(Escape(), 2.0, [1, 1], clock=2.0, solver=Solver("cvodes"))


def test_ctrl_c_keeps_what_was_computed() -> None:
    def stop(time: float) -> None:
        if time > 40:
            raise KeyboardInterrupt

    run = simulate(toy(), 200.0, clock=0.1, progress=stop)
    whole = simulate(toy(), 60.0, clock=0.1)
    assert run.interrupted
    assert run.divergence is None
    assert 40 < run.time[-1] < 60
    np.testing.assert_array_equal(run["cart.y"], whole["cart.y"][: run.time.size])


def test_progress_is_reported_in_simulated_seconds_up_to_the_end() -> None:
    reported = list[float]()
    simulate(toy(), 60.0, clock=0.1, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(60)


def test_a_stiff_plant_is_noticed_for_rk4_alone() -> None:
    (notice,) = run_alone(Stiff(), 0.01, [1, 1], clock=0.01, solver=Solver(step=0.001)).notices
    assert notice == (
        "the plant is stiff: at rest h |lambda| = 5.00 for rk4 at 1 ms, stable up to 2.785; "
        "set solver.step: 0.45 ms, remove solver.step for an automatic step, or set solver.method: ros34pw2"
    )
    assert run_alone(Stiff(), 0.01, [1, 1], clock=0.01, solver=Solver(step=0.0004)).notices == ()


def test_the_default_step_of_rk4_is_stable_for_the_plant() -> None:
    run = run_alone(Stiff(), 0.1, [1, 1], clock=0.01)
    assert run.notices == ("the plant is stiff: rk4 takes steps of 450 µs",)
    assert run.solver == Solver(step=0.00045)
    np.testing.assert_allclose(run["plant.y"][-1], 0, atol=1e-20)
    easy = run_alone(Pendulum(), 0.1, [0.5, 0], clock=0.01)
    assert (easy.notices, easy.solver) == ((), Solver(step=0.001))


def test_a_plant_too_stiff_for_any_step_of_rk4_is_run_by_ros34pw2() -> None:
    run = run_alone(Stiff(), 100.0, [1, 1], clock=10.0)
    assert run.solver == Solver("ros34pw2", 0.005)
    assert run.notices == ("the plant is stiff: rk4 would take steps of 450 µs; ros34pw2 is used, with steps of 5 ms",)
    np.testing.assert_allclose(run["plant.y"][-1], 0, atol=1e-6)


def test_a_joint_beyond_a_hundred_times_its_limit_has_diverged() -> None:
    graph = Graph.read("pendulum", ["start.dq=[400]", "clock=2 ms", "duration=2 ms"])
    limit = graph.robot.joints[0].velocity
    assert np.isfinite(limit)
    for speed, diverged in ((50 * limit, False), (400 * limit, True)):
        run = Graph.read("pendulum", [f"start.dq=[{speed}]", "clock=2 ms", "duration=2 ms"]).simulate()
        assert (run.divergence is not None) is diverged
    assert run.divergence is not None
    assert "100 times the joint's limit" in str(run.divergence)
    assert run_alone(Stiff(), 0.01, [1, 1], clock=0.01, solver=Solver("cvodes")).notices == ()


def test_a_run_records_states_and_outputs_once_each() -> None:
    run = simulate(toy(), 0.5, clock=0.1)
    assert sorted(run.outputs) == ["law.v", "push.r"]
    assert sorted(run.states) == ["cart.y", "law.z"]
    np.testing.assert_allclose(run["push.r"].ravel(), np.sin(2 * run.time))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"duration": -1.0}, "duration: expected a positive number of seconds, found -1.0"),
        ({"duration": float("nan")}, "duration: expected a positive number of seconds, found nan"),
        ({"clock": 0.0}, "clock: expected a positive number of seconds, found 0.0"),
        ({"start": {"z": "x"}}, "start.z: expected 1 numbers, found 0"),
        ({"start": {"zz": 1}}, "start.zz: unknown state; choose from cart.y, law.z, near"),
        ({"start": {"z": float("inf")}}, "law.z: expected a finite start, found [inf]"),
    ],
)
def test_a_bad_call_is_refused_with_the_reason(options: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        simulate(toy(), **{"duration": 1.0, "clock": 0.1, **options})
    assert str(caught.value) == text


def test_a_solver_is_one_of_three_with_positive_numbers() -> None:
    with pytest.raises(ValueFault, match=r"solver\.method: expected rk4, ros34pw2 or cvodes, found 'euler'"):
        Solver(method="euler")  # type: ignore[arg-type]
    with pytest.raises(ValueFault, match=r"solver\.step: expected a positive number, found 0"):
        Solver(step=0)


def test_a_log_that_keeps_less_often_than_the_run_is_long_keeps_its_begin() -> None:
    graph = Graph.read("pendulum", ["log.every=1e300"])
    run = simulate(graph.diagram, 0.1, solver=graph.solver, start=graph.start, log=graph.log)
    np.testing.assert_array_equal(run.time, [0.0])


@pytest.mark.parametrize("value", ["1e160", "1e308"])
def test_a_plant_too_steep_to_compute_with_is_reported_without_its_digits(value: str) -> None:
    graph = Graph.read("pendulum", [f"servo.K_D={value}"])
    run = simulate(graph.diagram, 0.02, solver=graph.solver, start=graph.start)
    assert run.notices == (
        "the Jacobian of the plant at the initial state is not finite or exceeds 1e12; use parameters nearer to 1",
    )
    assert run.divergence is not None
