"""Aggregation of experts: weights against NumPy, the bound of their steps, the proof, and the loop with two links."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.block import Equations
from dmframe.catalogue import block_types
from dmframe.certify import verify
from dmframe.common.errors import DmframeError

KIND = block_types()["expert_aggregation"]
T, RATE = 0.02, 5.0
HALF = 8  # silent, four levels, three trends


def start(delay: int = 0, half: int = HALF) -> dict[str, Any]:
    """At rest at zero, for one joint."""
    return {"q_before": [0.0], "forecasts": np.zeros((1, 2 * half * (delay + 1)))}


def played(block: Any, lags: np.ndarray, errors: np.ndarray) -> list[dict[str, Any]]:
    """A joint that moves by T (command - lag), and a model that knows the lag but for an error."""
    q, states, found = 0.0, start(), []
    for lag, error in zip(lags, errors, strict=True):
        before = errors[len(found) - 1] if found else 0.0
        u = {"q": [q], "dq_r": [0.3], "dq_model": [0.3 + lag - error], "q_model": [q], "slope": [1.0], "T": T}
        item = block.evaluate({**u, "epsilon": [before]}, states, robot="pendulum")
        states = dict(item.next)
        found.append({**item.outputs, **{f"{name} after": value for name, value in states.items()}, "q": q})
        q += T * (float(item.outputs["dq_sent"][0]) - lag)
    return found


def errors_of(found: list[dict[str, Any]], k: int) -> np.ndarray:
    """The errors in sample k of the forecasts of all experts, in rad/s."""
    return (np.ravel(found[k - 1]["forecasts after"])[: 2 * HALF] - found[k]["q"]) / T


def all_weights(found: dict[str, Any]) -> np.ndarray:
    rest = np.ravel(found["weights after"])
    return np.concatenate([[1 - rest.sum()], rest])


LAGS = 0.1 + 0.05 * np.sin(RATE * np.arange(60) * T)
ERRORS = 0.01 * np.cos(1.7 * RATE * np.arange(60) * T) + 0.003


def corrections_of(found: dict[str, Any]) -> np.ndarray:
    """The correction of each expert, from the pose that it forecasts after the command that is sent."""
    ends = np.ravel(found["forecasts after"])[: 2 * HALF]
    return found["dq_sent"][0] - (ends - found["q"]) / T


@pytest.mark.parametrize("roughness", [0.0, 0.3])
def test_exponential_weights_are_powers_of_discounted_losses(roughness: float) -> None:
    found = played(KIND(memory=0.4, roughness=roughness), LAGS, ERRORS)
    losses, w, M = np.zeros(2 * HALF), np.eye(2 * HALF)[0], 0.4 / T
    for k in range(2, 60):
        losses = (1 - 1 / M) * losses + errors_of(found, k) ** 2
        if k > 2:
            c = [corrections_of(found[k - i]) for i in (1, 2, 3)]
            losses += (roughness * (c[0] - 2 * c[1] + c[2])) ** 2
        wanted = (losses + 1e-16) ** (-M / 2)
        w = w + 0.2 * (wanted / wanted.sum() - w)
        if k == 2:
            np.testing.assert_allclose(all_weights(found[k]).sum(), 1, rtol=1e-12)
            w = all_weights(found[k])  # the first forecasts of all experts but the silent one are equal
            continue
        np.testing.assert_allclose(all_weights(found[k]), w, atol=1e-9)
    best = int(np.argmin(losses))
    assert all_weights(found[-1])[best] == max(all_weights(found[-1]))


def test_the_command_is_the_mean_that_the_weights_give() -> None:
    found = played(KIND(memory=0.4), LAGS, ERRORS)[-1]
    w = all_weights(found)
    ends = np.ravel(found["forecasts after"])[: 2 * HALF]
    # the pose that the aggregation forecasts is that of dq_r
    assert w @ ends == pytest.approx(found["q_start"][0] + T * 0.3, abs=1e-12)
    assert found["model_share"][0] == pytest.approx(w[HALF:].sum())


def test_a_repeating_error_is_forecast_better_than_by_the_model_and_by_the_last_lag() -> None:
    found = played(KIND(), LAGS, ERRORS)
    late = range(40, 60)
    mine = [abs(all_weights(found[k - 1]) @ errors_of(found, k)) for k in late]
    model, last = ([abs(errors_of(found, k)[i]) for k in late] for i in (HALF, 1))
    assert np.sqrt(np.mean(np.square(mine))) < 0.5 * np.sqrt(np.mean(np.square(model)))
    assert np.sqrt(np.mean(np.square(mine))) < 1.02 * np.sqrt(np.mean(np.square(last)))


def test_steps_of_the_projection_lose_to_no_expert_by_more_than_its_error() -> None:
    nu, Gamma = 1e-4, 0.5
    found = played(KIND(weighting="projection", nu=nu, Gamma=Gamma), LAGS, ERRORS)
    w = np.zeros(2 * HALF - 1)
    for k in range(2, 60):
        errors = errors_of(found, k)
        h, y = errors[1:] - errors[0], -errors[0]
        n = nu + Gamma * h @ h
        new = np.clip(w + Gamma * h * (y - h @ w) / n, 0, 1)
        np.testing.assert_allclose(np.ravel(found[k]["weights after"]), new, atol=1e-12)
        for i in range(2 * HALF):
            one = np.eye(2 * HALF)[i][1:]
            rises = ((new - one) @ (new - one) - (w - one) @ (w - one)) / Gamma
            epsilon = y - h @ w  # the error with w = e_i is that of expert i
            assert rises <= (errors[i] ** 2 - nu / n * epsilon**2) / n + 1e-12
        w = new


def test_large_steps_can_have_four_times_the_error_of_the_best_weights() -> None:
    w, nu, Gamma, own, best, rises = 0.5, 1e-9, 1.0, 0.0, 0.0, 0.0
    for k in range(1000):  # h = 1, and the output alternates around the best weight 0.5
        y = 0.5 + 0.4 * (-1) ** k
        n = nu + Gamma
        new = w + Gamma * (y - w) / n
        rises += ((new - 0.5) ** 2 - (w - 0.5) ** 2) / Gamma
        own, best, w = own + (y - w) ** 2, best + (y - 0.5) ** 2, new
    assert own / best == pytest.approx(4, rel=2e-3)
    assert best / n - nu * own / n**2 >= rises


def test_a_command_changes_by_at_most_a_max() -> None:
    found = played(KIND(a_max=[0.5]), 10 * LAGS, ERRORS)
    sent = np.array([item["dq_sent"][0] for item in found])
    assert np.abs(np.diff(sent)).max() == pytest.approx(0.5 * T)
    assert abs(sent[0]) <= 0.5 * T + 1e-12


def moved(
    most: float, wanted: np.ndarray, dt: float, *, lag: float, ramp: bool, **options: Any
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The commands, and the first states and those after each sample, along that velocity of the path.

    The servo has that lag, after a ramp or not. The robot moves by 20 steps of Euler's method in a sample, not by the
    filters of the block.
    """
    block, q, r, v, states, sent = KIND(a_max=[most], **options), 0.0, 0.0, 0.0, [start()], list[float]()
    for speed in wanted:
        u = {"dq_model": [speed], "q_model": [q], "slope": [1.0], "epsilon": [0.0], "T": dt}
        item = block.evaluate({**u, "q": [q], "dq_r": [speed], "dq_path": [speed]}, states[-1], robot="pendulum")
        states.append(dict(item.next))
        sent.append(float(item.outputs["dq_sent"][0]))
        r += np.clip(sent[-1] - r, -most * dt, most * dt) if ramp else sent[-1] - r
        for _ in range(20):
            v += (r - v) * dt / 20 / lag if lag else r - v
            q += v * dt / 20
    return np.array(sent), states


