"""Laws that use the robot's reported target: the applied command is then known, for any channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
from dmframe.catalogue import block_types
from dmframe.certify import verify
from dmframe.common.errors import WiringError

BLOCKS = block_types()
ARM = dm.load("ur10_slow_sampled").robot
START = np.array([2.023732, -1.174227, 1.336627])
T = 0.09
LATE = {"transport_delay": {"samples": 1, "late": 0.5}}


def with_echo(
    name: str = "ur10_slow_sampled", block: str = "inverse", echo: str = "servo.q_c", delay: int = 0
) -> dm.Graph:
    values: dict[str, Any] = {f"{block}.delay": delay, "task.delay": delay}
    if echo:
        values |= {f"{block}.echoed": True, f"wires.{block}.q_echo": echo}
    return dm.load(name).set(values)


def test_where_commands_arrive_as_they_were_sent_an_echo_changes_nothing() -> None:
    graphs = [with_echo(echo=echo).set({"inverse.replay": 2}) for echo in ("", "servo.q_c", "arm.q")]
    runs = [graph.run("6 s", progress=False, engine="interpreted") for graph in graphs]
    poses = [run.recording["arm.q"] for run in runs]
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-10)
    assert np.max(np.abs(poses[2] - poses[0])) > 1e-4  # a signal that is not the target is detected


@pytest.mark.parametrize("name", ["sampled_inverse", "disturbance_observer"])
def test_what_is_estimated_is_as_if_the_command_that_was_echoed_had_been_sent(name: str) -> None:
    sent, acted = np.array([[0.2], [0.5], [0.2]]), np.array([[0.1], [0.6], [0.0]])
    inverse = name == "sampled_inverse"
    options = {"w_0": 1 / 800, "replay": 2} if inverse else {}
    begin = BLOCKS[name](**options)

    def after(queue: np.ndarray, echo: bool) -> Mapping[str, Any]:
        law = BLOCKS[name](echoed=echo, **options) if echo else begin
        given: dict[str, Any] = {"q": START + 0.01, "dq_r": [0.1, 0.2, -0.1], "T": T}
        memory: dict[str, Any] = {"q_before": START, "queue": queue}
        if inverse:
            size = len(begin.elements(ARM)["c"])
            memory |= {"theta": np.zeros(size), "rows": np.zeros((2, size)), "goals": np.zeros((2, 3)), "count": 1.0}
            memory |= {"psi_slow": np.zeros(size), "y_slow": np.zeros(3), "z": np.zeros(3), "plans": np.zeros((3, 1))}
            memory |= dict.fromkeys(("m_before", "m_planned"), START) | {"v_before": np.zeros(3)}
        if echo or inverse:
            memory["q_aim"] = START
        if echo:
            given["q_echo"] = START + T * acted.ravel()
        found = law.evaluate(given, memory, robot=ARM)
        return {**found.next, **found.outputs}

    replayed, right, wrong = after(sent, echo=True), after(acted, echo=False), after(sent, echo=False)
    labels = ("theta", "rows", "goals", "q_aim", "z", "epsilon", "dq_c") if inverse else ("lag", "dq_c")
    for label in labels:
        np.testing.assert_allclose(replayed[label], right[label], atol=1e-12, err_msg=label)
    assert max(np.max(np.abs(replayed[label] - wrong[label])) for label in labels) > 1e-2


def test_a_random_delay_is_then_borne_by_the_law_alone() -> None:
    run = with_echo(delay=1).reality(LATE).run("60 s", progress=False)
    assert run.error is not None
    assert run.error.rms_final < 2.5e-3  # [m]; without an echo the error is 30 times as large, and grows
    assert np.max(run.error.norm[run.time > 2]) < 8e-3


def test_the_proof_does_not_ask_where_the_command_was_read() -> None:
    found = verify(dm.load(arm2()).diagram)
    assert found.outcome == "proved", found.reason
    assert found.controls
    assert all(control.refuted for control in found.controls)


def test_the_target_has_to_be_wired() -> None:
    graph = arm2()
    graph["wires"] = {}
    with pytest.raises(WiringError, match=r"inverse\.q_echo: expected an output of that name"):
        _ = dm.load(graph).diagram


def arm2() -> dict[str, Any]:
    return {**sampled_arm2(replay=2, echoed=True), "wires": {"inverse.q_echo": "servo.q_c"}}
