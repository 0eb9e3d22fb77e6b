"""The delay probe: response compared with NumPy, identified delays, and the blocks that use them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.catalogue import block_types
from dmframe.common.errors import DmframeError

KIND = block_types()["delay_probe"]
T = 0.05


def drawn(seed: int, n: int) -> list[int]:
    """The first values of the generators, in integers."""
    values = [seed * (1 + 7919 * j) % (2**31 - 1) for j in range(n)]
    return [value * pow(48271, 8, 2**31 - 1) % (2**31 - 1) for value in values]


def played(
    block: Any, delay: int, lag: float, seed: int, samples: int = 44
) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """A joint whose velocity follows the command after a delay and a first-order lag; outputs, q and commands."""
    draw = drawn(seed + 1, 1)
    q, v, states = 0.0, 0.0, {"q_before": [0.0], "draw": draw}
    found, poses, sent = list[Any](), list[float](), list[float]()
    for k in range(samples):
        command = 0.2 + (0.0 if float(states.get("identified", 0.0)) else 0.03 * (1 if draw[0] > 2**30 else -1))
        draw = [48271 * draw[0] % (2**31 - 1)]
        u = {"q": [q], "dq_r": [0.2], "dq_sent": [command], "T": T}
        item = block.evaluate(u, states, robot="pendulum")
        assert float(item.outputs["dq_probe"][0]) == pytest.approx(command)
        states = dict(item.next)
        found.append(item)
        poses.append(q)
        sent.append(command)
        acting = sent[k - delay] if k >= delay else 0.0
        v = lag * v + (1 - lag) * acting
        q += T * v
    return found, np.array(poses), np.array(sent)


@pytest.mark.parametrize(("delay", "lag"), [(0, 0.0), (0, 0.4), (1, 0.0), (2, 0.3), (4, 0.5)])
def test_it_finds_the_delay_behind_a_lag(delay: int, lag: float) -> None:
    for seed in range(2):
        found, _, sent = played(KIND(delay_up_to=6, taps=8, lasting=2.0, settling=0.0), delay, lag, seed)
        assert [float(item.outputs["identified"]) for item in found] == [0.0] * 41 + [1.0] * 3
        assert {float(item.outputs["delay_hat"]) for item in found[41:]} == {float(delay)}
        assert np.all(np.abs(sent[:41] - 0.2) == pytest.approx(0.03))
        np.testing.assert_array_equal(sent[41:], 0.2)  # the excitation has ended


def test_a_slow_response_counts_as_delay() -> None:
    found, _, _ = played(
        KIND(delay_up_to=6, taps=8, lasting=2.0, settling=0.0, confidence=0.0), 1, 0.85, 0
    )  # 0, 0.15, 0.28, 0.39
    assert float(found[-1].outputs["delay_hat"]) == 3
    limited, _, _ = played(KIND(delay_up_to=2, taps=8, lasting=2.0, settling=0.0, confidence=0.0), 1, 0.85, 0)
    assert float(limited[-1].outputs["delay_hat"]) == 2


def test_after_a_trip_the_delay_is_longer_and_the_excitation_ends_beyond_the_longest() -> None:
    block = KIND(delay_up_to=3, taps=4, tripping=True, trip=2.0)
    u = {"q": [0.3, 0.4], "dq_r": [0.0, 0.0], "dq_sent": [0.0, 0.0], "x_err": [1.0, 0.0], "T": T}
    calm = {"draw": drawn(1, 2), "identified": 1, "delay_hat": 2, "since": 9.0, "error_mean": 1.0, "error_scale": 99.0}
    calm |= {"period_mean": T, "period_scale": T}
    assert float(block.evaluate(u, calm, robot="arm2").next["identified"]) == 1
    after = block.evaluate(u, calm | {"error_scale": 0.01}, robot="arm2")
    assert float(after.outputs["tripped"]) == 1
    assert [float(after.next[name]) for name in ("identified", "since", "delay_least")] == [0, 0, 3]
    again = {"draw": drawn(1, 2), "since": 9.0, "correlated": [1.0, 0, 0, 0], "gathered": np.eye(4), "varied": 1.0}
    found = block.evaluate(u, again | {"delay_least": 3}, robot="arm2").next  # the regression by itself finds no delay
    assert [float(found[name]) for name in ("identified", "delay_hat")] == [1, 3]
    for least, excited in ((3, True), (4, False)):
        item = block.evaluate(u, again | {"delay_least": least}, robot="arm2")
        assert np.any(np.asarray(item.outputs["dq_probe"])) == excited
        assert float(item.next["identified"]) == excited


@pytest.mark.parametrize("blanking", [0.0, 0.48])
def test_the_trip_ignores_the_error_for_some_time_after_the_identification(blanking: float) -> None:
    block = KIND(delay_up_to=3, taps=4, tripping=True, blanking=blanking, lasting=1.0, settling=0.0)
    u = {"q": [0.3, 0.4], "dq_r": [0.0, 0.0], "dq_sent": [0.0, 0.0], "x_err": [0.01, 0.0], "T": T}
    states = {"draw": drawn(1, 2), "since": 9.0, "correlated": [1.0, 0, 0, 0], "gathered": np.eye(4), "varied": 1.0}
    states = dict(block.evaluate(u, states, robot="arm2").next)
    assert [float(states[name]) for name in ("identified", "since")] == [1, 0]
    tripped = list[bool]()
    for _ in range(round(1 / T)):
        item = block.evaluate({**u, "x_err": [9.0, 0.0]}, states, robot="arm2")
        tripped.append(float(item.outputs["tripped"]) == 1)
        states = {**item.next, "identified": 1}
    assert tripped.index(True) == round(blanking / T)


@pytest.mark.parametrize("settling", [0.0, 0.975])
def test_its_regression_is_that_of_numpy(settling: float) -> None:
    found, q, u = played(KIND(delay_up_to=3, taps=4, lasting=100.0, settling=settling), 1, 0.3, 1)
    dv = np.diff(np.concatenate([[0.0], np.diff(q) / T]))
    du = np.diff(np.concatenate([[0.0] * 4, u]))
    rows = np.array([du[k + 3 - np.arange(4)] for k in range(len(dv))])
    counts = np.arange(1, len(dv) + 1) * T >= settling
    rows, dv = rows[counts], dv[counts]
    np.testing.assert_allclose(found[-1].next["gathered"], rows.T @ rows, atol=1e-9)
    wanted = np.linalg.lstsq(rows, dv, rcond=None)[0]
    G, c = np.asarray(found[-1].next["gathered"]), np.ravel(found[-1].next["correlated"])
    np.testing.assert_allclose(np.linalg.solve(G, c), wanted, atol=1e-6)
    np.testing.assert_allclose(np.cumsum(wanted), [0.0, 0.7, 0.91, 0.973], atol=0.04)


def test_a_jump_at_the_start_does_not_hide_the_delay() -> None:
    """A ramp limits the acceleration until the path's velocity is reached, which resembles a lag of many samples."""
    delays = []
    for settling in (0.0, 1.0):
        block = KIND(delay_up_to=6, taps=8, settling=settling)
        rng, q, v, last, states = np.random.default_rng(0), 0.0, 0.0, 0.0, dict[str, Any](q_before=[0.0])
        for _ in range(84):
            toss = rng.uniform(-1, 1)
            u = {"q": [q], "dq_r": [1.0], "dq_sent": [1.0 + 0.03 * np.sign(toss)], "T": T}
            item = block.evaluate(u, states, robot="pendulum")
            states = dict(item.next)
            v, last = v + float(np.clip(last - v, -0.07, 0.07)), u["dq_sent"][0]
            q += T * v
        assert float(item.outputs["identified"]) == 1
        delays.append(float(item.outputs["delay_hat"]))
    assert delays[0] > 2
    assert delays[1] == 1