@pytest.mark.parametrize(("ramp", "lag"), [(False, 0.0), (False, 0.141), (True, 0.0), (True, 0.052)])
def test_a_path_that_needs_more_than_a_max_gets_it_unless_a_ramp_limits_the_robot(ramp: bool, lag: float) -> None:
    most, speed = 0.5, 0.3 * np.sin(4 * T * np.arange(200))  # up to 1.2 rad/s^2
    sent, states = moved(most, speed, T, lag=lag, ramp=ramp)
    if ramp:
        assert states[-1]["evidence"] < -1e-3
        assert np.abs(np.diff(sent[100:])).max() == pytest.approx(most * T)
    else:
        assert states[-1]["evidence"] > 0
        assert np.abs(np.diff(sent[100:])).max() > 1.5 * most * T
    if not ramp and not lag:
        np.testing.assert_allclose(sent[20:], speed[20:], atol=1e-12)  # from there on it is shown


@pytest.mark.parametrize(
    ("evidence", "left", "lags", "limits"),
    [
        (0.0, 0.0, 0.0, "path"),  # nothing is known
        (2e-4, 0.0, 0.0, "corrections"),
        (2e-4, 5e-3, 0.0, "path"),  # 10 s with a mean square of 5e-4: less than 1e-3 may be chance
        (2e-3, 5e-3, 0.0, "corrections"),
        (-5e-4, 0.0, 0.0, "path"),
        (-1.5e-3, 0.0, 0.0, "ramp"),
        (-1.5e-3, 5e-3, 0.0, "path"),
        (-4e-3, 5e-3, 0.0, "ramp"),
        (-4e-3, 5e-3, 2e-2, "path"),  # a lag between two filters may leave a ninth of 2.9e-2
    ],
)
def test_corrections_exceed_a_max_only_where_the_motion_shows_that_the_robot_follows(
    evidence: float, left: float, lags: float, limits: str
) -> None:
    most, needed = 0.5, 0.8 * T
    block = KIND(a_max=[most])
    sums = {"missed_r": np.full((1, 6), left + max(evidence, 0)), "missed_u": np.full((1, 6), left - min(evidence, 0))}
    sums["missed_u"][0, 0] += lags
    for sign in (1, -1):
        u = {"q": [0.0], "dq_model": [0.0], "q_model": [0.0], "slope": [1.0], "epsilon": [0.0], "T": T}
        u |= {"dq_r": [sign * 9.0], "dq_path": [sign * needed]}
        item = block.evaluate(u, {**start(), **sums, "count": 10 / T}, robot="pendulum")
        room = {"ramp": most * T, "path": needed, "corrections": 2 * needed}[limits]
        assert float(item.outputs["dq_sent"][0]) == pytest.approx(sign * room)


