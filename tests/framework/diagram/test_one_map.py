"""One owner of the map of a sample: each user of it follows a change, and its hash covers every field of it."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

import dmframe
from dmframe.analysis import linearise, linearised_period, prove_stability
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Square
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.certify import verify
from dmframe.certify.symbols import exact_values
from dmframe.common.errors import DmframeError
from dmframe.diagram import ClosedLoop, Diagram, Parameter, Variable
from dmframe.diagram.bodies import Bodies
from dmframe.diagram.closed_loop import Noise, Signal
from dmframe.diagram.fingerprint import fingerprint
from dmframe.diagram.pieces import Leaf
from dmframe.diagram.projection import Ball, Box, Projection
from dmframe.drive.rehearse import Condition, rehearsed
from dmframe.export.c import source
from dmframe.export.program import program_of
from dmframe.graph.graph import Graph
from dmframe.page.functions import functions_of
from dmframe.runtime import Controller
from dmframe.simulate import simulate

ROOT = Path(dmframe.__file__).parent
RAW = {"own_rate", "own_next", "own_second"}
RAW_NAME = re.compile("|".join(RAW))
States = ClassVar[tuple[State, ...]]
T = 0.1


def test_no_other_room_reads_what_a_state_moves_by() -> None:
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno} {node.attr}"
        for file in sorted(ROOT.rglob("*.py"))
        if file.parent != ROOT / "diagram" and RAW_NAME.search(text := file.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and node.attr in RAW
    ]
    assert not found
    assert {field.name for field in fields(Variable)} > RAW


def symbol(name: str, size: int = 1) -> ca.SX:
    return ca.SX.sym(name, size)


def every_kind(*, bodies: bool) -> ClosedLoop:
    """Two loops that together contain an instance of each class of a loop."""
    t, period, x, z, w, a = symbol("t"), symbol("T"), symbol("x"), symbol("z", 2), symbol("w"), symbol("a", 10)
    k, box, v, y, n = symbol("k"), symbol("box", 2), symbol("v"), symbol("y"), symbol("n")
    corrections = [symbol("c_1"), symbol("c_2", 2), symbol("c_3", 10)]
    if bodies:
        nominal = Projection("law.a", "law.share", a, -a, corrections[2], Bodies(k * ca.SX.ones(10), k))
        estimate = Variable("law", "a", "p", "", a, -a + corrections[2])
        return ClosedLoop(t, period, (estimate,), (), (), (), (), (), (nominal,), (), ())
    return ClosedLoop(
        time=t,
        period=period,
        controller=(
            Variable("law", "x", "", "rad", x, -k * x + corrections[0], None, True, x / 3),
            Variable("law", "z", "n", "rad", z, 0 * z, z + n),
        ),
        plant=(Variable("arm", "w", "", "m", w, v - w),),
        trajectories=(Leaf("path.g", Side.SOURCE, symbol("g"), ca.sin(t)),),
        ahead=(Leaf("path.g(t + T)", Side.SOURCE, symbol("g_1"), ca.sin(t + period)),),
        noises=(Noise("law.n", n, "normal"),),
        sampled_signals=(Leaf("arm.y", Side.PLANT, y, 2 * w), Leaf("law.v", Side.CONTROLLER, v, -x * y)),
        projections=(
            Projection("law.x", "law.x_box", x, -k * x, corrections[0], Box(box[0], box[1])),
            Projection("law.z", "law.z_ball", z, 0 * z, corrections[1], Ball(ca.vertcat(box), 1 + k, k)),
        ),
        parameters=(
            Parameter("law.k", k, np.array([2.0]), "1/s", (Fraction(2),)),
            Parameter("law.x_box", box, np.zeros((1, 2)), ""),
        ),
        outputs=(Signal("law", "v", "", "m/s", -x * y),),
        paced=frozenset({"path"}),
        led=(("arm.y", "law.x"),),
    )


def parts(item: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Each object in an object, with the path of fields to it."""
    yield way, item
    if is_dataclass(item):
        for field in fields(item):
            yield from parts(getattr(item, field.name), (*way, field.name))
    elif isinstance(item, tuple):
        for place, value in enumerate(item):
            yield from parts(value, (*way, place))


def put(item: Any, way: tuple[Any, ...], value: Any) -> Any:
    """The object with another part."""
    if not way:
        return value
    first, *rest = way
    if isinstance(first, str):
        return replace(item, **{first: put(getattr(item, first), tuple(rest), value)})
    return (*item[:first], put(item[first], tuple(rest), value), *item[first + 1 :])


