"""Requirements of the projection lemma: the start in the set, a constant true value, and the projection law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from structures import structures

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import SX, Certificate, Square, TrueValue
from dmframe.block.parameter import Around, Diagonal, Positive, Real, Scalar
from dmframe.block.parameter import Ball as Sphere
from dmframe.block.parameter import Box as Range
from dmframe.block.parameter import Interval as Ends
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.closure import Closure
from dmframe.certify.positive import Signs
from dmframe.certify.projection_laws import check_law
from dmframe.certify.projections import projection_conditions
from dmframe.certify.statements import bases_of
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import StartError
from dmframe.diagram import Diagram
from dmframe.diagram.projection import Ball, Box
from dmframe.exact.rational import Interval
from dmframe.graph.graph import Graph
from dmframe.simulate import start_state


class Drift(AbstractBlock):
    """dx = -x + (w - theta); w estimates theta, a parameter of the plant, or a moving signal."""

    side = Side.PLANT
    inputs = (Input("w", "n"),)
    outputs = (Output("x", "n", "", Access.MEASURED), Output("theta", "n"))
    states = (State("x", "n"), State("y", "n"), State("z", "n"))
    theta: Diagonal = Real("n", default=0.5)
    moves: str = "not"

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        theta = {"not": p.theta, "state": p.theta + x.y, "kept": p.theta + x.y + x.z}[self.moves]
        return Equations(
            outputs={"x": x.x, "theta": theta},
            rates={"x": -x.x + u.w - theta, "y": x.x, "z": -x.x},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        theta = self.equations(u, x, p).outputs["theta"]
        return Certificate(
            storage=(Square(x.x, ca.SX(1)),),
            dissipation=(Square(x.x, ca.SX(1)),),
            supply=ca.dot(x.x, u.w - theta),
        )


class Learner(AbstractBlock):
    """dw = -Gamma x, projected onto a box or a ball."""

    inputs = (Input("x", "n"),)
    outputs = (Output("w", "n", "", Access.COMMANDED),)
    states = (State("w", "n", box="w_box", ball="w_ball", gain="Gamma"),)
    truth = (Input("theta", "n"), Input("dtheta", "n", derivative_of="theta"))
    Gamma: Diagonal = Positive("n", default=1.0)
    w_box: Range = Ends("n")
    w_ball: Sphere = Around("n")
    cheats: bool = False
    """The rate is corrected by that of the true value, so that V decreases although the true value moves."""

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        moved = u.x if self.cheats else 0
        return Equations(outputs={"w": x.w}, rates={"w": -p.Gamma * u.x + moved})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        error = x.w - truth.theta
        return Certificate(estimates={"w": TrueValue(truth.theta, 1 / p.Gamma)}, supply=-ca.dot(u.x, error))


class Started(Learner):
    """The same with a start method."""

    w: Diagonal = Real("n", default=0.0)


class Says(Learner):
    """The same, with a stated start: a multiple of the gain, or the plant's x."""

    times: Scalar = Real(default=1.0)
    by_plant: bool = False

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        return {"w": u.x + truth.theta if self.by_plant else p.times * p.Gamma}


def diagram(learner: AbstractBlock, **plant: Any) -> Diagram:
    size = {"theta": [0.5, 0.5]} | plant
    return Diagram.build({"learner": learner, "plant": Drift(**size)})


def failing(verdict: Verdict) -> list[str]:
    return [item.name for item in verdict.conditions if not item.holds]


STARTS = "learner.w: starts inside the {}"


