"""The estimated error of integration, compared with SciPy's adaptive methods; the choice of method and steps."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import Access, Output, Side, State
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.diagram import Diagram
from dmframe.simulate import Recording, Solver, accuracy, simulate
from dmframe.simulate.accuracy import joint_rows, spans
from dmframe.simulate.recording import Estimate
from dmframe.simulate.run import prepare
from dmframe.simulate.start import start_state

CAUTION = 12.0
"""Largest ratio of an estimate to the error; (1) gives 3 for an error of high order, and 4.5 for parts of a run."""

ELASTIC: dict[str, Any] = {
    "blocks.gears": {"type": "elastic_joints", "stiffness": 3000, "damping": 4, "inertia": 0.2},
    "wires": {"servo.q": "gears.theta", "servo.dq": "gears.dtheta", "gears.u": "servo.u"},
}


def exact(graph: dm.Graph) -> np.ndarray:
    """Joint positions at all ticks, integrated by SciPy at 1e-11 with the loop's rate, and restarted at each tick."""
    diagram, settings = graph.diagram, graph.settings
    start = settings.pop("start")
    prepared = prepare(diagram, graph.duration, **settings)
    state = start_state(diagram, start, prepared.starts, prepared.step.instants)
    parts, instants, p = prepared.step.parts, prepared.step.instants, diagram.loop.p_values
    rows, _, _ = joint_rows(diagram)
    found = [state[rows]]
    for t, length, *drawn in instants.rows(0, prepared.ticks):
        z, u = parts.sample(state, parts.trajectory(t, p), drawn, instants.period, p)
        first = z.numel()

        def rate(s: float, x: np.ndarray, u: Any = u) -> np.ndarray:
            return np.array(parts.rate(x, u, parts.trajectory(s, p), p)).ravel()

        span, x = (t, t + length), state[first:]
        end = scipy.integrate.solve_ivp(rate, span, x, "DOP853", (span[1],), rtol=1e-11, atol=1e-12).y[:, -1]
        state = np.concatenate([np.array(z).ravel(), np.array(parts.clip(end, p)).ravel()])
        found.append(state[rows])
    return np.array(found)


def positions(run: Recording) -> np.ndarray:
    return np.hstack([run.states[label] for label in joint_rows(run.diagram)[1]])


def covers(claimed: float, true: float) -> bool:
    """True if an estimate is at least the error, and not much larger."""
    return true <= claimed <= CAUTION * true + 1e-12


def compared(graph: dm.Graph) -> tuple[Recording, float]:
    """A run, and its largest error of a joint position."""
    run = graph.simulate()
    return run, float(np.max(np.abs(positions(run) - exact(graph))))


@pytest.mark.parametrize("wanted", [1e-4, 1e-7])
@pytest.mark.parametrize(("name", "duration"), [("arm2_joint", 0.1), ("ur10_fast", 0.2)])
def test_the_estimate_covers_the_error_against_scipy_and_keeps_the_accuracy(
    name: str, duration: float, wanted: float
) -> None:
    run, error = compared(dm.load(name).set({"solver.accuracy": wanted}).until(duration))
    assert run.estimate is not None
    assert run.estimate.share == 1
    assert covers(run.estimate.error, error)
    assert run.estimate.error <= wanted
    assert not covers(run.estimate.error / 10, error), "an estimator that is ten times too low is found"


@pytest.mark.parametrize(
    ("name", "changes", "duration"),
    [
        ("arm2_joint", {"servo.K_P": [3000, 1500], "servo.K_I": [9000, 4000]}, 0.03),  # h |lambda| = 17 at 1 ms
        ("arm2_joint", {"clock": "6 ms"}, 0.06),
        ("arm2_joint", ELASTIC, 0.1),
        ("ur10_slow_sampled", {}, 0.18),  # a discrete-time law
        ("pendulum", {}, 0.5),
    ],
    ids=["stiff servo", "slow clock", "elastic joints", "discrete time", "continuous time"],
)
def test_it_holds_for_stiff_elastic_and_discrete_time_loops(
    name: str, changes: dict[str, Any], duration: float
) -> None:
    graph = dm.load(name).set({**changes, "solver.accuracy": 1e-5}).until(duration)
    run, error = compared(graph)
    assert run.estimate is not None
    assert covers(run.estimate.error, error)
    assert run.estimate.error <= 1e-5
    assert run.step is not None
    steps = (graph.clock or 0.01) / run.step
    assert steps == pytest.approx(round(steps), abs=1e-9)


