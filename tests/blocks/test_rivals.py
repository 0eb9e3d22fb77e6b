"""Simple predictors of a servo's velocity error, compared with hand-written recursions and stability bounds."""

from __future__ import annotations

import copy
from math import pi, sin
from typing import Any

import numpy as np
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.catalogue import block_types
from dmframe.certify import verify
from dmframe.common.errors import DmframeError
from dmframe.robot.library import load
from dmframe.robot.symbolic import tool_position

BLOCKS = block_types()
PENDULUM = load("pendulum")
TOOL = tool_position(load("arm2"))
T = 0.02


def tool(q: Any) -> np.ndarray:
    """Position of the tool of arm2."""
    return np.array(TOOL(q), dtype=float).ravel()


def stepped(block: Any, states: dict[str, Any], q: float, dq_r: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """The outputs of a sample and the states after it, for one joint."""
    found = block.evaluate({"q": [q], "dq_r": [dq_r], "T": T}, states, robot=PENDULUM)
    return found.outputs, dict(found.next)


def followed(block: Any, lags: np.ndarray, delay: int = 0) -> list[dict[str, Any]]:
    """The outputs if each sample moves the joint by T (command - lag), `delay` samples after the command."""
    q, sent, states, found = 0.0, [0.0] * delay, dict[str, Any](), []
    states = {"q_before": [0.0], "queue": np.zeros((1, delay + 1))}
    for k, lag in enumerate(lags):
        outputs, states = stepped(block, states, q, 0.3)
        sent.append(float(outputs["dq_c"][0]))
        q += T * (sent[k] - lag)
        found.append({**outputs, "q": q, "sent": sent[k]})
    return found


@pytest.mark.parametrize(("alpha", "beta"), [(0.3, None), (0.5, 0.1), (0.0, None), (1.0, None)])
def test_level_and_trend_are_those_of_holts_recursion(alpha: float, beta: float | None) -> None:
    rng = np.random.default_rng(4)
    lags = rng.normal(size=40) * 0.1
    block = BLOCKS["disturbance_observer"](alpha=alpha, **({} if beta is None else {"beta": beta}))
    found = followed(block, lags)
    level = trend = 0.0
    for k in range(1, 40):  # no command acts in the first sample
        seen = lags[k - 1]
        error = seen - (level + trend)
        level, trend = level + trend + alpha * error, trend + (beta or 0.0) * error
        assert found[k]["lag"][0] == pytest.approx(seen)
        assert found[k]["dq_c"][0] == pytest.approx(0.3 + level + trend)


def test_without_gain_the_level_is_the_last_lag_as_with_one() -> None:
    lags = np.random.default_rng(5).normal(size=20) * 0.1
    plain, one = (followed(BLOCKS["disturbance_observer"](**options), lags) for options in ({}, {"alpha": 1.0}))
    assert [item["dq_c"][0] for item in plain] == pytest.approx([item["dq_c"][0] for item in one])


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_a_lag_that_grows_steadily_is_forecast_by_the_trend_and_missed_by_the_level(delay: int) -> None:
    lags = 0.001 * np.arange(90)
    level = followed(BLOCKS["disturbance_observer"](alpha=0.5, delay=delay), lags, delay)
    both = followed(BLOCKS["disturbance_observer"](alpha=0.5, beta=0.1, delay=delay), lags, delay)
    # the command that acts in sample k was sent `delay` samples before; it is 0.3 + the forecast of that sample's lag
    assert both[-1]["sent"] - 0.3 == pytest.approx(lags[-1], abs=1e-9)
    behind = (1 / 0.5 - 1) * 0.001 + (1 + delay) * 0.001
    assert lags[-1] - (level[-1]["sent"] - 0.3) == pytest.approx(behind, abs=1e-9)
    if delay:
        ends = [item["q"] for item in both]
        assert both[-delay]["q_start"][0] == pytest.approx(ends[-1], abs=1e-9)  # the position of the joint then


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_the_largest_gain_of_the_trend_is_where_an_eigenvalue_leaves_the_unit_circle(alpha: float) -> None:
    def largest(beta: float) -> float:
        return max(abs(np.linalg.eigvals(np.array([[1 - alpha, 1 - alpha], [-beta, 1 - beta]]))))

    most = 4 - 2 * alpha
    assert largest(0.999 * most) < 1 < largest(1.001 * most)
    BLOCKS["disturbance_observer"](alpha=alpha, beta=0.999 * most)
    with pytest.raises(DmframeError, match="expected beta below 4 - 2 alpha"):
        BLOCKS["disturbance_observer"](alpha=alpha, beta=1.001 * most)
    with pytest.raises(DmframeError, match="expected alpha"):
        BLOCKS["disturbance_observer"](beta=0.1)
    with pytest.raises(DmframeError, match="expected alpha of 1 at most"):
        BLOCKS["disturbance_observer"](alpha=1.1)


@pytest.mark.parametrize("margin", [0, 1, 2, 5])
def test_the_gain_from_margins_is_at_the_border_of_stability(margin: int) -> None:
    at = {
        "q_start": [0.5, 0.9],
        "x_d": [0.6, 0.2],
        "x_d_1": [0.6, 0.2],
        "x_d_2": [0.6, 0.2],
        "x_d_3": [0.6, 0.2],
        "T": T,
    }
    T_Lambda = 2 * sin(pi / (4 * margin + 2)) / 1.7
    by_margins = BLOCKS["sampled_tracking"](gain_margin=1.7, delay_margin=margin)
    by_gain = BLOCKS["sampled_tracking"](Lambda=T_Lambda / T)
    one, other = (block.evaluate(at, robot="arm2").outputs["dq_r"] for block in (by_margins, by_gain))
    np.testing.assert_allclose(one, other, rtol=1e-12)

    def largest(gain: float) -> float:  # of e(k+1) = e(k) - gain e(k - margin)
        polynomial = np.zeros(margin + 2)
        polynomial[0], polynomial[1] = 1, -1
        polynomial[-1] += gain
        return max(abs(np.roots(polynomial)))

    assert largest(0.999 * 1.7 * T_Lambda) < 1 < largest(1.001 * 1.7 * T_Lambda)
    for wrong in ({"gain_margin": 0.9}, {"Lambda": 3, "delay_margin": 2}, {"Lambda": 3, "gain_margin": 2}):
        with pytest.raises(DmframeError, match="expected"):
            BLOCKS["sampled_tracking"](**wrong)


@pytest.mark.parametrize("braking", [None, 0.5])
def test_joints_with_limited_acceleration_overshoot_without_braking_only(braking: float | None) -> None:
    """The tool jumps by 0.2 m; joints follow dq_r with at most 1 rad/s^2."""
    more = {} if braking is None else {"braking": [braking, braking]}
    block, q, v, errors = BLOCKS["sampled_tracking"](Lambda=20.0, **more), np.array([0.5, 0.9]), np.zeros(2), []
    goal = np.add(tool(q), [-0.15, 0.1])
    path = {"x_d": goal, **{f"x_d_{k}": goal for k in (1, 2, 3)}}
    for _ in range(150):
        found = block.evaluate({"q_start": q, **path, "T": T}, robot="arm2").outputs
        v = v + np.clip(np.ravel(found["dq_r"]) - v, -1.0 * T, 1.0 * T)
        q = q + T * v
        errors.append((tool(q) - goal) @ (tool([0.5, 0.9]) - goal))
    beyond = -min(errors) / ((tool([0.5, 0.9]) - goal) @ (tool([0.5, 0.9]) - goal))
    assert (beyond > 0.3) if braking is None else (beyond < 0.02 and abs(errors[-1]) < 1e-3)


def test_braking_leaves_small_errors_to_the_linear_feedback_and_limits_the_acceleration_of_large_ones() -> None:
    Lambda, most = 200.0, 0.5
    linear, block = (BLOCKS["sampled_tracking"](Lambda=Lambda, damping=0.0, **g) for g in ({}, {"braking": [most] * 2}))
    q = np.array([0.5, 0.9])

    def corrected(kind: Any, error: float) -> float:  # joint velocity of the first joint, which alone has that error
        goal = tool(q - [error, 0.0])
        path = {"x_d": goal, **{f"x_d_{k}": goal for k in (1, 2, 3)}}
        return -float(np.ravel(kind.evaluate({"q_start": q, **path, "T": 1e-6}, robot="arm2").outputs["dq_r"])[0])

    edge = most / Lambda**2
    assert corrected(block, 0.9 * edge) == pytest.approx(corrected(linear, 0.9 * edge), rel=1e-9)
    for error in (1.5 * edge, 4 * edge, 10 * edge):
        w, after = corrected(block, error), corrected(block, error * (1 + 1e-4))
        assert w * (after - w) / (error * 1e-4) == pytest.approx(most, rel=0.02)
    with pytest.raises(DmframeError, match="expected no braking with gamma"):
        BLOCKS["sampled_tracking"](gamma=1.0, braking=[1.0])


@pytest.mark.parametrize("delay", [0, 2])
def test_a_lag_that_repeats_is_forecast_exactly_in_the_end(delay: int) -> None:
    rate, count = 5.0, 240
    block = BLOCKS["repetitive_inverse"](rate=rate, harmonics=2, nu=6.0, delay=delay)
    lags = 0.1 + 0.2 * np.cos(rate * np.arange(count) * T) - 0.05 * np.sin(2 * rate * np.arange(count) * T)
    found = followed(block, lags, delay)
    theta = np.zeros(5)
    for k in range(count):  # the recursion of the class's docstring
        phase = k * rate * T
        h = np.array([1, np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)])
        epsilon = (lags[k - 1] if k else 0.0) - h @ theta
        theta = theta + h * epsilon / (6.0 + h @ h)
        assert found[k]["epsilon"][0] == pytest.approx(epsilon, abs=1e-12)
    missed = [abs(item["sent"] - 0.3 - lag) for item, lag in zip(found, lags, strict=True)]
    assert max(missed[-63:]) < 0.1 * max(missed[:63])  # over a period
    other = BLOCKS["repetitive_inverse"](rate=1.3 * rate, harmonics=2, nu=6.0, delay=delay)
    wrong = [abs(item["epsilon"][0]) for item in followed(other, lags[:120], delay)]
    assert max(wrong[-50:]) > 0.05  # a series of another period is not predicted