@pytest.mark.parametrize(
    ("learner", "inside"),
    [
        (Started(w=0.3, w_box=[0, 1]), True),
        (Started(w=0, w_box=[0, 1]), True),
        (Started(w=1, w_box=[0, 1]), True),
        (Started(w=[0.3, 1.2], w_box=[0, 1]), False),
        (Started(w=-1e-7, w_box=[0, 1]), False),
        (Started(w=0.1, w_box=[0.1, 0.7]), True),
        (Learner(w_box=[0, 1]), True),
        (Learner(w_box=[0.1, 1]), False),
        (Says(Gamma=0.5, w_box=[0, 1]), True),
        (Says(Gamma=0.5, times=3, w_box=[0, 1]), False),
        (Started(w=0.3, w_ball=[0.5, 1]), True),
        (Started(w=[0.5, 1.5], w_ball=[0.5, 1]), True),
        (Started(w=[0.5, 1.6], w_ball=[0.5, 1]), False),
        (Started(w=[0.5, 1.4], w_ball=[0.5, [2, 0.5]]), False),
    ],
)
def test_what_is_proved_starts_as_a_run_of_it_may(learner: AbstractBlock, inside: bool) -> None:
    """The independent check is `start_state`, which allows a run or not."""
    built = diagram(learner)
    kind = "box" if learner.model_dump()["w_box"] else "ball"
    verdict = verify(built, trials=1)
    assert failing(verdict) == ([] if inside else [STARTS.format(kind)]), verdict.reason
    if inside:
        start_state(built, {})
    else:
        with pytest.raises(StartError):
            start_state(built, {})


@pytest.mark.parametrize("seed", range(8))
def test_random_starts_are_judged_as_a_run_judges_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle, half = np.round(rng.normal(size=2), 3), np.round(rng.uniform(0.1, 1, 2), 3)
    start = np.round(middle + half * rng.uniform(-1.2, 1.2, 2), 3)
    sets = {"w_box": [list(middle - half), list(middle + half)], "w_ball": [list(middle), list(half)]}
    for key, value in sets.items():
        built = diagram(Started(w=list(start), **{key: value}), theta=list(middle))
        checked, _ = conditions(built)
        (found,) = (item.holds for item in checked if "starts inside" in item.name)
        try:
            start_state(built, {})
        except StartError:
            assert not found
        else:
            assert found


def conditions(built: Diagram, start: Mapping[str, Any] | None = None) -> tuple[list[Checked], list[Any]]:
    claim = claim_of(built)
    return projection_conditions(claim, Numbers(claim, {}), start)


def test_the_packaged_arm_with_a_start_outside_its_box_is_not_proved() -> None:
    verdict = verify(Graph.read("arm2_joint", ["inverse.w_I=0"]).diagram, trials=1)
    assert verdict.outcome == "not_applicable"
    assert failing(verdict) == ["inverse.w_I: starts inside the box"]


@pytest.mark.parametrize("key", ["w", "learner.w"])
def test_a_start_that_a_graph_gives_goes_before_the_blocks(key: str) -> None:
    built = diagram(Started(w=0.3, w_box=[0, 1]))
    for value, holds in ((2, False), ([0.1, 0.9], True), ([0.1, 1.1], False)):
        checked, _ = conditions(built, {key: value})
        assert [item.holds for item in checked if "starts inside" in item.name] == [holds]


def test_a_start_that_the_plant_decides_is_listed_as_an_assumption() -> None:
    checked, assumed = conditions(diagram(Says(by_plant=True, w_box=[0, 1])))
    assert not [item for item in checked if "starts inside" in item.name]
    assert [item.text for item in assumed] == [
        "learner.w: starts inside the box, in elements 0, 1 (counted from 0): where the plant starts decides it"
    ]


def test_a_start_over_an_interval_has_to_be_inside_with_all_of_it() -> None:
    class Near(Learner):
        def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
            return {"w": truth.theta}

    built = diagram(Near(w_box=[0, 1]))
    claim = claim_of(built)
    for upper, holds in ((1, True), (2, False)):
        span = [Interval(Fraction(0), Fraction(upper))] * 2
        checked, _ = projection_conditions(claim, Numbers(claim, {"plant.theta": span}))
        assert [item.holds for item in checked if "starts inside" in item.name] == [holds]


STILL = "learner.w: true value stands still"


def test_a_truth_that_moves_is_refused_though_dv_dt_of_the_diagram_vanishes() -> None:
    """The estimator uses the motion of the true value: the identity holds, but the true value leaves the box."""
    built = diagram(Learner(cheats=True, w_box=[0, 1]), moves="state")
    verdict = verify(built, trials=1)
    assert verdict.test is not None
    assert verdict.test.zero
    assert verdict.outcome == "not_applicable"
    assert failing(verdict) == [STILL]
    assert verify(diagram(Learner(cheats=True), moves="state"), trials=1).outcome == "proved"