def test_a_tool_that_meets_a_wall(tmp_path: Path) -> None:
    x = [-0.07, 0.82, 0.55]
    path = {"blocks.path.times": [0, 0.4], "blocks.path.x_d": [x, [x[0], 0.89, x[2]]]}
    run, error = compared(dm.load("ur10_admittance").set({**path, "solver.accuracy": 1e-6}).until(0.6))
    assert run.estimate is not None
    assert np.max(np.abs(run["wall.tau_ext"])) > 1
    assert covers(run.estimate.error, error)
    assert run.estimate.error <= 1e-6


def test_stop_and_go_is_estimated_where_it_moves() -> None:
    points = [[0.7, 1], [0.7, 1], [0.71, 1], [0.71, 1]]
    graph = dm.load("arm2_joint").set(path={"type": "joint_waypoints", "times": [0, 0.1, 0.2, 0.3], "q_d": points})
    run, error = compared(graph.set({"solver.accuracy": 1e-6}).until(0.32))
    assert run.estimate is not None
    assert covers(run.estimate.error, error)


class Swing(AbstractBlock):
    """A pendulum without damping: an error of its frequency accumulates."""

    side = Side.PLANT
    outputs = (Output("q", "", "rad", Access.MEASURED),)
    states = (State("q", "", "rad"), State("dq", "", "rad/s"))
    speed: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"q": x.q}, rates={"q": x.dq, "dq": -(p.speed**2) * ca.sin(x.q)})


