"""The sampled law's blocks: against the same law by hand, tick by tick, and what each of their guards is for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from sampled_by_hand import Observer, Plant, SampledLaw, closed_loop, rms
from test_sampled_by_hand import K_D, K_I, K_P, PATH, START, T, ur10

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.catalogue import block_types
from dmframe.config.experiment import load_experiment
from dmframe.diagram import Diagram
from dmframe.port import Port, Side, State
from dmframe.simulate import Recording, simulate
from dmframe_blocks._averaged_servo import averaged_servo

BLOCKS = block_types()
ARM = load_experiment("ur10_slow_sampled").robot
SERVO = averaged_servo(ARM, "pid", frozenset(("viscous", "coulomb")))


class Line(AbstractBlock):
    """Hands on each command some samples late."""

    side: ClassVar[Side] = Side.PLANT
    inputs: ClassVar[tuple[Port, ...]] = (Port("dq_c", "n", "rad/s"),)
    outputs: ClassVar[tuple[Port, ...]] = (Port("dq_late", "n", "rad/s"),)
    states: ClassVar[tuple[State, ...]] = (
        State("first", "n", "rad/s", sampled=True),
        State("second", "n", "rad/s", sampled=True),
    )
    samples: Literal[1, 2] = 1

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        late = x.first if self.samples == 1 else x.second
        return Equations(outputs={"dq_late": late}, next={"first": u.dq_c, "second": x.first})


def run(
    name: str = "ur10_slow_sampled",
    duration: float = 100.0,
    overrides: tuple[str, ...] = (),
    delay: int = 0,
    start: Mapping[str, Any] | None = None,
) -> Recording:
    """A packaged graph, its commands late by a delay that is told to whoever asks for it."""
    if delay:
        told = [part for part in ("task", "inverse") if part == "task" or name != "ur10_slow_kinematic_inverse"]
        overrides = (*overrides, *(f"{part}.delay={delay}" for part in told))
    graph = load_experiment(name, list(overrides))
    blocks, wires = dict(graph.blocks), dict(graph.file.wires)
    if delay:
        blocks["line"], wires["servo.dq_c"] = Line(samples=delay), "line.dq_late"
    diagram = Diagram.build(blocks, wires, graph.robot)
    given = {**graph.start, **(start or {})}
    return simulate(diagram, duration, clock=graph.file.clock, start=given, engine="interpreted")


def error(recorded: Recording) -> np.ndarray:
    return np.asarray(recorded["arm.x"] - recorded["path.x_d"])


def by_hand(law: SampledLaw, ticks: int) -> dict[str, np.ndarray]:
    no_integral = 0 * K_I if not law.pid else K_I
    return closed_loop(law, Plant(law.arm, START, K_D, K_P, no_integral), PATH, ticks)


@pytest.mark.parametrize("filtered", [True, False])
def test_tick_by_tick_it_does_what_the_law_by_hand_does(filtered: bool) -> None:
    ticks = 60
    law = SampledLaw(ur10(), T, tau=2.0 if filtered else None)
    hand = by_hand(law, ticks)
    mine = run(duration=ticks * T, overrides=("task.damping=0", f"inverse.filtered={str(filtered).lower()}"))
    for name, label in (("q", "arm.q"), ("u", "inverse.dq_c"), ("v_des", "task.dq_r"), ("error", None)):
        found = error(mine) if label is None else mine[label]
        np.testing.assert_allclose(found[:ticks], hand[name], atol=1e-8, err_msg=name)
    # the hand keeps what it has learnt at a tick, a state what it had before
    learnt = mine["inverse.theta"][1 : ticks + 1]
    for i, part in enumerate(SERVO.joints):
        used = np.abs(hand["theta"][-1, i]) > 0  # columns of zeros, which the block leaves out, learn nothing
        assert np.sum(used) <= part.stop - part.start
        np.testing.assert_allclose(learnt[-1, part][:3], hand["theta"][-1, i, :3], atol=1e-7)
        np.testing.assert_allclose(learnt[-1, part][-2:], hand["theta"][-1, i, -2:], atol=1e-7)
        np.testing.assert_allclose(np.linalg.norm(learnt[-1, part]), np.linalg.norm(hand["theta"][-1, i]), rtol=1e-6)
    # a law that forgot its last repetition would not pass
    assert np.max(np.abs(hand["u"] - by_hand(type(law)(ur10(), T, tau=law.tau, stored=3), ticks)["u"])) > 1e-4


@pytest.mark.parametrize("delay", [1, 2])
def test_behind_a_delay_it_does_what_the_law_by_hand_does(delay: int) -> None:
    ticks = 60
    hand = by_hand(SampledLaw(ur10(), T, delay=delay), ticks)
    mine = run(duration=ticks * T, overrides=("task.damping=0",), delay=delay)
    np.testing.assert_allclose(mine["line.dq_late"][:ticks], hand["u"], atol=3e-4)  # Newton's steps are not the same
    np.testing.assert_allclose(mine["arm.q"][:ticks], hand["q"], atol=1e-4)
    untold = run(duration=ticks * T, overrides=("task.damping=0",))
    assert np.max(np.abs(untold["arm.q"][:ticks] - hand["q"])) > 3e-3


def test_the_observer_does_what_that_by_hand_does() -> None:
    for delay in (0, 1, 2):
        hand = by_hand(Observer(ur10(), T, delay=delay), 60)
        mine = run("ur10_slow_observer", 60 * T, ("task.damping=0",), delay)
        np.testing.assert_allclose(mine["arm.q"][:60], hand["q"], atol=1e-8)
    assert rms(error(run("ur10_slow_observer"))) == pytest.approx(0.28, abs=0.01)