def otherwise(value: Any) -> Any:
    """Another value of the same kind."""
    match value:
        case ca.SX():
            symbolic = all(element.is_symbolic() for element in ca.vertsplit(ca.vec(value)))
            return ca.SX.sym("other", value.shape) if symbolic else value + 2.0**-1000
        case bool():
            return not value
        case str():
            return value + "_"
        case Side():
            return Side.PLANT if value is not Side.PLANT else Side.SOURCE
        case np.ndarray():
            return np.nextafter(value, np.inf)
        case frozenset():
            return value | {"more"}
        case ():  # of numbers: no other tuple of the loop below is empty
            return (Fraction(1),)
        case tuple():
            return value[:-1]
    raise TypeError(type(value))


def test_each_field_of_the_model_moves_its_hash() -> None:
    seen = set[type]()
    for bodies in (False, True):
        loop = every_kind(bodies=bodies)
        before = fingerprint(loop)
        assert before == fingerprint(every_kind(bodies=bodies))
        for way, item in parts(loop):
            if not is_dataclass(item) or type(item) in seen:
                continue  # one of each kind: a fault of one is a fault of all
            seen.add(type(item))
            for field in fields(item):
                value = getattr(item, field.name)
                if is_dataclass(value):
                    continue  # its own fields are changed
                other = otherwise(ca.SX.sym("there", item.symbol.shape) if value is None else value)
                changed = put(loop, (*way, field.name), other)
                assert fingerprint(changed) != before, (*way, field.name)
    assert seen == {ClosedLoop, Variable, Leaf, Noise, Projection, Box, Ball, Bodies, Parameter, Signal}


def test_the_order_of_states_and_an_unknown_kind_of_field_are_not_passed_over() -> None:
    loop = every_kind(bodies=False)
    assert fingerprint(replace(loop, controller=loop.controller[::-1])) != fingerprint(loop)
    with pytest.raises(TypeError, match="does not support object"):
        fingerprint(replace(loop, paced=object()))  # type: ignore[arg-type]


class Slow(AbstractBlock):
    """a' = y, and the effect of a linear second term on its step in discrete time; v = -a - k y."""

    inputs = (Input("y"),)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("a"),)
    k: Scalar = Positive(default=1.0)
    second: Scalar = Positive(default=1.0)
    there: bool = True

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        second = {"a": p.second * (u.y - x.a)} if self.there else {}
        return Equations({"v": -x.a - p.k * u.y}, {"a": u.y}, second=second)


class Lag(AbstractBlock):
    """y' = v."""

    side = Side.PLANT
    inputs = (Input("v"),)
    outputs = (Output("y", access=Access.MEASURED),)
    states = (State("y"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"y": x.y}, {"y": u.v})


def slow(**options: Any) -> Diagram:
    return Diagram.build({"law": Slow(**options), "lag": Lag()})


def by_hand(period: float, second: float) -> np.ndarray:
    """The map of a sample of (a, y)."""
    c = second * period**2
    return np.array([[1 - c, period + c], [-period, 1 - period]])


@pytest.mark.parametrize("second", [0.5, 30.0, 150.0, 300.0])
def test_an_analysis_is_of_the_map_that_runs_second_terms_included(second: float) -> None:
    diagram, matrix = slow(second=second), by_hand(T, second)
    run = simulate(diagram, 3 * T, clock=T, start={"a": 0.3, "y": -1.0})
    stepped = [np.linalg.matrix_power(matrix, k) @ [0.3, -1.0] for k in range(4)]
    found = np.hstack([run.states["law.a"], run.states["lag.y"]])
    np.testing.assert_allclose(found, stepped[: len(found)], rtol=1e-9)
    linear, radius = linearise(diagram, clock=T), float(np.max(np.abs(np.linalg.eigvals(matrix))))
    assert linear.spectral_radius(T) == pytest.approx(radius, rel=1e-12)
    proof, _ = prove_stability(diagram, linear, linearised_period(linear), T)
    if radius > 1:
        assert proof.radius is None
    else:
        assert proof.radius is not None
        assert radius < proof.radius <= radius + 0.01
    assert proof.period is None or np.max(np.abs(np.linalg.eigvals(by_hand(proof.period, second)))) < 1


def test_second_terms_that_make_a_loop_unstable_are_seen() -> None:
    radii = [float(np.max(np.abs(np.linalg.eigvals(by_hand(T, second))))) for second in (0.5, 300.0)]
    assert radii[0] < 1 < radii[1]  # so that the test above is not trivial


class Halved(AbstractBlock):
    """s+ = s/2, with its own certificate."""

    states = (State("s", sampled=True),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(next={"s": x.s / 2})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.s),), dissipation=(Square(x.s, 0.375),))