def test_a_truth_made_of_states_that_is_constant_is_found_to() -> None:
    verdict = verify(diagram(Learner(w_box=[0, 1]), moves="kept"), trials=1)
    assert verdict.outcome == "proved"
    assert STILL in [item.name for item in verdict.conditions]
    assert any("where the plant starts decides it" in item.text for item in verdict.assumptions)


def test_a_truth_that_is_a_number_needs_no_such_condition() -> None:
    verdict = verify(diagram(Learner(w_box=[0, 1])), trials=1)
    assert verdict.outcome == "proved"
    assert STILL not in [item.name for item in verdict.conditions]


def _no_law(kept: Any, state: Any, nominal: Any) -> Any:
    return ca.SX.zeros(nominal.shape)


BOX_LAWS = {
    "never stops": _no_law,
    "stops inside too": lambda box, s, v: -v,
    "stops at the lower end alone": lambda b, s, v: ca.if_else(ca.logic_and(s <= b.lower, v < 0), -v, 0),
    "stops at the upper end alone": lambda b, s, v: ca.if_else(ca.logic_and(s >= b.upper, v > 0), -v, 0),
    "stops what leads in": lambda b, s, v: ca.if_else(
        ca.logic_or(ca.logic_and(s <= b.lower, v > 0), ca.logic_and(s >= b.upper, v < 0)), -v, 0
    ),
    "stops all at the ends": lambda b, s, v: ca.if_else(ca.logic_or(s <= b.lower, s >= b.upper), -v, 0),
    "stops half": lambda b, s, v: Box.law(b, s, v) / 2,
    "pushes out": lambda b, s, v: -Box.law(b, s, v),
    "stops at the middle": lambda b, s, v: Box.law(Box(b.lower, (b.lower + b.upper) / 2), s, v),
    "has swapped ends": lambda b, s, v: Box.law(Box(b.upper, b.lower), s, v),
    "has a branch far out": lambda b, s, v: Box.law(b, s, v) + ca.if_else(s > b.upper + 1e6, 1, 0),
    "is no number": lambda b, s, v: Box.law(b, s, v) * ca.sqrt(b.lower - b.upper - 1),
}
BALL_LAWS = {
    "never stops": _no_law,
    "stops inside too": lambda b, s, v: -v,
    "takes too little": lambda b, s, v: Ball.law(b, s, v) / 2,
    "takes what leads in": lambda b, s, v: Ball.law(b, s, -v),
    "pushes out": lambda b, s, v: -Ball.law(b, s, v),
    "is normal in another metric": lambda b, s, v: Ball.law(Ball(b.center, b.radius, b.gain * ca.SX([1, 3])), s, v),
    "begins at half": lambda b, s, v: Ball.law(Ball(b.center, b.radius / 2, b.gain), s, v),
    "begins at twice": lambda b, s, v: Ball.law(Ball(b.center, b.radius * 2, b.gain), s, v),
    "has another centre": lambda b, s, v: Ball.law(Ball(b.center + b.radius, b.radius, b.gain), s, v),
    "always takes the outward part": lambda b, s, v: Ball.law(Ball(b.center, b.radius * 1e-6, b.gain), s, v),
}
BOX_HELD = {
    "holds nothing": lambda b, s: s,
    "holds the lower end alone": lambda b, s: ca.fmax(s, b.lower),
    "holds the upper end alone": lambda b, s: ca.fmin(s, b.upper),
    "goes to the middle": lambda b, s: (b.lower + b.upper) / 2 + 0 * s,
    "goes to the other end": lambda b, s: ca.if_else(s > b.upper, b.lower, ca.fmax(s, b.lower)),
    "shrinks": lambda b, s: 0.999 * Box.held(b, s) + 0.001 * (b.lower + b.upper) / 2,
}
BALL_HELD = {
    "holds nothing": lambda b, s: s,
    "goes to the centre": lambda b, s: b.center + 0 * s,
    "scales without the root": lambda b, s: b.center + (s - b.center) / ca.fmax(b._reach(s), 1),
    "always goes to the rim": lambda b, s: b.center + (s - b.center) / ca.sqrt(ca.fmax(b._reach(s), 1e-9)),
    "holds a larger ball": lambda b, s: Ball.held(Ball(b.center, b.radius * 1.01, b.gain), s),
}
FAULTS = [
    *(("box", "law", name, fault) for name, fault in BOX_LAWS.items()),
    *(("ball", "law", name, fault) for name, fault in BALL_LAWS.items()),
    *(("box", "held", name, fault) for name, fault in BOX_HELD.items()),
    *(("ball", "held", name, fault) for name, fault in BALL_HELD.items()),
]
SETS: dict[str, Any] = {
    "box": {"w_box": [[-0.2, 0.1], [1, 0.9]]},
    "ball": {"w_ball": [[0.4, 0.6], [1, 0.7]], "Gamma": [0.4, 3]},
}