def repetitive(**options: Any) -> dict[str, Any]:
    graph = copy.deepcopy(sampled_arm2())
    graph["blocks"]["inverse"] = {"type": "repetitive_inverse", "rate": "0.5 rad/s", "harmonics": 2, **options}
    return graph


@pytest.mark.parametrize("delay", [0, 1])
def test_the_steps_of_the_series_are_proved_and_nothing_more(delay: int) -> None:
    graph = repetitive(delay=delay)
    if delay:
        graph["blocks"]["task"]["delay"] = delay
        graph["blocks"]["line"] = {"type": "transport_delay", "samples": delay}
    found = verify(dm.load(graph).diagram)
    assert found.outcome == "proved", found.reason
    assert "not known to be bounded, and tracking is not part of it" in str(found.headline)
    assert "that its rows follow from the plant is assumed" in str(found.headline)


def test_a_run_that_determines_few_of_many_constants_names_some_of_them(tmp_path: Any) -> None:
    run = dm.load({**repetitive(harmonics=20), "duration": "1 s"}).run(progress=False)
    (notice,) = [text for text in run.notices if "no sample of the run determines" in text]
    first = ", ".join(f"inverse.theta_true[{k}]" for k in range(1, 6))
    assert f"determines {first} and 77 others: V is evaluated with 0 for them" in notice