def test_a_proof_over_samples_is_of_the_map_of_the_loop() -> None:
    diagram = Diagram.build({"halved": Halved()})
    (state,) = diagram.loop.controller
    assert state.own_next is not None
    other = replace(diagram, loop=replace(diagram.loop, controller=(replace(state, own_next=1.01 * state.own_next),)))
    assert verify(diagram, trials=1).outcome == "proved"
    assert verify(other, trials=1).outcome == "refuted"
    assert other.fingerprint != diagram.fingerprint


def test_exact_numbers_of_a_robot_are_those_of_the_model_or_none() -> None:
    _, diagram = arm2()
    exact = exact_values(diagram)["robot.a_k"]
    (lengths,) = (item for item in diagram.loop.parameters if item.label == "robot.a_k")
    assert exact == lengths.exact == lengths.rational
    longer = replace(lengths, value=2 * lengths.value)
    parameters = tuple(longer if item is lengths else item for item in diagram.loop.parameters)
    other = replace(diagram, loop=replace(diagram.loop, parameters=parameters))
    assert exact_values(other)["robot.a_k"] == tuple(2 * number for number in exact)


@cache
def arm2() -> tuple[Any, Diagram]:
    experiment = Graph.read("arm2_joint", ["duration=0.2 s"])
    return experiment, experiment.diagram


def changed(diagram: Diagram, field: str) -> Diagram:
    """The diagram with each expression of one field of its loop 1 % larger."""
    loop = diagram.loop

    def larger(items: tuple[Any, ...], key: str) -> tuple[Any, ...]:
        return tuple(replace(item, **{key: 1.01 * getattr(item, key)}) for item in items)

    match field:
        case "controller" | "plant":
            other = replace(loop, **{field: larger(getattr(loop, field), "own_rate")})
        case _:
            other = replace(loop, **{field: larger(getattr(loop, field), "expression")})
    return replace(diagram, loop=other)


def holding(graph: Any, diagram: Diagram) -> Any:
    """The graph with another closed loop."""
    other = replace(graph)
    vars(other)["diagram"] = diagram
    return other


def run_by(engine: str) -> Callable[[Any, Diagram], Any]:
    def numbers(experiment: Any, diagram: Diagram) -> Any:
        run = simulate(diagram, 0.2, **{**experiment.settings, "engine": engine})
        return np.hstack([values[-1] for values in run.states.values()])

    return numbers


def stepped(experiment: Any, diagram: Diagram) -> Any:
    controller = Controller(diagram, experiment.file.clock, start=experiment.start, engine="interpreted")
    for values in controller.measured.values():
        values[:] = 0.3
    for k in range(3):
        assert controller.step(k * experiment.file.clock)
    return np.hstack([*controller.states.values(), *controller.commanded.values()])


def shown(experiment: Any, diagram: Diagram) -> Any:
    page = functions_of(diagram, experiment.file.clock, experiment.start, verify(diagram, trials=1))
    rng = np.random.default_rng(0)
    made = (page.parts.sample, page.parts.rate, page.parts.trajectory)
    return [f(*(rng.uniform(0.5, 1, f.size_in(k)) for k in range(f.n_in()))) for f in made]


def linear(experiment: Any, diagram: Diagram) -> Any:
    found = linearise(diagram, clock=experiment.file.clock)
    split = prove_stability(diagram, found, linearised_period(found), experiment.file.clock)[0]
    return found.point, found.A, found.sampled(0.01), split


def driven(experiment: Any, diagram: Diagram) -> Any:
    tried = [Condition("nothing, the ideal robot", {})]
    found = rehearsed(holding(experiment, diagram), seconds=0.2, engine="interpreted", tried=tried)
    return found.field_hash, found.outcomes[0].error


CONSUMERS: dict[str, Callable[[Any, Diagram], Any]] = {
    "interpreted": run_by("interpreted"),
    "compiled": run_by("compiled"),
    "controller": stepped,
    "C": lambda experiment, diagram: source(program_of(holding(experiment, diagram))).split("\n", 1)[1],
    "page": shown,
    "analyse": linear,
    "rehearse": driven,
    "proof": lambda _, diagram: verify(diagram, trials=1).outcome,
}


@cache
def before(consumer: str) -> Any:
    return CONSUMERS[consumer](*arm2())


def differ(one: Any, other: Any) -> bool:
    return repr(one) != repr(other)


@pytest.mark.parametrize("consumer", CONSUMERS)
@pytest.mark.parametrize("field", ["controller", "sampled_signals"])
def test_each_consumer_follows_the_model_or_refuses(consumer: str, field: str) -> None:
    experiment, diagram = arm2()
    other = changed(diagram, field)
    assert other.fingerprint != diagram.fingerprint
    assert not differ(before(consumer), CONSUMERS[consumer](experiment, diagram))  # deterministic, not by chance
    try:
        found = CONSUMERS[consumer](experiment, other)
    except DmframeError:
        return
    assert differ(before(consumer), found)