class Bodiless(AbstractBlock):
    """A plant without positions."""

    side = Side.PLANT
    outputs = (Output("y", "", "V", Access.MEASURED),)
    states = (State("y", "", "V"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": -x.y})


def swung(solver: Solver, duration: float = 60.0) -> Recording:
    return simulate(Diagram.build({"swing": Swing(speed=6.0)}), duration, solver=solver, start={"q": 1.0})


def test_an_accumulating_error_is_extrapolated_from_parts_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    given = Solver(step=0.01, accuracy=1e-5)
    whole = swung(given).estimate
    monkeypatch.setattr(accuracy, "_FEW", (0.0, 0.0))
    part = swung(given).estimate
    fine = swung(Solver(step=0.001))
    error = float(np.max(np.abs(positions(swung(given)) - positions(fine))))
    assert whole is not None
    assert part is not None
    assert whole.share == 1 > part.share
    assert covers(whole.error, error)
    assert error <= part.error <= 5 * CAUTION * error


def test_parts_of_a_long_run_are_few_and_apart() -> None:
    diagram = dm.load("ur10_fast").diagram
    step = prepare(diagram, 1.0, clock=0.008, solver=Solver(), log=dm.load("ur10_fast").log).step
    assert spans(step, 125) == [(0, 125)]
    ticks = 86400 * 125
    found = spans(step, ticks)
    assert len(found) == 4
    assert found[0][0] == 0
    assert all(first + length <= later for (first, length), (later, _) in pairwise(found))
    assert found[-1][0] + found[-1][1] <= ticks
    work = sum(length for _, length in found) * accuracy.work_of(step)
    assert work < 0.01 * ticks * accuracy.work_of(step)
    assert spans(step, 1) == [(0, 1)]


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_both_engines_choose_the_same_and_repeat_it(engine: Any) -> None:
    graph = dm.load("arm2_joint").set({"solver.accuracy": 1e-6}).until(1)
    first, second = graph.simulate(engine=engine), graph.simulate(engine="interpreted")
    assert first.solver == second.solver
    assert first.estimate is not None
    assert second.estimate is not None
    assert first.estimate.error == pytest.approx(second.estimate.error, rel=1e-3)


def test_a_loose_accuracy_takes_longer_steps_and_a_tight_one_shorter_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "worth", lambda step, ticks: True)  # as for a long run
    graph, taken = dm.load("ur10_fast").until(2), list[tuple[float, str]]()
    for wanted in (1e-4, 1e-5, 1e-8):
        run = graph.set({"solver.accuracy": wanted}).simulate(engine="compiled")
        assert run.estimate is not None
        assert run.estimate.error <= wanted
        assert run.solver.step is not None
        taken.append((run.solver.step, run.solver.method))
    (loose, method), (usual, _), (tight, tight_method) = taken
    assert method == "ros34pw2", "rk4 is limited by its stability here"
    assert loose > usual > 0.001 > tight
    assert tight_method == "rk4"


def test_without_the_key_automatic_steps_are_only_shortened() -> None:
    run = dm.load("ur10_fast").until(2).simulate()
    assert (run.solver.method, run.solver.step) == ("rk4", 0.001)
    assert run.estimate is not None
    assert run.estimate.error < 1e-5
    graph = dm.load("torque_indirect_pid").set({"solver": {}}).until(1.5)
    shorter = graph.simulate()
    assert shorter.estimate is not None
    assert shorter.estimate.error <= 1e-5
    assert shorter.step is not None
    assert shorter.step < 0.001
    assert any(f"rk4 takes steps of {shorter.step * 1e6:g} µs" in text for text in shorter.notices)
    written = graph.set({"solver.step": "1 ms"}).simulate()
    assert written.solver.step == 0.001
    assert written.estimate is not None
    assert written.estimate.error > 1e-5
    assert not any("error of the joints" in text for text in written.notices)
    checked = graph.set({"solver.step": "1 ms", "solver.accuracy": 1e-5}).simulate()
    assert checked.solver.step == 0.001
    assert any("exceeds 1e-05; set a shorter solver.step" in text for text in checked.notices)


def test_behind_an_encoder_steps_are_shortened_only_for_a_stated_accuracy() -> None:
    encoder = {"blocks.encoder": {"type": "encoder", "step": 1e-3}}
    graph = dm.load("arm2_joint").set({**encoder, "clock": "4 ms"}).until(0.4)
    usual, exact_run = graph.simulate(), graph.set({"solver.accuracy": 1e-5}).simulate()
    assert usual.solver.step == 0.001
    assert usual.estimate is not None
    assert usual.estimate.error > 1e-5
    assert not any("error of the joints" in text for text in usual.notices)
    assert exact_run.estimate is not None
    assert exact_run.estimate.error <= 1e-5 or any("exceeds 1e-05" in text for text in exact_run.notices)


def test_a_method_alone_is_kept() -> None:
    run = dm.load("arm2_joint").set({"solver": {"method": "ros34pw2", "accuracy": 1e-4}}).until(1).simulate()
    assert run.solver.method == "ros34pw2"
    assert run.estimate is not None
    assert run.estimate.error <= 1e-4


def test_an_error_that_no_step_reduces_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        accuracy.Comparison, "estimate", lambda self, own: Estimate(3e-3 * (own.step.substeps + 1), "rad", 1.0)
    )
    run = dm.load("arm2_joint").set({"solver.accuracy": 1e-5}).until(0.1).simulate()
    assert run.solver.step == 0.001, "the automatic step"
    assert any("exceeds 1e-05; shorter steps do not keep it" in text for text in run.notices)


def test_a_run_that_diverges_names_the_state_and_has_no_estimate() -> None:
    changes = {"inverse.w_box": None, "dynamics.Gamma": 1e9, "dynamics.a_d_hat_box": None, "solver.accuracy": 1e-5}
    run = dm.load("arm2_joint").set(changes).until(5).simulate()
    assert run.divergence is not None
    assert run.estimate is None


def test_a_choice_that_diverges_later_is_replaced_by_automatic_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy.Pilot, "_first", lambda self, wanted: self._other("rk4", 1))
    run = dm.load("ur10_fast").set({"solver.accuracy": 1e-5}).until(2).simulate()  # rk4 diverges at 8 ms
    assert run.divergence is None
    assert run.solver.step == 0.001


