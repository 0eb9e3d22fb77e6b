"""A path with variable pace: its time by hand, and its effect on joints at their velocity limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.catalogue import block_types
from dmframe.common.errors import DmframeError

T, LIMIT = 0.04, 0.4
PACE = {"type": "path_pace", "u_max": LIMIT}


def graph(inverse: dict[str, Any] | None = None, delay: int = 0, **blocks: dict[str, Any]) -> dm.Graph:
    """A planar arm whose path requires one and a half times the velocity limits of its joints."""
    wires = {"path.t": "pace.t_path"} if "pace" in blocks else {}
    made: dict[str, Any] = {
        "dmframe": 1,
        "robot": "arm2",
        "clock": T,
        "duration": "20 s",
        "start": {"q": [-0.15312, 1.32528]},
        "blocks": {
            "path": {"type": "circle", "center": [0.6, 0.2], "radius": 0.1, "rate": "2 rad/s"},
            "task": {"type": "sampled_tracking", "Lambda": 3, "delay": delay},
            "inverse": {"type": "disturbance_observer", "u_max": LIMIT, "delay": delay, **(inverse or {})},
            "servo": {"type": "pid_servo", "K_D": [60, 30], "K_P": [120, 60], "K_I": [40, 20]},
            "arm": {"type": "manipulator", "viscous": [1, 0.5], "coulomb": [0.5, 0.2]},
            **({"way": {"type": "transport_delay", "samples": delay}} if delay else {}),
            **blocks,
        },
        "wires": wires,
    }
    return dm.load(made, name="paced")


def ends(run: dm.Run) -> float:
    assert run.error is not None
    return run.error.rms_final


def test_its_rates_are_those_by_hand() -> None:
    pace = block_types()["path_pace"](u_max=[2.0, 0.5], share=0.8, recovery=4.0)
    for dq_c, r, after in (
        ([1.0, 0.5], 0.6, 0.6 / (0.5 / 0.4)),  # the second joint exceeds its fraction of the limit, 0.4 rad/s
        ([-1.8, 0.1], 0.6, 0.6 / (1.8 / 1.6)),
        ([1.0, -0.3], 0.6, 0.6 + T / 4 * 0.4),
    ):
        found = pace.evaluate({"dq_c": dq_c, "T": T}, {"path_time": 3.0, "rates": [r]})
        np.testing.assert_allclose(found.next["rates"], after)
        np.testing.assert_allclose(found.next["path_time"], 3 + T * r)
        times = [float(found.outputs[f"t_path_{k}" if k else "t_path"]) for k in range(10)]
        np.testing.assert_allclose(times, 3 + T * r * np.arange(10))


def test_a_path_that_waits_is_followed_and_one_that_does_not_is_not() -> None:
    waits, hurries = graph(pace=PACE).run(progress=False), graph().run(progress=False)
    assert ends(waits) < 0.001 < 0.01 < ends(hurries)
    found = waits.recording
    s = np.asarray(found["pace.t_path"]).ravel()
    wanted = np.array([0.6, 0.2]) + 0.1 * np.column_stack([np.sin(2 * s), np.cos(2 * s)])
    np.testing.assert_allclose(found["path.x_d"], wanted, atol=1e-12)
    assert 0.4 < s[-1] / 20 < 0.9  # it takes the necessary time, but not more
    settled = np.abs(np.asarray(found["inverse.dq_c"]))[50:]
    assert np.max(settled) < LIMIT
    useless = graph(pace={**PACE, "share": 100}).run(progress=False)
    assert ends(useless) > 0.01


@pytest.mark.parametrize("delay", [0, 2, 4])
def test_what_it_states_of_its_time_to_come_is_what_comes(delay: int) -> None:
    law = {"type": "sampled_inverse", "w_0": 0.02} if delay > 2 else None  # the observer has shorter delays
    made = graph(law, delay=delay, pace={**PACE, "delay": delay})
    found = made.run("6 s", progress=False, engine="interpreted").recording
    s = np.asarray(found["pace.t_path"]).ravel()
    for k in range(1, delay + 2):
        np.testing.assert_allclose(np.asarray(found[f"pace.t_path_{k}"]).ravel()[:-k], s[k:], atol=1e-12)
    assert np.ptp(np.asarray(found["pace.pace"])) > 0.2
    compiled = made.run("6 s", progress=False, engine="compiled").recording
    np.testing.assert_allclose(compiled["arm.q"], found["arm.q"], atol=1e-8)


def test_a_delay_beyond_the_longest_is_refused() -> None:
    with pytest.raises(DmframeError, match=r"pace\.delay: expected .*8.*, found 9"):
        _ = graph(pace={**PACE, "delay": 9}).blocks


def test_the_laws_proof_stays_as_it_is() -> None:
    law = {"type": "sampled_inverse", "w_0": 0.02, "replay": 2}
    found = graph(inverse=law, pace=PACE).verify().verdict
    assert found.outcome == "proved", found.reason
    assert all(control.refuted for control in found.controls)


def test_a_clock_that_does_not_state_what_comes_is_refused() -> None:
    text = graph(pace=PACE).text.replace("pace.t_path", "pace.pace")
    with pytest.raises(DmframeError, match=r"to have an output pace_1, the future pace, found none; see path_pace"):
        _ = dm.load(text).diagram


def test_a_path_that_waits_requires_a_start_pose() -> None:
    made = graph(pace=PACE).text
    with pytest.raises(DmframeError, match=r"start: expected arm\.q, found none; path scales the time of its path"):
        dm.load(made.replace("q: [-0.15312, 1.32528]", "")).run("0.4 s", progress=False)
