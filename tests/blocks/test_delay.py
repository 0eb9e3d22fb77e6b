"""The fitted delay: correct for every delay line and with noise, and refused if the data do not determine it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from test_sampled_supervisor import Line

import dmframe as dm
from dmframe.analysis.delay import FittedDelay, fitted_delay, recorded_delay
from dmframe.catalogue import block_types
from dmframe.common.errors import ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate


@functools.cache
def run(name: str, clock: str, line: Line, *, probe: bool = True, seed: int = 1) -> Recording:
    """A packaged path with the kinematic controller, whose commands probe, for 3 s."""
    graph = Graph.read(name, [f"clock={clock}"])
    blocks, wires = {**graph.blocks, "line": line}, dict(graph.file.wires)
    if probe:
        blocks["inverse"] = block_types()["velocity_probe"]()
    wires |= {"servo.dq_c": "line.dq_late", "line.dq_c": "inverse.dq_c"}
    diagram = Diagram.build(blocks, wires, graph.robot)
    return simulate(diagram, 3.0, clock=graph.file.clock, start=graph.start, engine="interpreted", seed=seed)


def fit(recorded: Recording, noise: float = 0.0) -> FittedDelay:
    q, clock = np.asarray(recorded["arm.q"]), recorded.clock
    assert clock is not None
    noisy = q + noise * np.random.default_rng(5).standard_normal(q.shape)
    return fitted_delay(noisy, recorded["inverse.dq_c"], clock)


@pytest.mark.parametrize("name", ["ur10_slow_kinematic", "ur10_fast_kinematic"])
@pytest.mark.parametrize("clock", ["90 ms", "20 ms"])
def test_whole_delays_are_found_also_in_noise(name: str, clock: str) -> None:
    for samples in (0, 1, 2):
        recorded = run(name, clock, Line(samples=samples))
        for noise in (0.0, 3e-5, 1e-4):
            found = fit(recorded, noise)
            assert found.whole == samples, (samples, noise, str(found))
            assert abs(found.samples - samples) <= (0.1 if noise == 0 else 0.25)
            assert found.half_width < 0.3
        assert recorded_delay(recorded) == fit(recorded)


@pytest.mark.parametrize("clock", ["90 ms", "20 ms"])
@pytest.mark.parametrize("samples", [0, 1])
def test_a_delay_that_changes_at_random_is_refused(clock: str, samples: int) -> None:
    for seed in (1, 2):
        recorded = run("ur10_slow_kinematic", clock, Line(samples=samples, random=True), seed=seed)
        for noise in (0.0, 1e-4):
            found = fit(recorded, noise)
            assert found.refused, str(found)
            with pytest.raises(ValueFault, match=r"delay: \d\.\d\d \+- "):
                _ = found.whole


def test_a_delay_longer_than_the_blocks_support_is_refused() -> None:
    assert "longer than 2 samples" in fit(run("ur10_slow_kinematic", "90 ms", Line(samples=3))).refused


def test_half_a_sample_is_no_whole_number_of_samples() -> None:
    """Joints without lag; each command held for a sample, the response half a sample later."""
    rng = np.random.default_rng(3)
    u = 0.2 + 0.01 * np.sign(rng.standard_normal((60, 2)))
    late = 0.5 * u + 0.5 * np.vstack([u[:1], u[:-1]])
    q = np.vstack([np.zeros((1, 2)), np.cumsum(0.05 * late, axis=0)])
    found = fitted_delay(q, u, 0.05)
    assert found.samples == pytest.approx(0.5, abs=0.06)
    assert "not an integer number" in found.refused
    assert fitted_delay(np.vstack([np.zeros((1, 2)), np.cumsum(0.05 * u, axis=0)]), u, 0.05).whole == 0


@pytest.mark.parametrize("late", [False, True])
def test_the_jitter_in_noise_is_that_of_the_commands(late: bool) -> None:
    """Joints with lags of at most a sample, moved by Euler steps, with noise as large as a command's effect."""
    T, dt, wanted = 0.02, 0.001, 0.5 if late else 0.0
    for seed in range(4 if late else 2):
        rng = np.random.default_rng(seed)
        u = 0.01 * np.sign(rng.standard_normal((150, 3)))
        q, v, lags = [np.zeros(3)], np.zeros(3), np.array([0.02, 0.012, 0.006])
        for k in range(len(u)):
            acting, pose = u[max(0, k - 2 - int(late and rng.random() < 0.5))], q[-1].copy()
            for _ in range(round(T / dt)):
                v = v + dt * (acting - v) / lags
                pose += dt * v
            q.append(pose)
        found = fitted_delay(np.array(q) + 1e-4 * rng.standard_normal((151, 3)), u, T)
        assert abs(found.jitter - wanted) < 0.25, str(found)
        assert found.refused if late else found.whole == 2, str(found)


