"""ros34pw2: its order on smooth and stiff plants, compared with closed forms, SciPy and cvodes; its selection."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import TIME, Access, Output, Side, State
from dmframe.common.errors import ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Log, Recording, Solver, simulate, simulate_many
from dmframe.simulate.engine import work_of
from dmframe.simulate.run import Prepared, prepare

PANDA = ["arm.coulomb=[6, 6, 6, 6, 1.3, 1.3, 1.34]"]
"""Coulomb friction on a Panda, with v_0 = 5 mrad/s: its last joint makes h |lambda| 46 at 1 ms."""


class Plant(AbstractBlock):
    """A plant without a controller, dy = rate(t, y)."""

    side = Side.PLANT
    inputs = (TIME,)
    outputs = (Output("y", "2", "", Access.MEASURED),)
    states = (State("y", "2"),)
    speed: Scalar = Real(default=1.0)


class StableLinear(Plant):
    """A driven pendulum, smooth."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        rate = ca.vertcat(x.y[1], -ca.sin(x.y[0]) - 0.1 * x.y[1] + ca.cos(u.t))
        return Equations(outputs={"y": x.y}, rates={"y": rate})


class Chasing(Plant):
    """y tracks sin t, as in Prothero and Robinson's problem, with a nonlinear rate; from y = 0 on it is sin t."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        behind = ca.sin(u.t) - x.y
        pull = behind + 5 * behind**3 + 0.3 * ca.sin(3 * x.y) * behind
        return Equations(outputs={"y": x.y}, rates={"y": p.speed * pull + ca.cos(u.t)})


class VanDerPol(Plant):
    """Van der Pol's oscillator, scaled: the second element is `speed` times as fast as the first."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        rate = ca.vertcat(x.y[1], p.speed * ((1 - x.y[0] ** 2) * x.y[1] - x.y[0]))
        return Equations(outputs={"y": x.y}, rates={"y": rate})


class Late(Plant):
    """dy = -k(t) y, with k from 0 up to `speed`: stiffer later than at the start."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": -p.speed * ca.tanh(u.t) * x.y})


class Singular(Plant):
    """With steps of `speed` the first pivot of I - h gamma A is zero, though the matrix is regular."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        gamma = 4.3586652150845900e-01
        rate = ca.vertcat(x.y[0] / (gamma * p.speed) + x.y[1], x.y[0] + 1)
        return Equations(outputs={"y": x.y}, rates={"y": rate})


class Square(AbstractBlock):
    """dx = -k |x|^2 x, with an expensive Jacobian: ros34pw2 omits it."""

    side = Side.PLANT
    outputs = (Output("x", "40", "", Access.MEASURED),)
    states = (State("x", "40"),)
    k: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"x": x.x}, rates={"x": -p.k * ca.sum1(x.x) ** 2 * x.x - ca.tanh(x.x)})


class Spring(AbstractBlock):
    """x'' = -k |x|^2 x: stiff in the positions only, by a product, with an expensive Jacobian."""

    side = Side.PLANT
    outputs = (Output("y", "40", "", Access.MEASURED),)
    states = (State("x", "40"), State("y", "40"))
    k: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"x": x.y, "y": -p.k * ca.sum1(x.x) ** 2 * x.x - x.y})


def alone(block: AbstractBlock) -> Diagram:
    return Diagram.build({"plant": block})


def ran(block: AbstractBlock, duration: float, y: list[float], step: float, clock: float | None, **options: Any) -> Any:
    solver = Solver("ros34pw2", step, clock or duration)
    return simulate(alone(block), duration, clock=clock, solver=solver, start={"y": y}, **options)