@pytest.mark.parametrize(("kind", "method", "name", "fault"), FAULTS, ids=[" ".join(item[:3]) for item in FAULTS])
def test_a_fault_in_a_law_takes_the_proof(
    monkeypatch: pytest.MonkeyPatch, kind: str, method: str, name: str, fault: Any
) -> None:
    built = diagram(Started(w=0.5, **SETS[kind]))
    assert verify(built, trials=1).outcome == "proved"
    (projection,) = built.loop.projections
    faulty = type(kind, (type(projection.set),), {method: fault})
    values = {item.name: getattr(projection.set, item.name) for item in fields(projection.set)}
    found = check_law(replace(projection, set=faulty(**values)), built.loop)
    assert not found.holds, found
    monkeypatch.setattr(type(projection.set), method, _once(fault, getattr(type(projection.set), method)))
    verdict = verify(built, trials=1)
    assert (verdict.outcome, failing(verdict)) == ("not_applicable", [f"learner.w: law of the {kind}"])


def _once(fault: Any, true: Any) -> Any:
    """The fault instead of the true method, which it may call."""
    busy = []

    def method(self: Any, *arguments: Any) -> Any:
        if busy:
            return true(self, *arguments)
        busy.append(True)
        try:
            return fault(self, *arguments)
        finally:
            busy.clear()

    return method


@pytest.mark.parametrize("seed", range(10))
def test_the_laws_of_random_sets_obey_the_lemma(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale, far = 10.0 ** rng.integers(-4, 5), 10.0 ** rng.integers(-3, 3)
    middle, half = scale * far * rng.normal(size=2), scale * rng.uniform(0.1, 1, 2)
    gain = 10.0 ** rng.uniform(-3, 3, 2)
    box = {"w_box": [list(middle - half), list(middle + half)]}
    ball = {"w_ball": [list(middle), list(half)]}
    for kept in (box, ball):
        built = diagram(Learner(Gamma=list(gain), **kept))
        found = check_law(built.loop.projections[0], built.loop)
        assert found.holds, (kept, found)


def test_a_box_without_width_is_no_fault() -> None:
    built = diagram(Learner(w_box=[[0, 0.5], [1, 0.5]]))
    assert check_law(built.loop.projections[0], built.loop).holds


def test_every_packaged_projection_is_checked_against_the_lemma() -> None:
    count = 0
    for name in structures():
        loop = Graph.read(name).diagram.loop
        for projection in loop.projections:
            found = check_law(projection, loop)
            assert found.holds, (name, found)
            count += 1
    assert count > 20


@pytest.mark.parametrize("circular", [False, True])
def test_corrections_that_depend_on_one_another_have_no_bound(circular: bool) -> None:
    """|c_a| <= |f + 2 c_b| and |c_b| <= |2 c_a| bound nothing; c_a alone is bounded by f, and c_b by c_a."""
    claim = claim_of(Graph.read("arm2_joint").diagram)
    numbers = Numbers(claim, {})
    a, b, *_ = claim.loop.projections
    symbols = symbols_of(claim)
    closure = Closure(claim, numbers, bases_of(claim, symbols, Signs(claim, numbers)), seed=0)
    first, second = ca.sum1(a.correction), ca.sum1(b.correction)
    nominal = {
        a.name: ca.SX.zeros(a.state.shape) + 2 * second * circular,
        b.name: ca.SX.zeros(b.state.shape) + 2 * first,
    }
    closure.__dict__["_nominal"] = {**closure._nominal, **nominal}
    assert closure.bounds([first, second]) == [not circular] * 2