@pytest.mark.parametrize("needed", [0.0, 0.8])
@pytest.mark.parametrize("sign", [1, -1])
def test_after_a_trial_corrections_exceed_the_limits_by_twice_a_max(needed: float, sign: int) -> None:
    most = 0.5
    u = {"q": [0.0], "dq_model": [0.0], "q_model": [0.0], "slope": [1.0], "epsilon": [0.0], "T": T}
    u |= {"dq_r": [sign * 9.0], "dq_path": [sign * needed * T]}
    item = KIND(a_max=[most], trial=[0.03]).evaluate(u, {**start(), "follows": 1, "count": 1e6}, robot="pendulum")
    assert float(item.outputs["dq_sent"][0]) == pytest.approx(sign * T * (max(most, needed) + 2 * most))


@pytest.mark.parametrize(("evidence", "follows"), [(-9e-4, 1), (-1.1e-3, 0)])
def test_that_the_robot_follows_remains_shown_until_a_ramp_is(evidence: float, follows: int) -> None:
    missed_u = np.full((1, 6), -evidence)
    sums = {"missed_r": np.zeros((1, 6)), "missed_u": missed_u, "count": 1e6, "follows": 1}
    u = {"q": [0.0], "dq_r": [0.0], "dq_path": [0.0], "dq_model": [0.0], "q_model": [0.0], "slope": [1.0]}
    item = KIND(a_max=[0.5], trial=[0.03], doubt=1e-3 * 8 / 9).evaluate(
        {**u, "epsilon": [0.0], "T": T}, {**start(), **sums}, robot="pendulum"
    )  # N/9 is a ninth of the evidence
    assert float(item.next["follows"]) == follows


@pytest.mark.parametrize(("ramp", "lag"), [(False, 0.0), (False, 0.03), (True, 0.0), (True, 0.03)])
def test_the_trial_shows_on_a_slow_path_whether_the_robot_follows(ramp: bool, lag: float) -> None:
    most, dt, share = 1.4, 0.02, 0.03
    speed = 0.1 * np.sin(dt * np.arange(100))  # up to 0.1 rad/s^2
    _, states = moved(most, speed, dt, lag=lag, ramp=ramp)
    assert float(states[-1]["evidence"]) == 0
    sent, states = moved(most, speed, dt, lag=lag, ramp=ramp, trial=[share], doubt=1e-4)
    assert [float(states[k]["follows"]) for k in (15, -1)] == [not ramp] * 2
    wave = np.array([float(np.ravel(after["wave"])[0]) for after in states[1:]])
    size = most * dt / 2 + share
    np.testing.assert_allclose(np.abs(wave[wave != 0]), size)
    assert np.abs(np.diff(sent)).max() > 2 * size - most * dt
    assert np.flatnonzero(wave)[-1] * dt <= 0.25
    assert abs(dt * wave.sum()) < 3e-3
    if ramp:
        assert np.abs(np.diff(sent[15:])).max() <= most * dt + 1e-12