def test_in_doubt_the_delay_is_the_longer_one() -> None:
    """38 % of the response in the first sample, measured with noise: without confidence limits both delays occur."""
    found: dict[float, set[float]] = {0.0: set(), 3.0: set()}
    for confidence, seen in found.items():
        block = KIND(delay_up_to=6, taps=8, settling=0.0, lasting=2.0, confidence=confidence)
        for seed in range(5 if confidence else 40):
            if seen == {0.0, 1.0}:
                break
            rng, q, v, last, states = np.random.default_rng(seed), 0.0, 0.0, 0.0, dict[str, Any](q_before=[0.0])
            for _ in range(44):
                toss = rng.uniform(-1, 1)
                u = {"q": [q], "dq_r": [0.2], "dq_sent": [0.2 + 0.03 * np.sign(toss)], "T": T}
                item = block.evaluate(u, states, robot="pendulum")
                states = dict(item.next)
                v, last = last + 0.38 * (u["dq_sent"][0] - last) + 0.01 * rng.standard_normal(), u["dq_sent"][0]
                q += T * v
            seen.add(float(item.outputs["delay_hat"]))
    assert found[0.0] == {0.0, 1.0}
    assert min(found[3.0]) == 1.0


def test_without_a_response_it_goes_on() -> None:
    block, states = KIND(lasting=0.5), {"q_before": [0.0], "draw": [2**30 + 1]}
    for _ in range(14):
        u = {"q": [0.0], "dq_r": [0.0], "dq_sent": [0.0], "T": T}
        item = block.evaluate(u, states, robot="pendulum")
        states = dict(item.next)
    assert float(item.outputs["identified"]) == 0
    assert abs(float(item.outputs["dq_probe"][0])) == pytest.approx(0.03)