@pytest.mark.parametrize(("delay", "line"), [(0, 1), (1, 0), (1, 2)])
def test_a_delay_that_is_not_the_plants_fails(delay: int, line: int) -> None:
    graph = repetitive(delay=delay)
    graph["blocks"]["task"]["delay"] = delay
    graph["blocks"] |= {"line": {"type": "transport_delay", "samples": line}} if line else {}
    found = verify(dm.load(graph).diagram)
    assert found.outcome == "not_applicable"
    assert f"its rows use a delay of {delay} samples, and the plant delays commands by {line}" in found.reason
    graph["blocks"]["inverse"]["delay"] = line  # as the plant's
    (condition,) = [item for item in verify(dm.load(graph).diagram).conditions if "use a delay" in item.name]
    assert condition.holds
    assert str(condition.value) == "0.0"  # not -0.0


def test_the_reason_that_a_sampled_law_lacks_a_truth_is_the_plant_without_a_theorem() -> None:
    graph = copy.deepcopy(sampled_arm2(servo="p_pi"))
    gains = {"k_p": 20, "K_v": [60, 30], "K_i": [240, 120]}
    graph["blocks"]["servo"] = {"type": "p_pi_servo", **gains, "velocity_filter": "2 ms"}
    found = verify(dm.load(graph).diagram)
    assert found.outcome == "not_applicable"
    assert found.reason.startswith("servo: a p_pi_servo has no certificate: no theorem covers its velocity_filter")


def test_a_step_in_the_wrong_direction_is_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = BLOCKS["repetitive_inverse"]

    def equations(self: Any, u: Any, x: Any, p: Any) -> Any:
        found = kind_equations(self, u, x, p)
        return type(found)(outputs=found.outputs, next={**found.next, "theta": 2 * x.theta - found.next["theta"]})

    kind_equations = kind.equations
    monkeypatch.setattr(kind, "equations", equations)
    found = verify(dm.load(repetitive()).diagram)
    assert found.outcome == "refuted", found.reason
    assert found.refutation is not None
    assert found.refutation.statement == "inverse: next value of theta"