def test_ctrl_c_during_the_estimate_keeps_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(accuracy.Comparison, "estimate", stopped)
    run = dm.load("arm2_joint").until(0.1).simulate()
    assert run.interrupted
    assert len(run.time) == 51
    assert run.estimate is None


def test_one_tick_is_enough() -> None:
    run = dm.load("ur10_fast").set({"solver.accuracy": 1e-5}).until(0.008).simulate()
    assert run.estimate is not None
    assert run.estimate.share == 1
    assert run.estimate.error <= 1e-5


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_all_runs_of_a_sweep_share_the_choice_of_the_graphs_own_numbers(engine: Any) -> None:
    graph = dm.load("arm2_joint").set({"solver.accuracy": 1e-4}).until(0.5)
    found = dm.sweep(graph, {"dynamics.Gamma": [1, 100]}, engine=engine)
    own = graph.simulate(engine=engine)
    assert own.solver.step is not None
    assert f"solver.accuracy: {own.solver.method} in steps of {own.solver.step * 1e3:g} ms" in found.attrs["notices"]
    error = float(found["rms_by_eighth"].sel({"dynamics.Gamma": 100})[-1])
    run = graph.run(judge=False)
    assert run.error is not None
    assert error == pytest.approx(run.error.rms_final, rel=1e-6)
    runs = dm.compare(graph.variants({"dynamics.Gamma": [1, 100]}))
    assert {each.recording.solver.method for each in runs} == {own.solver.method}


def test_a_stiffer_run_of_a_sweep_takes_shorter_steps() -> None:
    graph = dm.load("arm2_joint").set({"solver": {"method": "rk4", "accuracy": 1e-3}}).until(0.2)
    found = dm.sweep(graph, {"servo.K_P": [[60, 30], [3000, 1500]]}, engine="compiled")
    assert np.all(np.isfinite(found["rms_by_eighth"]))
    assert not np.any(found["diverged"])


def test_a_plant_without_positions_has_no_accuracy() -> None:
    diagram = Diagram.build({"plant": Bodiless()})
    assert simulate(diagram, 0.1, solver=Solver(accuracy=1e-5)).estimate is None
    with pytest.raises(ValueFault, match=r"solver\.accuracy: expected a plant with joint positions"):
        simulate(diagram, 0.1, solver=Solver(accuracy=1e-5, free=("rk4",)))


@pytest.mark.parametrize(
    ("solver", "message"),
    [
        ({"accuracy": 0}, "expected a positive number in rad, or in m for joints that slide, found 0"),
        ({"accuracy": "2 s"}, "solver.accuracy"),
        ({"accuracy": 1e-5, "method": "cvodes"}, "expected solver.method rk4 or ros34pw2, found cvodes"),
    ],
)
def test_an_impossible_accuracy_is_refused(solver: dict[str, Any], message: str) -> None:
    with pytest.raises(DmframeError) as caught:
        _ = dm.load("arm2_joint").set({"solver": solver}).diagram
    assert message in str(caught.value)


def test_run_prints_and_keeps_method_step_and_error(tmp_path: Path) -> None:
    run = dm.load("arm2_joint").set({"solver.accuracy": 1e-5}).run(0.2)
    run.save(tmp_path / "a", plots=False)
    kept = json.loads((tmp_path / "a" / "summary.json").read_text())["solver"]
    assert kept == run.summary["solver"]
    assert set(kept) == {"method", "step", "error", "unit", "share"}
    assert 0 < kept["error"] <= 1e-5
    assert f"arm2_joint: {kept['method']} in steps of {kept['step'] * 1e3:g} ms, estimated error of the joints" in str(
        run
    )
    assert run.data.attrs["integration_error"] == f"{kept['error']:.3g} rad, compared in 1 of the run"
    adaptive = dm.load("arm2_joint").set({"solver.method": "cvodes"}).run(0.02)
    assert adaptive.summary["solver"] == {"method": "cvodes", "step": None, "error": None, "unit": None, "share": None}


def test_the_run_of_a_drive_or_an_export_has_no_pilot() -> None:
    solver = dm.load("arm2_joint").set({"solver.accuracy": 1e-5}).solver
    assert solver.automatic == replace(Solver(), accuracy=None)
