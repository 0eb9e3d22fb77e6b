"""Probe, identified servo model and aggregation in one loop, with delays that no block is configured for."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm

WIDE = {
    "k_P_box": [-100, 100],
    "k_I_box": [-1000, 1000],
    "k_u_box": [-5, 5],
    "k_q_box": [-200, 200],
    "inertia_box": [-1000, 1000],
    "friction_box": [-1000, 1000],
    "offset_box": [-10, 10],
}


def started(made: dict[str, Any], samples: int) -> dict[str, Any]:
    """The path, the task and the probe that both laws share, with a delay of so many samples."""
    blocks = made["blocks"]
    blocks["task"] = {"type": "sampled_tracking", "gain_margin": 1.67, "delay_up_to": 3}
    blocks["probe"] = {"type": "delay_probe", "delay_up_to": 3, "taps": 5, "lasting": "2 s"}
    if samples:
        blocks["way"] = {"type": "transport_delay", "samples": samples}
    return made | {"duration": "20 s", "start": {"q": [-0.15312, 1.32528]}}


def aggregated(samples: int) -> dm.Graph:
    """All blocks that use the identified delay."""
    model = {"servo": "p_pi", "estimator": "least_squares", "average": 1, "retention": 0.998, "settling": "1 s"}
    model |= {"supervised": True, "aggregated": True, "delay_up_to": 3, "k_P_size": 5, "k_I_size": 20}
    made = started(sampled_arm2(**model, **WIDE), samples)
    made["blocks"]["mix"] = {"type": "expert_aggregation", "delay_up_to": 3, "a_max": 4, "memory": "2 s"}
    made["wires"] = {"mix.dq_r": "probe.dq_probe", "inverse.dq_r": "probe.dq_probe", "mix.dq_model": "inverse.dq_c"}
    made["wires"] |= {"mix.q_model": "inverse.q_start", "task.q_start": "mix.q_start", "servo.dq_c": "mix.dq_sent"}
    return dm.load(made)


def inverse_of_j(samples: int) -> dm.Graph:
    """The same task and probe with prediction over the delay, which is configured; without adaptation."""
    made = started(sampled_arm2(), samples)
    made["blocks"]["inverse"] = {"type": "disturbance_observer", "alpha": 0, "delay": samples}
    made["wires"] = {"inverse.dq_r": "probe.dq_probe", "probe.dq_sent": "inverse.dq_c"}
    return dm.load(made)


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_with_the_delay_that_the_probe_identifies_the_error_is_far_below_that_of_the_inverse_of_j(samples: int) -> None:
    ends = []
    for graph in (aggregated(samples), inverse_of_j(samples)):
        run = graph.run(progress=False, judge=False)
        identified = run["probe.identified"].values
        assert not identified[:50].any()  # 2 s
        assert identified[51:].all()
        assert set(run["probe.delay_hat"].values[51:]) == {samples}
        assert run.error is not None
        ends.append(run.error.rms_final)
    assert ends[0] < 0.02 * ends[1]


def test_with_stops_and_twice_the_friction_the_identified_delay_has_the_least_error(tmp_path: Path) -> None:
    """The delay is 1; the study ``identified_delay.py`` has the cells of the race."""
    shutil.copy(Path(__file__).parents[2] / "docs" / "study" / "shifted_delay.py", tmp_path)
    made = aggregated(1).data
    blocks, wires = dict(made["blocks"]), dict(made["wires"])
    path = {"center": [0.6, 0.2], "radius": [0.1, 0.02, 0, 0], "rate": [0.5, -0.8, 0, 0], "phase": [0, 1, 0, 0]}
    blocks["path"] = {"type": "epicycles", **path, "stop": 1, "every": "4 s"}
    blocks["arm"] = {"type": "manipulator", "viscous": [2, 1], "coulomb": [1, 0.4]}
    errors = {}
    for shift in (-1, 0, 1):
        blocks["shifted"] = {"type": "shifted_delay.py:ShiftedDelay", "shift": shift}
        wires |= {f"{name}.delay_hat": "shifted.delay_hat" for name in ("task", "inverse", "mix")}
        wires["shifted.delay_probed"] = "probe.delay_hat"
        file = tmp_path / f"shifted_{shift}.yaml"
        file.write_text(json.dumps({**made, "blocks": blocks, "wires": wires}), encoding="utf-8")
        run = dm.load(file).run(progress=False, judge=False)
        assert run["probe.delay_hat"].values[-1] == 1
        assert run["shifted.delay_hat"].values[-1] == 1 + shift
        final = run.error.rms_final if run.error else None
        errors[shift] = math.inf if final is None else final  # None: the run diverged
    assert errors[0] < 0.5 * min(errors[-1], errors[1])


def test_the_trip_replaces_a_delay_that_is_too_short() -> None:
    """A threshold of 0 makes the first delay random; with this seed it is two samples too short."""
    graph = aggregated(2).set({"probe.threshold": 1e-3, "probe.confidence": 0, "probe.seed": 4})
    without = graph.run(progress=False, judge=False)
    assert set(without["probe.delay_hat"].values[51:]) == {0}
    assert without.error is not None
    assert without.error.rms_final > 0.1
    run = graph.set({"probe.tripping": True}).run(progress=False, judge=False)
    identified, tripped = (run[f"probe.{name}"].values.ravel() > 0.5 for name in ("identified", "tripped"))
    (at,) = np.flatnonzero(tripped)
    assert not identified[at + 1 : at + 41].any()  # 2 s
    assert run["probe.delay_hat"].values[-1] == 2
    assert run.error is not None
    assert run.error.rms_final < 5e-4
    T = graph.clock or 0
    counts = identified | (np.arange(tripped.size) >= round(1 / T))  # settling and dwell are 1 s
    errors = np.sum(run["task.x_err"].values ** 2, axis=-1)
    mean, scale = 0.0, 0.0
    for k in range(at + 1):
        mean += T * counts[k] * (errors[k] - mean)
        if identified[k + 1] and not identified[k]:
            scale = mean
        assert tripped[k] == bool(identified[k] and mean > 9 * scale)
