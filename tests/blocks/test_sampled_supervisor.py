"""The supervisor of the sampled law: compared with a hand-written one, and for faults that make the law fail."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from sampled_arm2 import sampled_arm2
from sampled_by_hand import Array, Circle, Known, Observer, Plant, SampledLaw, closed_loop, rms
from test_sampled_by_hand import K_D, K_I, K_P, PATH, START, T, ur10

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Input, Output, Side, State
from dmframe.certify import verify
from dmframe.common.errors import DmframeError, WiringError
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.simulate import Recording, simulate
from dmframe_blocks.sampled_supervisor import SampledSupervisor

KINEMATIC_LATE = 1.6  # [mm] with the kinematic command, the same task law and one sample of delay, after 100 s


class Line(AbstractBlock):
    """Delays each command by some samples, or, at random, by one more."""

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"), Input("toss", drawn="uniform"))
    outputs = (Output("dq_late", "n", "rad/s"),)
    states = (State("line", "n 3", "rad/s", sampled=True),)
    samples: int = 1
    random: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        line = ca.horzcat(u.dq_c, x.line)
        late = line[:, self.samples]
        if self.random:
            late = ca.if_else(u.toss < 0, line[:, self.samples + 1], late)
        return Equations(outputs={"dq_late": late}, next={"line": line[:, :-1]})


class VelocityServo(AbstractBlock):
    """A servo without position control: gravity pulls the robot down."""

    side = Side.PLANT
    inputs = (Input("dq", "n", "rad/s"), Input("dq_c", "n", "rad/s"))
    outputs = (Output("u", "n", "V"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"u": -ca.DM([800, 800, 400]) * (u.dq - u.dq_c)})


def run(
    duration: float, *, assumed: int = 0, line: Line | None = None, servo: AbstractBlock | None = None, seed: int = 0
) -> Recording:
    """The packaged graph, configured for a delay, with a delay line that may have another length."""
    delays = [f"{name}.delay={assumed}" for name in ("task", "inverse", "column", "supervisor")]
    graph = Graph.read("ur10_slow_supervised", delays)
    blocks, wires = dict(graph.blocks), dict(graph.file.wires)
    if servo is not None:
        blocks["servo"] = servo
    if line is not None:
        blocks["line"] = line
        wires |= {"line.dq_c": "supervisor.dq_sent", "servo.dq_c": "line.dq_late"}
    diagram = Diagram.build(blocks, wires, graph.robot)
    return simulate(diagram, duration, clock=T, start=graph.start, engine="interpreted", seed=seed)


def error(recorded: Recording) -> np.ndarray:
    return np.asarray(recorded["arm.x"] - recorded["path.x_d"])


def peak(recorded: Recording) -> float:
    """[mm]."""
    return float(1e3 * np.max(np.linalg.norm(error(recorded), axis=1)))


def last(recorded: Recording, name: str) -> float:
    return float(np.asarray(recorded[name])[-1].item())


class Supervised(SampledLaw):
    """All columns, one column, and neither in parallel: all adapt from the sent commands, one of them sends."""

    def begin(self, q: Array) -> None:
        super().begin(q)
        self.column = Observer(self.arm, self.T, delay=self.delay)
        self.column.begin(q)
        self.chosen, self.rest, self.dwell = 0, 2.0, 2.0
        self.seen = [np.zeros(3)] * 10
        self.scale, self.y, self.v, self.choices = 0.01, np.zeros_like(q), np.zeros_like(q), list[int]()

    def tick(self, k: int, q: Array, path: Circle) -> Array:
        if k > 0:
            u = self.sent.pop(0)
            y, new = u - (q - self.known.q) / self.T, np.zeros(3)
            new[:2] = np.sum(y**2), np.sum((y - self.y) ** 2)
            for law in (self, self.column):
                law.planned.pop(0)
                law.known = law.after(law.known, u, q)
            new[2] = np.sum((self.known.g - np.sum(self.known.h * self.theta, axis=1)) ** 2)
            for law in (self, self.column):
                law.learn(law.known.h, law.known.g, np.abs(u) < self.u_max)
            self.y, self.v, self.seen = y, u - y, [*self.seen, new][-10:]
            self.column.sent = list(self.sent)
        self.choose()
        ends = [self.known, self.known, self.known]
        for law, place in ((self.column, 1), (self, 2)):
            for u, v in zip(self.sent, law.planned, strict=True):
                at: Known = ends[place]
                ends[place] = law.after(at, u, at.q + self.T * law.predict(at, u, v))
        starts = [q + self.delay * self.T * self.v, ends[1].q, ends[2].q]
        t = (k + self.delay) * self.T
        self.v_des = self.goal(starts[self.chosen], path(t), path(t + self.T))
        commands = [self.v_des, self.column.command(ends[1], self.v_des), self.command(ends[2], self.v_des)]
        self.sent.append(commands[self.chosen])
        for law in (self, self.column):
            law.planned.append(self.v_des)
        return self.sent[0]

    def choose(self) -> None:
        """Smallest windowed maximum, hysteresis, trip, and a waiting time that doubles."""
        worst = np.max(self.seen, axis=0)
        if self.chosen and self.seen[-1][self.chosen] > (2 * self.scale) ** 2:
            self.dwell *= 2
            self.rest, self.chosen = self.dwell, 0
        else:
            self.rest -= self.T
        if self.rest > 0:
            self.chosen = 0
        else:
            best = int(np.argmin(worst))
            if worst[best] < 0.7 * worst[self.chosen]:
                self.chosen = best
        if self.chosen == 0:
            self.scale = max(0.01, np.sqrt(worst[0]))
        self.choices.append(self.chosen)


@pytest.mark.parametrize(("assumed", "real"), [(0, 0), (1, 1), (0, 1)])
def test_tick_by_tick_it_equals_one_by_hand(assumed: int, real: int) -> None:
    ticks = 110
    law = Supervised(ur10(), T, delay=assumed, Lambda=3.0)
    plant = Plant(law.arm, START, K_D, K_P, K_I)
    if real > assumed:  # each command reaches the plant a sample later than configured
        advance, waiting = plant.advance, [np.zeros(3)]

        def late(dq_c: Array, T: float) -> Array:
            waiting.append(dq_c)
            return advance(waiting.pop(0), T)

        plant.advance = late  # type: ignore[method-assign]
    hand = closed_loop(law, plant, PATH, ticks)
    mine = run(ticks * T, assumed=assumed, line=Line() if real else None)
    np.testing.assert_array_equal(mine["supervisor.predictor"][:ticks].ravel(), law.choices)
    assert set(law.choices) == ({0, 1} if real > assumed else {0, 1, 2})
    np.testing.assert_allclose(mine["arm.q"][:ticks], hand["q"], atol=2e-5 if assumed or real else 1e-5)
    # both adapt from the command that was sent
    for name in ("inverse", "column"):
        np.testing.assert_array_equal(mine[f"{name}.queue"], mine["supervisor.sent"])
    assert (last(mine, "supervisor.trips") > 0) == (real > assumed)


def test_where_the_law_is_right_the_supervisor_has_no_effect() -> None:
    found = run(100.0)
    assert rms(error(found)) < 0.032
    assert last(found, "supervisor.trips") == 0
    assert last(found, "supervisor.predictor") == 2


def test_a_delay_that_is_not_configured_is_no_worse_than_the_kinematic_command() -> None:
    found = run(100.0, line=Line())
    assert rms(error(found)) < KINEMATIC_LATE
    assert peak(found) < 6
    trips = np.flatnonzero(np.asarray(found["supervisor.tripped"]).ravel())
    assert trips.size >= 3
    assert np.all(T * np.diff(trips) > 4 * 2.0 ** np.arange(trips.size - 1))  # at increasing intervals


def test_a_delay_that_changes_at_random_is_no_worse_than_the_kinematic_command() -> None:
    found = run(100.0, assumed=1, line=Line(random=True))
    assert rms(error(found)) < KINEMATIC_LATE
    assert peak(found) < 6


def test_of_a_servo_without_a_position_the_one_column_takes_care() -> None:
    found = run(40.0, servo=VelocityServo())
    assert rms(error(found)) < 1
    assert last(found, "supervisor.predictor") == 1
    assert peak(found) < 120  # in the two seconds without a selected law


def _stuck(stated: Any) -> Any:
    def equations(self: SampledSupervisor, u: Signals, x: Signals, p: Signals) -> Equations:
        right = stated(self, u, x, p)
        outputs = {**right.outputs, "dq_sent": u.dq_full, "q_start": u.q_full}
        return Equations(outputs=outputs, next={**right.next, "sent": ca.horzcat(x.sent[:, 1:], u.dq_full)})

    return equations


def test_one_that_never_leaves_all_columns_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SampledSupervisor, "equations", _stuck(SampledSupervisor.equations))
    assert peak(run(30.0, line=Line())) > 30  # and growing


def test_switching_leaves_the_proof_as_it_is() -> None:
    found = verify(dm.load(arm2()).diagram)
    assert found.outcome == "proved", found.reason
    assert all(control.refuted for control in found.controls)
    assert found.samples is not None
    assert set(found.samples.silent) == {"task", "column", "supervisor"}


def test_a_supervised_law_requires_the_command_that_is_sent() -> None:
    graph = arm2()
    del graph["blocks"]["supervisor"], graph["blocks"]["column"]
    graph["wires"] = {}
    with pytest.raises(WiringError, match=r"inverse\.dq_sent: expected an output of that name"):
        _ = dm.load(graph).diagram
    graph["blocks"]["inverse"]["supervised"] = False
    _ = dm.load(graph).diagram


def test_reality_replaces_the_command_that_is_sent_and_not_the_one_that_a_predictor_would_send() -> None:
    graph = arm2()
    graph["reality"] = {"transport_delay": {"samples": 1}}
    assert "supervisor.dq_sent through transport_delay" in " ".join(dm.load(graph).run("0.4 s").notices)
    del graph["wires"]["servo.dq_c"]
    with pytest.raises(DmframeError, match=r"transport_delay\.dq_c: expected one output of that name, found 2"):
        _ = dm.load(graph).diagram


def arm2() -> dict[str, Any]:
    graph = sampled_arm2(replay=2, supervised=True)
    graph["blocks"] |= {
        "column": {"type": "disturbance_observer", "supervised": True},
        "supervisor": {"type": "sampled_supervisor", "demand_max": 1},
    }
    graph["wires"] = {
        "supervisor.dq_full": "inverse.dq_c",
        "supervisor.q_full": "inverse.q_start",
        "supervisor.dq_column": "column.dq_c",
        "supervisor.q_column": "column.q_start",
        "task.q_start": "supervisor.q_start",
        "servo.dq_c": "supervisor.dq_sent",
    }
    return graph
