"""Conditions for a bounded run of a day for the packaged graphs on their clocks; ``make soak`` runs all of them."""

from __future__ import annotations

import numpy as np
import pytest

import dmframe as dm

WITHOUT = {  # each was examined separately with `make soak`; a new graph has to be examined too
    "filtered_regulation_pi",
    "filtered_regulation_pid",
    "observed_regulation_pi",
    "observed_regulation_pid",
    "panda_full",
    "slotine_li",
    "ur10_camera",
    "ur10_pose",
    "ur10_pose_observed",
    "ur10_posture",
    "ur10_slow",
    "ur10_slow_tied_position",
}


def sampled() -> list[str]:
    """The packaged graphs with adaptation of the dynamics in discrete time."""
    found = {name: dm.load(name) for name in dm.graphs()}
    adapts = {
        name: type(graph.blocks.get("dynamics")).__name__ == "DynamicCompensator" for name, graph in found.items()
    }
    return [name for name, graph in found.items() if graph.clock is not None and adapts[name]]


def test_what_adapts_on_a_clock_has_a_box_or_is_known_to_have_none() -> None:
    bare = {name for name in sampled() if dm.load(name).blocks["dynamics"].a_d_hat_box is None}  # type: ignore[attr-defined]
    assert bare == WITHOUT


def test_without_its_posture_and_with_twice_the_gain_the_panda_wanders_off_and_diverges() -> None:
    kept = {"log.every": "1 s", "log.signals": ["arm.q"]}
    graph = dm.load("panda_full").set(kept)
    with_posture = graph.run("620 s", engine="compiled")
    assert with_posture.divergence is None
    assert np.ptp(with_posture["arm.q"].values[60:], axis=0).max() < 0.6
    without = graph.set({"blocks.posture": None, "dynamics.Gamma": 30}).run("700 s", engine="compiled")
    assert without.divergence is not None
    assert 500 < without.divergence.time < 700
    assert np.ptp(without["arm.q"].values[60:], axis=0).max() > 1.5


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_fast", "ur10_fast_tuned"])
def test_its_boxes_change_nothing_before_they_are_needed(name: str) -> None:
    boxes = {"dynamics.a_d_hat_box": None}
    if name == "ur10_fast":
        boxes |= {f"inverse.{estimate}_box": None for estimate in ("w", "w_P", "w_I")}
    graph = dm.load(name).set({"log.every": "1 s"})
    packaged, free = (run.run("60 s", engine="compiled")["dynamics.a_d_hat"] for run in (graph, graph.set(boxes)))
    np.testing.assert_allclose(packaged, free, rtol=1e-8, atol=1e-10)
