"""Nonlinear plants on a clock: slopes over all states, V of two motions at irregular samples, refused operations."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
from dmframe.analysis.held import HeldSlopes, held_slopes
from dmframe.analysis.held_proof import prove_clock
from dmframe.analysis.held_storage import corners, find_storage
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.exact.ball_matrix import middles, radii
from dmframe.exact.balls import UndecidedError
from dmframe.report.clock_text import clock_text
from tests.framework.analysis.test_held import SERVO, largest_equal_period

RUBBING = SERVO.replace("viscous: 5}", "viscous: 5, coulomb: 8}")
"""One joint with a vertical axis and Coulomb friction."""


class Law(AbstractBlock):
    """u = -3 y."""

    inputs = (Input("y"),)
    outputs = (Output("u", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"u": -3 * u.y})


class Bent(AbstractBlock):
    """u = -3 y - sin y."""

    inputs = (Input("y"),)
    outputs = (Output("u", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"u": -3 * u.y - ca.sin(u.y)})


def plant(rate: Any, measured: Any = lambda y: y) -> AbstractBlock:
    """ds/dt = rate(s, u), y = measured(s)."""

    class Plant(AbstractBlock):
        side = Side.PLANT
        inputs = (Input("u"),)
        outputs = (Output("y", access=Access.MEASURED),)
        states: ClassVar[tuple[State, ...]] = (State("s"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y": measured(x.s)}, rates={"s": rate(x.s, u.u)})

    return Plant()


def slopes(rate: Any, law: AbstractBlock | None = None, measured: Any = lambda y: y) -> HeldSlopes:
    return held_slopes(Diagram.build({"law": law or Law(), "plant": plant(rate, measured)}))


@cache
def graph(name: str) -> dm.Graph:
    return dm.load(RUBBING if name == "rubbing" else name)


@pytest.mark.parametrize("name", ["pendulum_kinematic", "rubbing"])
def test_the_enclosure_holds_the_slopes_at_all_states_and_no_more(name: str) -> None:
    found = held_slopes(graph(name).diagram)
    loop, whole, rng = found.loop, found.own, np.random.default_rng(0)
    A = ca.Function("A", [loop.state, loop.p], [found.matrices[0]])
    states = [rng.uniform(-7, 7, loop.state.numel()) * 10.0 ** rng.integers(-4, 1) for _ in range(2000)]
    drawn = [A(state, loop.p_values).full() for state in states]
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    middle, radius = middles(whole.A), radii(whole.A)
    assert (low >= middle - radius - 1e-6).all()
    assert (high <= middle + radius + 1e-6).all()
    (place,) = zip(*np.nonzero(radius > 1e-6), strict=True)  # gravity, or friction
    assert high[place] - low[place] > 1.9 * radius[place]


@pytest.mark.parametrize("name", ["pendulum_kinematic", "rubbing"])
def test_v_of_two_motions_falls_at_irregular_samples(name: str) -> None:
    """Runge-Kutta's method on the equations of the loop, commands held between samples on a moving path."""
    found = held_slopes(graph(name).diagram)
    loop, whole = found.loop, found.own
    storage = find_storage(whole)
    leaves, commands = loop.held_over_a_sample
    labels = [v.label for v in loop.variables]
    kept = [labels.index(state) for state in found.states]
    flow = ca.Function("flow", [stack(v.symbol for v in loop.flowing), leaves, loop.p], [loop.on_path(loop.flow)])
    held = ca.Function("held", [loop.state, loop.time, loop.p], [loop.on_path(loop.acting([commands])[0])])
    rng, K = np.random.default_rng(3), middles(whole.K)
    steps = 400 if name == "rubbing" else 40

    def moved(x: np.ndarray, u: Any, h: float) -> np.ndarray:
        def f(x: np.ndarray) -> np.ndarray:
            return np.asarray(flow(x, u, loop.p_values).full().ravel())

        a = f(x)
        b = f(x + h / 2 * a)
        c = f(x + h / 2 * b)
        return x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c))

    for _ in range(3):
        x, t, before = rng.normal(size=(2, len(labels))), 0.0, np.inf
        for _ in range(4):
            length = storage.interval * (1 - rng.uniform() ** 3)
            u = [held(each, t, loop.p_values) for each in x]
            v = K @ (x[0] - x[1])[kept]
            for k in range(1, steps + 1):
                x = np.array([moved(each, own, length / steps) for each, own in zip(x, u, strict=True)])
                if k % (steps // 8):
                    continue
                d = (x[0] - x[1])[kept]
                e, tau = v - K @ d, length * k / steps
                psi = storage.gamma / np.tan(storage.gamma * tau)
                V = d @ storage.P @ d + (psi - storage.beta) * e @ storage.W @ e
                assert before > V
                before = V
            t += length
            d = (x[0] - x[1])[kept]
            assert d @ storage.P @ d <= before
            before = d @ storage.P @ d


def test_gravity_and_friction_shorten_the_interval() -> None:
    pendulum, light = graph("pendulum_kinematic"), graph("pendulum_kinematic").set({"arm.maker_gravity": 1})
    without = prove_clock(light.diagram, None).interval
    assert without is not None
    assert 0.2 < prove_clock(pendulum.diagram, None).interval < without
    smooth = graph("rubbing").set({"arm.coulomb": 0})
    assert 0.3 < prove_clock(graph("rubbing").diagram, None).interval < prove_clock(smooth.diagram, None).interval


def test_each_corner_is_stable_with_equal_samples_of_the_interval() -> None:
    whole = held_slopes(graph("pendulum_kinematic").diagram).own
    interval = find_storage(whole).interval
    assert all(interval < largest_equal_period(each) for each in corners(whole))


@pytest.mark.parametrize(
    ("rate", "law", "measured", "reason"),
    [
        (lambda y, u: u - ca.sign(y), None, None, "the loop is not smooth: sign of a state or a command switches"),
        (lambda y, u: ca.fmax(u, -1), None, None, "the loop is not smooth: fmax of a state or a command switches"),
        (lambda y, u: u, None, lambda y: ca.floor(8 * y) / 8, "the loop is not smooth: floor of a state"),
        (lambda y, u: u, Bent(), None, "the law is not linear: the slope of law.u depends on plant.s"),
        (lambda y, u: u * (2 + ca.sin(y)), None, None, "the plant's slopes are not bounded: .* depends on law.u"),
    ],
)
def test_another_loop_is_refused_with_the_reason(rate: Any, law: Any, measured: Any, reason: str) -> None:
    with pytest.raises(UndecidedError, match=reason):
        slopes(rate, law, measured or (lambda y: y))


def test_a_slope_without_a_limit_and_an_unstable_one_have_no_interval() -> None:
    with pytest.raises(UndecidedError, match=r"in continuous time it has a pole at .* 1/s among plant\.s"):
        find_storage(slopes(lambda y, u: u - y**3).own)
    with pytest.raises(UndecidedError, match=r"in continuous time it has a pole at 1 1/s among plant\.s"):
        find_storage(slopes(lambda y, u: u + 4 * ca.sin(y)).own)


def test_an_angle_that_more_than_sines_read_is_not_limited_to_a_turn() -> None:
    only = radii(slopes(lambda y, u: u + ca.sin(2 * y)).own.A)[0, 0]
    assert 2 <= only < 2.1
    both = radii(slopes(lambda y, u: u + ca.sin(y) * y).own.A)[0, 0]
    assert both > 1e5


@pytest.mark.parametrize(("name", "bounded"), [("pendulum_kinematic", True), ("pd_torque", False)])
def test_the_text_of_a_nonlinear_plant_has_the_limit_of_its_states(name: str, bounded: bool) -> None:
    loop = dm.load(name)
    text = clock_text(prove_clock(loop.diagram, loop.clock))
    assert ("for all angles, and other states up to 1000000 in their units" in text) == bounded


@pytest.mark.parametrize("far", [1e5, 1e8])
def test_slopes_beyond_the_limit_are_not_seen(far: float) -> None:
    """Near 10^5 the plant is unstable, which is found; near 10^8 it is outside of the statement."""
    diagram = Diagram.build({"law": Law(), "plant": plant(lambda s, u: u + 9 * ca.atan(s - far))})
    assert (prove_clock(diagram, 0.01).interval is None) == (far < 1e6)