def test_configured_and_identified_delays_exclude_each_other() -> None:
    for kind, other in (
        ("sampled_tracking", {"Lambda": 1.0}),
        ("sampled_inverse", {"w_0": 1.0}),
        ("expert_aggregation", {}),
    ):
        with pytest.raises(DmframeError, match="expected delay: 0 with delay_up_to"):
            block_types()[kind](delay=1, delay_up_to=3, **other)
    with pytest.raises(DmframeError, match="delay_hat"):
        dm.load("ur10_slow_inverse_tuned").set({"task.delay_up_to": 2}).diagram  # noqa: B018


def test_the_signs_of_a_run_are_those_of_the_generator_in_integers() -> None:
    graph = dm.load("ur10_slow_probe").set({"inverse.seed": 999_983})
    record = graph.run(4.0, progress=False).recording
    added, draw = record["inverse.dq_c"] - record["task.dq_r"], drawn(999_983, 3)
    for row in added[:30]:
        np.testing.assert_array_equal(np.sign(row), [1 if value > 2**30 else -1 for value in draw])
        draw = [48271 * value % (2**31 - 1) for value in draw]


def test_the_signs_of_a_joint_are_balanced_and_white_and_independent_of_those_of_others() -> None:
    draws, signs = drawn(1, 6), list[list[int]]()
    for _ in range(4000):
        signs.append([1 if value > 2**30 else -1 for value in draws])
        draws = [48271 * value % (2**31 - 1) for value in draws]
    S = np.array(signs)
    bound = 4 / np.sqrt(len(S))
    assert np.abs(S.mean(axis=0)).max() < bound
    for lag in range(1, 9):
        assert np.abs(np.mean(S[lag:] * S[:-lag], axis=0)).max() < bound
    for lag in range(9):
        crossed = S[lag:].T @ S[: len(S) - lag] / (len(S) - lag)
        assert np.abs(crossed - np.diag(np.diag(crossed))).max() < bound


@pytest.mark.parametrize("seed", [0.5, 0, -1, 2_000_000])
def test_a_seed_is_a_whole_number(seed: float) -> None:
    for kind in ("delay_probe", "velocity_probe"):
        with pytest.raises(DmframeError, match=r"seed"):
            block_types()[kind](seed=seed)


@pytest.mark.parametrize(("factor", "trips"), [(0.5, False), (0.1, True), (10.0, True)])
def test_it_trips_where_the_period_becomes_another(factor: float, trips: bool) -> None:
    block = KIND(delay_up_to=2, tripping=True, watched="joints", lasting=2.0, settling=0.0)
    states: dict[str, Any] = {"q_before": [0.0], "draw": [5.0], "delay_hat": 1.0, "identified": 1.0, "error_scale": 1.0}
    states |= {"period_mean": T, "period_scale": T, "delay_least": 0.0}
    tripped = list[float]()
    for _ in range(200):
        u = {"q": [0.0], "dq_r": [0.0], "dq_sent": [0.0], "q_err": [0.1], "T": factor * T}
        item = block.evaluate(u, states, robot="pendulum")
        states = dict(item.next)
        tripped.append(float(item.outputs["tripped"]))
    assert bool(sum(tripped)) is trips
    assert float(states["delay_least"]) == 0.0  # the delay in samples may be equal
