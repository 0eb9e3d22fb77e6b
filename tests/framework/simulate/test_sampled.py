"""Sampled states, the period, random numbers and jitter: compared with recursions by hand and python-control."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest

from dmframe.analysis import linearise
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate
from dmframe.block.parameter import Box, Interval, Real, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.certify import verify
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.results.claimed import unproved_along
from dmframe.runtime import Controller
from dmframe.simulate import Solver, simulate, simulate_many
from dmframe.simulate.instants import DRAWN, LENGTH, TIME, Instants

States = ClassVar[tuple[State, ...]]

T = 0.05


class SampledPi(AbstractBlock):
    """v = -2 y - i, i+ = i + T y: in discrete time."""

    inputs = (Input("y_m"), PERIOD)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("i", sampled=True, box="i_box"),)
    i: Scalar = Real(default=0.3)
    i_box: Box = Interval()

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -2 * u.y_m - x.i}, next={"i": x.i + u.T * u.y_m})


class Emulated(AbstractBlock):
    """The same law, with its integral in continuous time."""

    inputs = (Input("y_m"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("i"),)
    i: Scalar = Real(default=0.3)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -2 * u.y_m - x.i}, rates={"i": u.y_m})


class Delay(AbstractBlock):
    """Outputs the command of the previous sample."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("v_late"),)
    states = (State("late", sampled=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v_late": x.late}, next={"late": u.v})


class Cart(AbstractBlock):
    """dy = v_late - y/2."""

    side = Side.PLANT
    inputs = (Input("v_late"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)
    y: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": u.v_late - x.y / 2})


class Sensor(AbstractBlock):
    """y_m = y + noise n + 0.1 r."""

    side = Side.PLANT
    inputs = (Input("y"), Input("n", drawn="normal"), Input("r", drawn="uniform"))
    outputs = (Output("y_m", access=Access.MEASURED),)
    noise: Scalar = Real(default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_m": u.y + p.noise * (u.n + u.r / 10)})


def loop(law: AbstractBlock | None = None, noise: float = 0.0) -> Diagram:
    blocks = {"law": law or SampledPi(), "delay": Delay(), "cart": Cart(), "sensor": Sensor(noise=noise)}
    return Diagram.build(blocks)


ENGINES = ("interpreted", "compiled")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sampled_law_and_a_delay_in_the_plant_move_as_in_python_control(engine: Any) -> None:
    import control

    run = simulate(loop(), 2.0, clock=T, solver=Solver(step=T / 10), engine=engine)
    cart = control.c2d(control.ss([[-0.5]], [[1.0]], [[1.0]], [[0.0]]), T, "zoh")
    # states (i, late, y): the law's integral, the command of the previous sample, the cart
    A = np.array([[1, 0, T], [-1, 0, -2], [0, cart.B[0, 0], cart.A[0, 0]]])
    x, found = np.array([0.3, 0.0, 1.0]), []
    for _ in run.time:
        found.append(x)
        x = A @ x
    i, late, y = np.array(found).T
    np.testing.assert_allclose(run["law.i"].ravel(), i, atol=1e-9)
    np.testing.assert_allclose(run["delay.late"].ravel(), late, atol=1e-9)
    np.testing.assert_allclose(run["cart.y"].ravel(), y, atol=1e-9)


def test_a_state_in_continuous_time_is_emulated_by_the_step_that_the_sampled_law_states() -> None:
    sampled, emulated = (simulate(loop(law), 2.0, clock=T) for law in (SampledPi(), Emulated()))
    assert np.array_equal(sampled["law.i"], emulated["law.i"])
    assert np.array_equal(sampled["cart.y"], emulated["cart.y"])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sampled_state_stays_in_its_box(engine: Any) -> None:
    run = simulate(loop(SampledPi(i_box=[0.0, 0.32])), 2.0, clock=T, engine=engine)
    free = simulate(loop(), 2.0, clock=T)
    assert np.max(run["law.i"]) == 0.32 < np.max(free["law.i"])


def test_the_same_seed_draws_the_same_numbers_on_both_engines_and_in_every_batch() -> None:
    first, second = (simulate(loop(noise=0.1), 30.0, clock=T, engine=engine, seed=7) for engine in ENGINES)
    np.testing.assert_allclose(first["sensor.y_m"], second["sensor.y_m"], atol=1e-12)
    (batch,) = simulate_many(loop(), [{"sensor.noise": 0.1}], 30.0, clock=T, engine="compiled", seed=7)
    assert np.array_equal(batch["sensor.y_m"], second["sensor.y_m"])  # type: ignore[index, unused-ignore]
    other = simulate(loop(noise=0.1), 30.0, clock=T, seed=8)
    assert not np.allclose(other["sensor.y_m"], first["sensor.y_m"])


def test_what_is_drawn_has_the_moments_of_its_distribution_and_no_memory() -> None:
    drawn = Instants(1.0, ("normal", "uniform"), 3).rows(0, 200_000)[:, DRAWN:]
    assert np.allclose(drawn.mean(axis=0), 0, atol=0.01)
    assert np.allclose(drawn.var(axis=0), [1, 1 / 3], atol=0.01)
    assert np.max(np.abs(drawn[:, 1])) <= 1
    assert np.max(np.abs(np.corrcoef(np.column_stack([drawn[1:], drawn[:-1]]).T) - np.eye(4))) < 0.01


def test_ticks_can_be_had_in_any_portions() -> None:
    instants = Instants(0.01, ("normal",), 5, jitter=0.002)
    whole = instants.rows(0, 3000)
    parts = [instants.rows(first, count) for first, count in ((0, 1), (1, 1022), (1023, 2), (1025, 1975))]
    assert np.array_equal(whole, np.concatenate(parts))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("method", ["rk4", "cvodes"])
def test_jitter_makes_ticks_of_several_lengths(engine: Any, method: Any) -> None:
    solver = Solver(method, step=T / 10)
    run = simulate(loop(), 2.0, clock=T, solver=solver, engine=engine, seed=1, jitter=0.02)
    given = Instants(T, ("normal", "uniform"), 1, 0.02).rows(0, 41)
    assert np.array_equal(run.time, given[:, TIME])
    assert np.max(np.abs(run.time - T * np.arange(41))) > 0.01
    np.testing.assert_allclose(np.diff(run.time), given[:-1, LENGTH])
    late, y = run["delay.late"].ravel(), run["cart.y"].ravel()
    fade = np.exp(-given[:-1, LENGTH] / 2)
    np.testing.assert_allclose(y[1:], fade * y[:-1] + 2 * (1 - fade) * late[:-1], atol=1e-7)
    np.testing.assert_allclose(np.diff(run["law.i"].ravel()), T * run["sensor.y_m"].ravel()[:-1], atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_controller_with_sampled_states_steps_as_the_simulation_does(engine: Any) -> None:
    run = simulate(loop(), 1.0, clock=T)
    step = Controller(loop(), T, engine=engine)
    for k, t in enumerate(run.time):
        step.measured["sensor.y_m"][:] = run["sensor.y_m"][k]
        assert step.states["law.i"][0] == pytest.approx(run["law.i"][k, 0], abs=1e-14)
        assert step.step(t)
        assert step.commanded["law.v"][0] == pytest.approx(run["law.v"][k, 0], abs=1e-14)


def test_a_block_at_numbers_gives_its_next_values() -> None:
    found = SampledPi().evaluate({"y_m": 2.0, "T": 0.5}, {"i": 1.0})
    assert found.next == {"i": 2.0}
    assert found.rates == {}


class Wrong(SampledPi):
    """States a rate although it declares a sampled state."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -u.y_m}, rates={"i": u.y_m})


class WrongToo(Emulated):
    """States a next value although it declares a state in continuous time."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -u.y_m}, next={"i": u.y_m})


class Drawing(Emulated):
    """Draws an input from an invalid distribution; an `Output` has no such field."""

    inputs = (Input("y_m"), Input("n", drawn="norml"))
    outputs = (Output("v", access=Access.COMMANDED),)


class Restless(AbstractBlock):
    """Moves without memory, differently at each evaluation."""

    inputs = (Input("y_m"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("z", sampled=True),)
    calls: ClassVar[list[int]] = []

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        self.calls.append(1)
        return Equations(outputs={"v": x.z}, next={"z": u.y_m * len(self.calls)})


class Differentiating(AbstractBlock):
    """Requires the derivative of a noisy measurement, and of a sampled state."""

    side = Side.PLANT
    inputs = (Input("v_late"), Input("dv_late", derivative_of="v_late"))
    outputs = (Output("y", access=Access.MEASURED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": u.dv_late})


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (
            Wrong,
            "law: equations state the rate of i, which is a sampled state; state its next value, or declare it without",
        ),
        (WrongToo, "law: equations state the next value of i, which is a continuous state; state its rate, or"),
        (Drawing, "law: the input n is drawn from norml, unknown; did you mean normal?"),
        (Restless, "law: equations() state another next value of z when evaluated again"),
    ],
)
def test_a_blocks_source_of_time_is_checked_against_its_declaration(law: Any, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        loop(law())
    assert text in str(caught.value)


def test_a_jump_has_no_derivative() -> None:
    with pytest.raises(DmframeError) as caught:
        Diagram.build({"law": SampledPi(), "delay": Delay(), "cart": Differentiating(), "sensor": Sensor()})
    assert "cart.dv_late is a time derivative of a signal that depends on delay.late, which is piecewise" in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "clock: expected a sampling period such as 8 ms, found continuous; law.i is a sampled state"),
        ({"clock": T, "jitter": T / 2}, "jitter: expected a time from 0 to less than half of the period, 25 ms, found"),
        ({"clock": T, "jitter": float("nan")}, "jitter: expected a time from 0 to less than half"),
        ({"clock": T, "seed": -1}, "seed: expected a whole number from 0 to 2^64 - 1, found -1"),
        ({"clock": T, "seed": 1.5}, "seed: expected a whole number from 0 to 2^64 - 1, found 1.5"),
    ],
)
def test_what_cannot_be_sampled_is_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        simulate(loop(), 1.0, **options)
    assert text in str(caught.value)


def test_jitter_requires_a_clock() -> None:
    plant = Diagram.build({"law": Emulated(), "delay": Straight(), "cart": Cart(), "sensor": Exact()})
    assert simulate(plant, 1.0).divergence is None
    with pytest.raises(DmframeError, match="found continuous; samples have a jitter"):
        simulate(plant, 1.0, jitter=0.001)


class Straight(AbstractBlock):
    """No delay."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("v_late"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v_late": u.v})


class Exact(AbstractBlock):
    """No noise."""

    side = Side.PLANT
    inputs = (Input("y"),)
    outputs = (Output("y_m", access=Access.MEASURED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_m": u.y})


def test_proofs_and_analyses_in_continuous_time_state_that_they_do_not_reach_it() -> None:
    verdict = verify(loop())
    assert verdict.outcome == "not_applicable"
    assert "law.i is a sampled state; a proof in continuous time does not reach it" in verdict.reason
    with pytest.raises(DmframeError, match=r"expected a clock, found none; law\.i is a sampled state"):
        linearise(loop())


class LateCommand(AbstractBlock):
    """The velocity command of the previous sample; it declares no storage."""

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_late", "n", "rad/s"),)
    states = (State("held", "n", "rad/s", sampled=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"dq_late": x.held}, next={"held": u.dq_c})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate()


def test_a_proved_loop_with_a_delay_in_it_is_neither_proved_nor_drawn_with_v() -> None:
    graph = Graph.read("arm2_joint")
    late = Diagram.build({**graph.blocks, "line": LateCommand()}, {"servo.dq_c": "line.dq_late"}, graph.robot)
    run = simulate(late, 0.1, clock=0.002)
    assert unproved_along(run, {}, {}) is None
    assert verify(late).reason.startswith("line.held is a sampled state")
    straight = graph.diagram
    assert unproved_along(simulate(straight, 0.1, clock=0.002), {}, {}) is not None
    assert not np.allclose(run["arm.q"], simulate(straight, 0.1, clock=0.002)["arm.q"], atol=1e-9)


def test_a_controller_that_draws_is_refused() -> None:
    class Probing(SampledPi):
        inputs = (Input("y_m"), PERIOD, Input("n", drawn="normal"))

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"v": u.n}, next={"i": x.i})

    with pytest.raises(DmframeError, match=r"controller: law\.n is random at each sample"):
        Controller(loop(Probing()), T)


def test_the_fingerprint_distinguishes_a_sampled_state_from_one_in_continuous_time() -> None:
    class Holding(AbstractBlock):
        inputs = (Input("y_m"),)
        outputs = (Output("v", access=Access.COMMANDED),)
        states = (State("i", sampled=True),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"v": -2 * u.y_m - x.i}, next={"i": u.y_m})

    assert loop(Holding()).fingerprint != loop(Emulated(i=0.0)).fingerprint


def test_a_block_may_start_at_what_it_measures_with_noise_and_reads_nowhere_else() -> None:
    class Filter(AbstractBlock):
        inputs = (Input("y_m"), PERIOD)
        outputs = (Output("v", access=Access.COMMANDED),)
        states = (State("z", sampled=True), State("T_0"))

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"v": -x.z}, rates={"T_0": 0 * x.z}, next={"z": x.z})

        def start(self, u: Signals, p: Signals, truth: Signals) -> dict[str, Any]:
            return {"z": u.y_m, "T_0": u.T}

    run = simulate(loop(Filter(), noise=0.1), 1.0, clock=T, seed=5)
    first = Instants(T, ("normal", "uniform"), 5).rows(0, 1)[0, DRAWN:]
    assert run["law.z"][0, 0] == pytest.approx(1 + 0.1 * (first[0] + first[1] / 10))
    assert run["law.T_0"][0, 0] == T


def test_what_is_made_of_draws_alone_is_recorded() -> None:
    class Dice(Sensor):
        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y_m": u.n})

    blocks = {"law": SampledPi(), "delay": Delay(), "cart": Cart(), "sensor": Dice()}
    run = simulate(Diagram.build(blocks), 1.0, clock=T, seed=5)
    drawn = Instants(T, ("normal", "uniform"), 5).rows(0, run.time.size)[:, DRAWN]
    assert np.array_equal(run["sensor.y_m"].ravel(), drawn)


def test_an_output_that_is_not_the_state_of_its_name_is_refused() -> None:
    class Offset(Cart):
        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y": x.y + 1}, rates={"y": u.v_late})

    with pytest.raises(DmframeError, match="cart: its output y differs from its state y, and both have the same name"):
        Diagram.build({"law": SampledPi(), "delay": Delay(), "cart": Offset(), "sensor": Sensor()})