@pytest.mark.parametrize(("speed", "time", "tries"), [(0.9, 0.24, 1), (0.9, 0.26, 0), (0.95, 0.24, 1), (0.97, 0.24, 0)])
def test_the_trial_ends_in_time_and_leaves_commands_within_u_max(speed: float, time: float, tries: int) -> None:
    """The square wave has the amplitude 1.4 T/2 + 0.03 = 0.044."""
    u = {"q": [T * speed], "dq_model": [speed], "q_model": [T * speed], "slope": [1.0], "epsilon": [0.0], "T": T}
    u |= {"dq_r": [speed], "dq_path": [speed]}
    states = {"q_before": [0.0], "queue": [[speed]], "path_before": [speed], "ramped": [speed], "count": time / T}
    states["forecasts"] = np.full((1, 2 * HALF), T * speed)
    item = KIND(a_max=[1.4], trial=[0.03], u_max=[1.0]).evaluate(u, states, robot="pendulum")
    assert float(np.ravel(item.next["wave"])[0]) == pytest.approx(0.044 * tries)
    assert float(item.outputs["dq_sent"][0]) == pytest.approx(speed + 0.044 * tries)


def test_a_servo_that_lags_behind_many_short_accelerations_is_not_taken_for_a_ramp() -> None:
    """Each is shorter than three times the lag, so that it looks more like a ramp than like a servo without a lag."""
    most, dt, lag = 0.5, 0.008, 0.06
    t = dt * np.arange(300)
    speed = 0.06 * np.sin(12 * t)  # up to 0.72 rad/s^2
    sent, states = moved(most, speed, dt, lag=lag, ramp=False)
    r, plain, v = 0.0, 0.0, 0.0
    for u in sent:  # |v - r|^2 - |v - u|^2, with the velocity of a servo of first order
        r, v = r + np.clip(u - r, -most * dt, most * dt), v + (u - v) * (1 - np.exp(-dt / lag))
        plain += dt * ((v - r) ** 2 - (v - u) ** 2)
    assert plain < -1e-3
    assert (
        states[-1]["evidence"] > -0.2 * np.ravel(states[-1]["missed_u"])[0] / 9
    )  # what a lag between those of the filters may leave


def test_a_model_whose_inverse_is_unstable_keeps_its_weight_by_its_forecasts_alone() -> None:
    """v = (u + b u_before)/(1 + b) - lag: with b > 1 the exact inverse oscillates, and its forecasts are exact."""
    b, lag, peaks = 1.1, 0.05, dict[float, float]()
    for roughness in (0.0, 0.5):
        block, q, before, states, sent = KIND(memory=1, roughness=roughness), 0.0, 0.0, start(), list[float]()
        for k in range(250):
            wanted = 0.3 * np.sin(2 * k * T)
            inverse, model = (1 + b) * (wanted + lag) - b * before, {"slope": [1 / (1 + b)], "epsilon": [0.0]}
            u = {"q": [q], "dq_r": [wanted], "dq_model": [inverse], "q_model": [q], "T": T}
            item = block.evaluate({**u, **model}, states, robot="pendulum")
            states = dict(item.next)
            sent.append(float(item.outputs["dq_sent"][0]))
            q += T * ((sent[-1] + b * before) / (1 + b) - lag)
            before = sent[-1]
        peaks[roughness] = float(np.abs(sent[-100:]).max())
    assert peaks[0.0] == pytest.approx(3.0)  # u_max
    assert peaks[0.5] < 0.6