@pytest.mark.parametrize("clock", ["90 ms", "20 ms"])
def test_smooth_motion_does_not_show_a_delay(clock: str) -> None:
    for name in ("ur10_slow_kinematic", "ur10_fast_kinematic"):
        assert "does not determine it" in fit(run(name, clock, Line(samples=1), probe=False)).refused


def test_signals_that_do_not_belong_together_are_refused() -> None:
    u, q = np.zeros((40, 2)), np.zeros((41, 2))
    for positions, commands, period, text in (
        (q[:, :1], u, 0.1, "as many joints"),
        (q[:12], u, 0.1, r"at least 28 samples, found 11; record 3 s"),
        (q, u, 0.0, "a period above zero"),
        (q * np.nan, u, 0.1, "finite"),
    ):
        with pytest.raises(ValueFault, match=text):
            fitted_delay(positions, commands, period)


@pytest.mark.filterwarnings("error")
def test_samples_that_are_no_numbers_are_refused() -> None:
    u, q = np.random.default_rng(1).standard_normal((40, 2)), np.zeros((41, 2))
    for positions, commands, period, text in (
        ("abc", u, 0.1, "q to be rows of real numbers"),
        (q, [[1], [2, 3]], 0.1, "dq_c to be rows of real numbers"),
        (q + 1j, u, 0.1, "q to be rows of real numbers"),
        (None, None, 0.1, "as many joints|rows of real numbers"),
        (q[:, :0], u[:, :0], 0.1, "as many joints"),
        (q, u, "0.1 s", "a period in s, a number, found '0.1 s'"),
        (q, u, None, "a period in s"),
        (q, u, np.nan, "a period above zero"),
        (q, u, np.inf, "a period above zero"),
        (q, u, 1e-320, "a period above zero"),
        (q + 1e300, u, 0.1, "others in q; record a run that stays bounded"),
        (q, 1e200 * u, 0.1, "others in dq_c"),
    ):
        with pytest.raises(ValueFault, match=text):
            fitted_delay(positions, commands, period)


def test_joints_that_do_not_make_the_velocities_commanded_have_no_delay() -> None:
    """Motors without strength, an encoder of one step, and a channel that loses half of the commands."""
    graph = dm.load("ur10_slow_probe")
    for name, values in (
        ("torque_limits", {"torque": 1e-9}),
        ("encoder", {"step": 1}),
        ("transport_delay", {"lost": 0.5}),
    ):
        found = recorded_delay(graph.reality({name: values}).run(3, engine="interpreted").recording)
        assert found.refused, (name, str(found))


def test_a_thinned_record_is_refused() -> None:
    graph = dm.load("ur10_slow_probe").set({"inverse.lasting": 6})
    with pytest.raises(ValueFault, match="every sample, 90 ms spacing, found one of every 180 ms"):
        recorded_delay(graph.set({"log.every": "180 ms"}).run(6, engine="interpreted").recording)
    with pytest.raises(ValueFault, match=r"a record with arm\.q"):
        recorded_delay(graph.set({"log.signals": ["arm.x"]}).run(3, engine="interpreted").recording)


def test_a_run_that_diverged_is_refused_as_such() -> None:
    graph = dm.load("ur10_slow_probe").set({"inverse.probe": 1e300})
    with pytest.raises(ValueFault, match="found one that diverged"):
        recorded_delay(graph.run(3, engine="interpreted").recording)


def test_it_is_public() -> None:
    assert dm.fitted_delay is fitted_delay
