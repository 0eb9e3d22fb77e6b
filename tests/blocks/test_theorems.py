"""The theorems' graphs, simulated to the end and compared with each theorem; and the certificates on every robot."""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dmframe.certify import Verdict, verify
from dmframe.graph.graph import Graph
from dmframe.results.along import StorageTrace, along
from dmframe.simulate import Recording, simulate

THEOREMS = ("theorem_1", "theorem_2", "theorem_3", "theorem_4")
TORQUES = ("torque_indirect_pi", "torque_indirect_pid", "torque_direct_pi", "torque_direct_pid")
LAST_TO_FIRST = {  # upper bound: RMS of the tracking error over the last tenth, relative to the first
    "theorem_1": 1e-3,
    "theorem_2": 1e-3,
    "theorem_3": 0.4,
    "theorem_4": 2e-3,
    "torque_indirect_pi": 0.3,
    "torque_indirect_pid": 0.15,
    "torque_direct_pi": 0.5,
    "torque_direct_pid": 0.5,
}
SAMPLED = {  # the same for each sampled generator, with one servo each, over so many seconds
    "filtered_regulation_pid": (20, 0.02),
    "observed_regulation_pi": (40, 0.02),
    "observed_tracking_pid": (50, 0.4),
    "known_tracking_pi": (50, 0.6),
    "joint_tracking_pid": (50, 0.4),
    "panda_full": (40, 0.95),
}


@cache
def done(name: str) -> tuple[Recording, Verdict]:
    graph = Graph.read(name)
    diagram = graph.diagram
    run = simulate(diagram, graph.file.duration, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    return run, verify(diagram, trials=1)


@cache
def fall(name: str) -> StorageTrace:
    run, verdict = done(name)
    assert verdict.claim is not None
    return along(verdict.claim, run, float(verdict.kappa.chosen) if verdict.kappa else 1.0)


def rms(run: Recording) -> np.ndarray:
    """RMS of the tracking error in each tenth."""
    desired, actual, _, _ = run.diagram.loop.followed[0]
    error = np.sum((run[actual] - run[desired]) ** 2, axis=1)
    return np.array([np.sqrt(part.mean()) for part in np.array_split(error, 10)])


@pytest.mark.parametrize("name", [*THEOREMS, *TORQUES])
def test_the_tracking_error_falls_as_the_theorem_states(name: str) -> None:
    run, verdict = done(name)
    assert run.divergence is None
    assert run.clock is None  # the theorems are in continuous time
    assert verdict.outcome == "proved"
    tenths = rms(run)
    assert tenths[0] > 1e-4
    assert tenths[-1] < LAST_TO_FIRST[name] * tenths[0]


@pytest.mark.parametrize("name", [*THEOREMS, *TORQUES])
def test_v_never_rises_beyond_the_integrators_tolerance(name: str) -> None:
    V = fall(name)
    assert V.V[0] > 0
    assert V.V[-1] < V.V[0]
    assert V.largest_increase < 1e-8 * V.V[0]


@pytest.mark.parametrize("name", [*THEOREMS, *TORQUES])
def test_every_signal_that_v_weighs_stays_below_what_v_was_at_the_start(name: str) -> None:
    V, (run, _) = fall(name), done(name)
    for term in V.terms:
        assert term.values.min() >= -1e-12 * V.V[0], term.of
        assert term.values.max() <= V.V[0] * (1 + 1e-8), term.of
    assert all(np.all(np.isfinite(rows)) for rows in (*run.states.values(), *run.outputs.values()))


@pytest.mark.parametrize("name", ["theorem_2", "theorem_3"])
def test_the_observer_finds_the_task_position(name: str) -> None:
    run, _ = done(name)
    error = np.linalg.norm(run["observer.x_o"] - run["arm.x"], axis=1)
    tenth = len(error) // 10
    assert error[0] < 1e-15  # it starts at the measured position, and the wrong kinematics move it away
    assert error[-tenth:].max() < 0.3 * error.max()


@pytest.mark.parametrize("name", THEOREMS)
def test_the_kinematics_are_wrong_at_the_start_and_the_estimates_stay_bounded(name: str) -> None:
    run, _ = done(name)
    chain = run.diagram.robot
    true = np.array([x for joint in chain.joints for x in joint.translation] + list(chain.tool), dtype=float)
    np.testing.assert_allclose(run["geometry.a_k_hat"][0] - true, 0.03)  # [m]
    assert np.ptp(run["geometry.a_k_hat"], axis=0).max() > 1e-4


@pytest.mark.parametrize("name", SAMPLED)
def test_the_sampled_loop_converges_at_8_ms(name: str) -> None:
    duration, ratio = SAMPLED[name]
    graph = Graph.read(name)
    assert graph.file.clock == 0.008
    run = simulate(graph.diagram, duration, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    assert run.divergence is None
    tenths = rms(run)
    assert tenths[-1] < ratio * tenths[0]


def _benchmark() -> ModuleType:
    file = Path(__file__).parents[1] / "benchmarks" / "verify_all.py"
    spec = importlib.util.spec_from_file_location("verify_all", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BENCHMARK = _benchmark()
ALSO = "observed_tracking_pid, known kinematics"
"""Of the generators with adaptive kinematics, the one that is also proved with known kinematics."""
PROVED = [("ur10, 3 joints", *each) for each in BENCHMARK.graphs("ur10, 3 joints")]
PROVED = [each for each in PROVED if "known_tracking" in each[1] or "known kin" not in each[1] or each[1] == ALSO]
PROVED += [("xarm7", *each) for each in BENCHMARK.graphs("xarm7")][:1]
"""`tests/benchmarks/verify_all.py` covers all combinations, on more robots."""


@pytest.mark.parametrize(("robot", "name", "text"), PROVED, ids=[f"{robot}: {name}" for robot, name, _ in PROVED])
def test_every_combination_is_proved(robot: str, name: str, text: str, tmp_path: Path) -> None:
    verdict, _, _ = BENCHMARK.verdict(text, tmp_path)
    assert verdict.outcome == "proved", verdict.reason
    assert verdict.test is not None
    assert verdict.test.log2_error_bound < -150
    assert len(verdict.controls) >= 9