def orders(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("clock", [0.4, None])
def test_it_converges_with_the_third_order_on_a_smooth_plant(clock: float | None, engine: str) -> None:
    exact = scipy.integrate.solve_ivp(
        lambda t, y: [y[1], -np.sin(y[0]) - 0.1 * y[1] + np.cos(t)],
        (0, 4),
        [0.5, 0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    ).y[:, -1]

    def error(step: float) -> float:
        # the last recorded instant is that of the last sample's begin
        run = simulate(
            alone(StableLinear()),
            4.4,
            clock=clock,
            solver=Solver("ros34pw2", step, 0.4),
            start={"y": [0.5, 0]},
            engine=engine,  # type: ignore[arg-type]
        )
        return float(np.linalg.norm(run["plant.y"][np.searchsorted(run.time, 4 - 1e-9)] - exact))

    found = orders([error(0.4 / k) for k in (4, 8, 16, 32)])
    assert np.all(np.abs(found - 3) < 0.3)


@pytest.mark.parametrize("speed", [1e2, 1e3, 1e5])
def test_on_a_plant_that_chases_a_path_it_keeps_the_third_order_at_every_stiffness(speed: float) -> None:
    errors = []
    for k in (2, 4, 8, 16):
        run = ran(Chasing(speed=speed), 2.0, [0, 0], 0.1 / k, 0.1)
        errors.append(float(np.max(np.abs(run["plant.y"][:, 0] - np.sin(run.time)))))
    assert np.all(orders(errors) > 2.4)
    assert errors[-1] < 2e-8  # a thousand times as much without the derivative by time


def test_van_der_pols_oscillator_is_that_of_scipys_radau_at_thousands_of_times_rk4s_step() -> None:
    speed, duration = 1e4, 0.5
    exact = scipy.integrate.solve_ivp(
        lambda t, y: [y[1], speed * ((1 - y[0] ** 2) * y[1] - y[0])],
        (0, duration),
        [2, -2 / 3],
        method="Radau",
        rtol=1e-11,
        atol=1e-13,
        t_eval=np.linspace(0, duration, 51),
        jac=lambda t, y: [[0, 1], [speed * (-2 * y[0] * y[1] - 1), speed * (1 - y[0] ** 2)]],
    ).y.T
    errors = [
        float(np.max(np.abs(ran(VanDerPol(speed=speed), duration, [2, -2 / 3], h, 0.01)["plant.y"] - exact)))
        for h in (0.01, 0.005, 0.0025)
    ]
    assert np.all(orders(errors) > 1.8)
    assert errors[-1] < 1e-5


@pytest.mark.parametrize(("name", "bound"), [("arm2_joint", 2e-7), ("theorem_1", 1e-8), ("computed_torque", 1e-8)])
def test_a_packaged_graph_is_that_of_cvodes_and_nearer_at_half_the_step(name: str, bound: float) -> None:
    graph = Graph.read(name)
    diagram = graph.diagram

    def q(solver: Solver) -> np.ndarray:
        run = simulate(diagram, 0.4, clock=graph.file.clock, solver=solver, start=graph.start, engine="interpreted")
        return run["arm.q"]

    exact = q(Solver("cvodes", None, graph.solver.output, 1e-12))
    errors = [float(np.max(np.abs(q(Solver("ros34pw2", h, graph.solver.output)) - exact))) for h in (1e-3, 5e-4)]
    assert errors[1] < bound
    assert errors[1] < errors[0] / 2.5


@pytest.mark.parametrize(
    ("name", "changes"),
    [("arm2_joint", []), ("ur10_fast", []), ("theorem_1", [])],
)
def test_both_engines_compute_it_alike(name: str, changes: list[str]) -> None:
    graph = Graph.read(name, changes)
    diagram, solver = graph.diagram, Solver("ros34pw2", 1e-3)
    compiled, interpreted = (
        simulate(diagram, 0.2, clock=graph.file.clock, solver=solver, start=graph.start, engine=engine)
        for engine in ("compiled", "interpreted")
    )
    assert (compiled.engine, interpreted.engine) == ("compiled", "interpreted")
    for label, values in {**compiled.states, **compiled.outputs}.items():
        np.testing.assert_allclose(values, interpreted[label], rtol=1e-9, atol=1e-9)


def test_a_library_that_computes_it_wrongly_is_not_loaded(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = tmp_path / "badcc"
    compiler.write_text("#!/bin/sh\nsed -i 's/dm_method_m\\[s\\]/0.5 * &/' loop.c; cc \"$@\"\n", encoding="utf-8")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    run = ran(StableLinear(), 0.1, [0.5, 0], 1e-3, 0.01, engine="compiled")
    assert run.engine == "interpreted"
    assert "built a library that does not work" in run.notices[0]


def test_a_panda_of_h_lambda_46_is_run_compiled_where_rk4_cannot_and_cvodes_is_interpreted() -> None:
    graph = Graph.read("panda_full", PANDA)
    diagram = graph.diagram

    def run(solver: Solver) -> Recording:
        return simulate(diagram, 0.4, clock=graph.file.clock, solver=solver, start=graph.start, engine="compiled")

    exact, plain, chosen = run(Solver("cvodes", tolerance=1e-10)), run(Solver(step=1e-3)), run(Solver())
    assert "at rest h |lambda| = 46." in plain.notices[0]
    assert np.max(np.abs(plain["arm.q"] - exact["arm.q"])) > 1e-3  # friction is bounded: it chatters, and continues
    assert (chosen.engine, chosen.solver) == ("compiled", Solver("ros34pw2", 5e-4))
    assert chosen.notices == (
        "the plant is stiff: rk4 would take steps of 48 µs; ros34pw2 is used, with steps of 500 µs",
    )
    np.testing.assert_allclose(chosen["arm.q"], exact["arm.q"], atol=2e-6)
    np.testing.assert_allclose(run(Solver("ros34pw2", 1e-3))["arm.q"], exact["arm.q"], atol=1e-5)


def test_one_of_its_steps_costs_at_most_twice_and_a_quarter_of_rk4s() -> None:
    for name in ("arm2_joint", "ur10_full"):
        graph = Graph.read(name)
        prepared = prepare(graph.diagram, 1, clock=graph.file.clock, solver=graph.solver, log=Log())

        def of_a_step(method: Any, prepared: Prepared = prepared, period: float = graph.file.clock or 0.0) -> int:
            whole, halves = (prepared.solved_by(Solver(method, period / k)).step for k in (1, 2))
            return work_of(halves) - work_of(whole)

        assert of_a_step("ros34pw2") < 2.25 * of_a_step("rk4")


@pytest.mark.parametrize("pivot", [0.0, 1e-14])
def test_a_step_whose_system_has_lost_its_digits_ends_the_run_instead_of_passing_garbage_on(pivot: float) -> None:
    run = ran(Singular(speed=0.01 * (1 + pivot)), 0.1, [1, 1], 0.01, 0.01)
    assert run.divergence is not None
    assert "plant.y[0] is no longer finite at t = 0.01 s" in str(run.divergence)
    sound = ran(Singular(speed=0.01), 0.1, [1, 1], 0.009, 0.01)
    assert sound.divergence is None


def test_a_smaller_share_of_the_stable_step_is_a_smaller_error() -> None:
    graph = Graph.read("ur10_fast", ["servo.K_D=[2400, 2400, 1200]", "arm.viscous=0", "arm.coulomb=0"])
    diagram = graph.diagram

    def run(solver: Solver) -> Recording:
        return simulate(diagram, 0.4, clock=0.002, solver=solver, start=graph.start)

    exact, plain, half = run(Solver(step=1e-4)), run(Solver()), run(Solver(share=0.5))
    assert (plain.solver.step, half.solver.step) == (1e-3, pytest.approx(0.5 / 0.8 * 1e-3, rel=0.2))
    wrong, less = (float(np.max(np.abs(each["arm.q"] - exact["arm.q"]))) for each in (plain, half))
    assert less < wrong / 5
    for share in (0.0, 1.5, float("nan")):
        with pytest.raises(ValueFault, match="share: expected a number above 0, at most 1"):
            Solver(share=share)


def test_a_plant_of_which_too_much_is_left_out_is_reported_and_not_chosen() -> None:
    start = {"x": [1.0] * 40}
    given: dict[str, Any] = {"clock": 0.01, "start": start}
    chosen = simulate(alone(Square(k=20.0)), 0.05, **given)
    assert chosen.solver.method == "rk4"
    assert chosen.divergence is None
    (notice,) = chosen.notices
    assert notice.startswith("the plant is stiff: rk4 takes steps of ")
    requested = simulate(alone(Square(k=20.0)), 0.05, solver=Solver("ros34pw2", 1e-3), **given)
    assert "the plant is stiff in terms that ros34pw2 integrates explicitly" in requested.notices[0]
    easy = simulate(alone(Square(k=1e-3)), 0.05, solver=Solver("ros34pw2", 1e-3), **given)
    assert easy.notices == ()


@pytest.mark.parametrize(("k", "reported"), [(1e-2, False), (1e5, True)])
def test_what_is_left_out_is_seen_where_it_acts_through_another_state(k: float, reported: bool) -> None:
    start = {"x": [1.0] * 40, "y": [0.0] * 40}
    run = simulate(alone(Spring(k=k)), 0.002, clock=0.001, solver=Solver("ros34pw2", 1e-3), start=start)
    assert any("terms that ros34pw2 integrates explicitly" in notice for notice in run.notices) is reported


def test_a_run_of_rk4_that_becomes_stiff_later_is_done_again_at_shorter_steps() -> None:
    run = simulate(alone(Late(speed=4e3)), 20.0, clock=0.01, start={"y": [1.0, 1.0]})
    assert run.divergence is None
    assert any("the integrator diverged at longer steps: rk4" in notice for notice in run.notices)


def test_a_batch_shares_one_library_of_each_method(cache: Path) -> None:
    graph = Graph.read("arm2_joint")
    variants = [{}, *({"arm.viscous": [1.0, viscous]} for viscous in (800.0, 1e5, 1e6))]
    runs = simulate_many(graph.diagram, variants, 0.1, clock=graph.file.clock, start=graph.start, engine="compiled")
    methods = [run.solver.method for run in runs if isinstance(run, Recording)]
    assert methods == ["rk4", "rk4", "ros34pw2", "ros34pw2"]
    assert len(list(cache.glob("*.so"))) == 2
