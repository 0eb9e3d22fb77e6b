"""A path that waits in continuous time: its rate by hand, the velocity along it, and the proofs that remain valid."""

from __future__ import annotations

import numpy as np

import dmframe as dm
from dmframe.catalogue import block_types

REACH, U_MAX, RECOVERY = 0.1, 2.0, 0.5


def wish_by_hand(x_err: np.ndarray, dq_r: np.ndarray) -> np.ndarray:
    z = np.sum(x_err**2, axis=-1) / REACH**2 + np.sum((dq_r / U_MAX) ** 2, axis=-1)
    return np.asarray(2 / (1 + np.exp(2 * z)))  # 1 - tanh z


def test_its_rate_is_that_by_hand() -> None:
    block = block_types()["path_wait"](reach=REACH, u_max=U_MAX, recovery=RECOVERY)
    x, dq_r = np.array([0.05, -0.02, 0.01]), np.array([0.5, -1.0])
    found = block.evaluate({"x": x, "x_d": [0.0, 0.0, 0.0], "dq_r": dq_r}, {"t_path": 3.0, "pace": 0.4})
    np.testing.assert_allclose(found.rates["t_path"], 0.4)
    np.testing.assert_allclose(found.rates["pace"], (wish_by_hand(x, dq_r) - 0.4) / RECOVERY)


def test_a_path_waits_for_a_tool_that_begins_away_from_it_and_commands_less() -> None:
    graph = dm.load("ur10_paced")
    run = graph.run(until=20)
    data, T = run.data, 0.008
    pace, time = data["pace.pace"].values.ravel(), data["pace.t_path"].values.ravel()
    x_err, dq_r = data["arm.x"].values - data["path.x_d"].values, data["task.dq_r"].values
    stepped = pace + T * (wish_by_hand(x_err, dq_r) - pace) / RECOVERY
    np.testing.assert_allclose(pace[1:], stepped[:-1], atol=1e-12)
    np.testing.assert_allclose(np.diff(time), T * pace[:-1], atol=1e-12)
    along = 1.5 * time
    on_circle = np.array([-0.07, 0.67, 0.55]) + 0.15 * np.stack([np.sin(along), np.cos(along), 0 * along], axis=1)
    np.testing.assert_allclose(data["path.x_d"].values, on_circle, atol=1e-12)
    assert np.min(pace) < 0.4  # it waits
    assert pace[-1] > 0.9  # and continues
    assert np.max(pace) <= 1
    at_once = graph.set({"blocks.pace": None, "wires": {}}).run(until=3)
    commanded = [float(np.max(np.abs(each.data["inverse.dq_c"].values))) for each in (run, at_once)]
    assert commanded[0] < 0.95 * commanded[1]


def test_a_law_over_a_path_that_waits_is_proved_as_over_one_that_does_not() -> None:
    found = dm.load("ur10_paced").verify()
    assert found.proved
    assert all(control.refuted for control in found.verdict.controls)
    assert {"x - x_d", "d(x - x_d)/dt"} <= {item.signal for item in found.conclusions}
    assert found.verdict.states is not None
    assert not found.verdict.states.open
    assert "pace" in {item.signal for item in found.verdict.statements if item.says == "is bounded"}
    assert not any("derivatives are bounded" in item.text for item in found.assumptions)