@pytest.mark.parametrize("weighting", ["exponential", "projection"])
def test_the_silent_expert_is_alone_while_the_delay_is_unknown(weighting: str) -> None:
    block, lag = KIND(delay_up_to=1, weighting=weighting), 0.2
    q, states, shares = 0.0, start(1), []
    for k in range(120):
        identified = float(20 <= k < 80)  # unknown, known, and unknown again
        u: dict[str, Any] = {"q": [q], "dq_r": [0.3], "q_model": [q + 0.01]}
        u |= {"dq_model": [9.0 if identified == 0 else 0.3 + lag]}
        u |= {"slope": [1.0], "T": T, "epsilon": [0.001], "delay_hat": identified, "identified": identified}
        item = block.evaluate(u, states, robot="pendulum")
        states = dict(item.next)
        shares.append(abs(float(item.outputs["dq_sent"][0]) - 0.3))
        if not identified:
            assert item.outputs["dq_sent"][0] == pytest.approx(0.3, abs=1e-12)
            assert item.outputs["q_start"][0] == pytest.approx(q, abs=1e-12)
            assert item.outputs["model_share"][0] == pytest.approx(0, abs=1e-12)
        q += T * (float(item.outputs["dq_sent"][0]) - lag)
    assert max(shares[40:80]) > lag / 2  # the others have weight while it is known


@pytest.mark.parametrize(
    "options", [{"periodic": True}, {"rate": 1.0}, {"delay": 9}, {"memory": -1}, {"roughness": -1}]
)
def test_options_that_do_not_fit_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(DmframeError):
        KIND(**options)


def aggregated(**mix: Any) -> dict[str, Any]:
    """Two links at 40 ms, a model of each joint without coupling, and the aggregation."""
    inverse = {"estimator": "least_squares", "supervised": True, "aggregated": True, "dynamics": "joints"}
    graph = copy.deepcopy(sampled_arm2(**inverse))
    graph["blocks"]["task"] = {"type": "sampled_tracking", "Lambda": 3}
    graph["blocks"]["mix"] = {"type": "expert_aggregation", **mix}
    wires = {"mix.dq_model": "inverse.dq_c", "mix.q_model": "inverse.q_start", "task.q_start": "mix.q_start"}
    graph["wires"] = {**wires, "servo.dq_c": "mix.dq_sent"}
    return graph


def test_the_steps_of_projected_weights_are_proved_and_no_more() -> None:
    found = verify(dm.load(aggregated(weighting="projection")).diagram)
    assert "mix.weights" in str(found.headline), found.headline
    assert "not known to be bounded, and tracking is not part of it" in str(found.headline)


def test_exponential_weights_are_no_part_of_the_proof() -> None:
    found = verify(dm.load(aggregated()).diagram)
    assert found.outcome == "proved", found.reason
    assert "inverse.theta" in str(found.headline)
    assert "mix.weights" not in str(found.headline)


def test_projected_weights_that_step_away_are_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = KIND.equations

    def away(self: Any, u: Any, x: Any, p: Any) -> Equations:
        found = honest(self, u, x, p)
        return Equations(outputs=found.outputs, next={**found.next, "weights": 2 * x.weights - found.next["weights"]})

    monkeypatch.setattr(KIND, "equations", away)
    found = verify(dm.load(aggregated(weighting="projection")).diagram)
    assert found.outcome == "refuted"
    assert found.refutation is not None
    assert found.refutation.statement == "mix: next value of weights"


def test_the_loop_is_better_than_with_the_model_alone_and_with_the_observer_alone() -> None:
    def error(graph: dict[str, Any]) -> float:
        found = dm.load({**graph, "duration": "60 s"}).run(judge=False, progress=False).error
        assert found is not None
        return float(found.rms_by_eighth[-1])

    gains = {"k_p": 3, "K_v": [60, 30], "K_i": [120, 60], "feed_forward": [0.8, 0.9]}
    cascade = {"type": "p_pi_servo", **gains, "velocity_filter": "2 ms", "torque_lag": "1 ms"}
    alone, both = aggregated(), aggregated()
    for graph in (alone, both):  # the model is that of a PID servo
        graph["blocks"]["inverse"]["dynamics"] = "robot"
        graph["blocks"]["servo"] = cascade
    alone["blocks"]["inverse"].update(supervised=False, aggregated=False)
    del alone["blocks"]["mix"]
    model = error({**alone, "wires": {}})
    alone["blocks"]["inverse"] = {"type": "disturbance_observer"}
    observer = error({**alone, "wires": {}})
    assert error(both) < 0.7 * min(model, observer)
