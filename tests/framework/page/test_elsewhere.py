"""A page's verdict at numbers moved by its sliders, compared with `verify` of a graph with these numbers."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, final

import casadi as ca
import numpy as np
import pytest
from in_node import answered, content, content_of_graph
from pydantic import model_validator

import dmframe as dm
from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Clipped, Inequality, Square, StableLinear
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.block.terms import clip
from dmframe.certify import Verdict, verify
from dmframe.certify.parameter_margins import parameter_margins
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.exact.ends import enclosing
from dmframe.exact.rational import Interval, evaluate
from dmframe.page.sliders import sliders_of

FILE = "The proof does not apply at these values"


@pytest.fixture(scope="module")
def uncertain() -> Any:
    """A graph with servo parameters in intervals, over which `verify` decides."""
    known = {"servo.K_D": [10, 30], "servo.K_P": [40, 80], "servo.K_I": [10, 40]}
    graph = dm.load("pendulum").set({"uncertain": known})
    return graph, content_of_graph(graph)


def judged(data: Mapping[str, Any], moved: Mapping[str, float], shift: list[float] | None = None) -> dict[str, Any]:
    """The page's verdict with these numbers moved, and its start."""
    p = list(data["p"])
    places = {slider["label"]: slider["at"] for slider in data["sliders"]}
    for label, value in moved.items():
        p[places[label]] = value
    at = [places[label] for label in moved]
    start = bool(shift) or any(place in data["starts"]["reads"] for place in at)
    at += [len(p) + row for row in data["starts"]["rows"]] * start
    said = {"p": bool(moved), "at": at, "start": start, "run": bool(shift)}
    question = {"p": p, "shift": shift, "moved": said}
    (answer,) = answered(dict(data), judged=[question])["answers"]
    found: dict[str, Any] = answer
    return found


def test_over_intervals_a_page_judges_as_verify_does(uncertain: Any) -> None:
    graph, data = uncertain
    for values in ({}, {"inverse.K_c": 0.5}):
        verdict, page = graph.set(values).verify().verdict, judged(data, values)
        assert (page["state"] == "proved") == (verdict.outcome == "proved")
        for row, condition in zip(page["rows"], verdict.conditions, strict=True):
            assert row["holds"] is condition.holds, row["name"]
            if "dominates the cascade's cross term" not in row["name"]:
                assert row["margin"] == pytest.approx(condition.value, rel=1e-9, abs=1e-12), row["name"]
        assert verdict.kappa is not None
        if page["state"] == "proved":
            assert f"any κ above {float(verdict.kappa.least):.3g}" in " ".join(page["sentences"])


def test_a_number_known_up_to_an_interval_stays_in_it(uncertain: Any) -> None:
    _, data = uncertain
    assert judged(data, {"servo.K_D": 12.0})["state"] == "proved"
    out = judged(data, {"servo.K_D": 31.0})
    assert out["headline"] == FILE
    assert "servo.K_D lies in the interval that the graph gives (margin −1)" in out["sentences"][0]


def test_ends_of_an_expression_are_those_of_interval_arithmetic() -> None:
    x, y, z = (ca.SX.sym(name) for name in "xyz")
    made = ca.vertcat(x * x - y / x, (x - 3) * (x - 3) * z, 1 / (y + z), 2 * z - y * y, z / (y + 1), x * z / (z - y))
    made = ca.vertcat(made, 1 + (x - 2) / y, (4 - x) * (1 / y) + x, 5 + (x - 2) * (z / (y * y)))
    box = {"x": (2.0, 4.0), "y": (-1.5, 0.5)}
    ends = enclosing(made, {symbol.element_hash(): box[symbol.name()] for symbol in (x, y)})
    found = np.hstack([side.full() for side in ca.Function("ends", [z], [ends.lower, ends.upper])(0.75)])
    given = [Interval(*map(Fraction, box[name])) for name in "xy"]
    for row in range(made.numel()):
        try:
            f = ca.Function("f", [x, y, z], [made[row]])
            ((wanted,),) = evaluate(f, [[given[0]], [given[1]], [Fraction(0.75)]])
        except ZeroDivisionError:
            assert np.isnan(found[row]).all()
        else:
            assert tuple(found[row]) == pytest.approx((float(wanted.lower), float(wanted.upper)))  # type: ignore[union-attr] # an interval, for its inputs are


@final
class Path(AbstractBlock):
    """A ramp up to a constant value, continuous only where the two are equal."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("r"),)
    end: Scalar = Positive("", "", default=1.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"r": ca.if_else(u.t < 1, u.t, p.end)})


@final
class Toy(AbstractBlock):
    """V contains x - r only; the rest is checked by `verify` in addition to its conditions."""

    inputs = (Input("r"), Input("dr", "", "1/s", derivative_of="r"))
    outputs = ()
    states = (State("x"), State("z"), State("y"))
    k: Scalar = Positive("", "", default=2.0)
    a: Scalar = Positive("", "", default=1.0)
    b: Scalar = Positive("", "", default=2.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(rates={"x": u.dr - (x.x - u.r), "z": -x.z / (p.k - 3), "y": (p.a - p.b) * x.y + x.x})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        e = x.x - u.r
        more = (Inequality("a < 3/2", 1.5 - p.a, "no source"),)
        driven = (StableLinear((x.y,), ((p.a - p.b,),), (x.y,), more),)
        return Certificate((Square(e),), (Square(e),), linear=driven)


def built(**values: float) -> Diagram:
    own = {name: value for name, value in values.items() if name != "end"}
    return Diagram.build({"toy": Toy(**own), "path": Path(end=values.get("end", 1.0))})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"k": 3.0}, "toy: (toy.k-3) is not zero"),
        ({"a": 2.5}, "toy: the linear equation of y is stable"),
        ({"b": 1.5}, ""),
    ],
)
def test_what_verify_looks_at_in_silence_is_judged_where_it_fails(values: dict[str, float], says: str) -> None:
    verdict, other = verify(built()), built(**values)
    assert verdict.outcome == "proved", verdict.reason
    assert (verify(other).outcome == "proved") is (says == "")
    assert failing(verdict, other) == [says] * bool(says)


def failing(verdict: Verdict, other: Diagram) -> list[str]:
    """Implicit checks of a verdict that fail at the numbers of another diagram; no condition fails."""
    claim, names = verdict.claim, list[str]()
    assert claim is not None
    for item in parameter_margins(verdict.conditions, claim, {}):
        if item.margin is not None:
            least = float(ca.mmin(ca.Function("margin", [claim.loop.p], [item.margin])(other.loop.p_values)))
            if not (least > 0 if item.checked.strict else least >= 0):
                names.append(item.checked.name)
                assert item.tacit
    return names


@final
class Pushed(AbstractBlock):
    """y' = -y + clip(y, k - 1)."""

    states = (State("y"),)
    k: Scalar = Positive("", "", default=2.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(rates={"y": -x.y + clip(x.y, p.k - 1)})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        return Certificate((Square(x.y),), (Square(x.y),), residual=(Clipped(x.y, p.k - 1, x.y),))


def test_a_clipped_term_needs_its_width_elsewhere_too() -> None:
    diagram = Diagram.build({"toy": Pushed()})
    verdict, wider, none = verify(diagram), *(with_values(diagram, {"toy.k": k}) for k in (3.0, 0.5))
    assert verdict.outcome == verify(wider).outcome == "proved"
    assert "nothing bounds the residual" in verify(none).reason
    assert failing(verdict, wider) == []
    assert failing(verdict, none) == ["toy: width of the clipped y > 0"]


def test_that_a_path_does_not_jump_was_decided_for_its_own_numbers_alone() -> None:
    verdict, jumping = verify(built()), verify(built(end=1.5))
    assert verdict.outcome == "proved"
    assert jumping.outcome == "not_applicable"
    assert "path.r[0] jumps" in jumping.reason
    (found,) = [item for item in parameter_margins(verdict.conditions, verdict.claim, {}) if item.margin is None]
    assert found.checked.name == "path.r is continuous"
    assert [str(symbol) for symbol in ca.symvar(found.reads)] == ["path.end"]


@final
class Reader(AbstractBlock):
    """x' = -x; its conditions read a number that its equations use as a symbol, and it refuses large values."""

    states = (State("x"),)
    k: Scalar = Positive("", "", default=2.0)
    few: Scalar = Positive("", "", default=2.0)
    numeric: bool = False

    @model_validator(mode="after")
    def _small(self) -> Reader:
        if self.few >= 5:
            raise ValueError("expected few below 5")
        return self

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(rates={"x": -p.few * p.k * x.x})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        return Certificate((Square(x.x),), (Square(x.x, p.few * p.k),))

    def conditions(self, p: Any, truth: Any) -> tuple[Inequality, ...]:
        return (Inequality("k < 3", 3 - (ca.SX(float(self.k)) if self.numeric else p.k), "here"),)


def test_no_claim_reads_a_number_as_such_and_a_slider_reaches_none_that_is_refused() -> None:
    diagram = Diagram.build({"toy": Reader()})
    assert verify(Diagram.build({"toy": Reader(k=4.0)})).outcome == "not_applicable"
    refused = verify(Diagram.build({"toy": Reader(numeric=True)}))
    assert refused.outcome == "not_applicable"
    assert "toy: its methods read the number k from self" in refused.reason
    sliders = {slider.label: slider for slider in sliders_of(diagram, verify(diagram))}
    assert sliders.keys() == {"toy.k", "toy.few"}
    assert 2 * sliders["toy.few"].most < 5
    assert sliders["toy.few"].most > 1.5


def test_a_number_is_written_as_its_block_was_given_it() -> None:
    nothing = Verdict("not_applicable", Text())
    size = dm.load("pendulum").diagram.models["dynamics"].states["a_d_hat"].numel()
    gain = 5 * np.eye(size) + np.arange(size) / 100 + np.arange(size)[:, None] / 100 + 0.01
    for graph, label, expected in (
        (dm.load("pd_torque"), "path.q_d", [0]),
        (dm.load("pd_torque"), "command.K_e", 0),
        (dm.load("pendulum").set({"dynamics.Gamma": gain.tolist()}), "dynamics.Gamma", None),
    ):
        (slider,) = [slider for slider in sliders_of(graph.diagram, nothing) if slider.label == label]
        assert expected is None or slider.written == expected
        p = graph.diagram.loop.p_values[slider.first :]
        again = graph.set({label: _filled(slider.written, p)}).diagram.loop.p_values
        np.testing.assert_array_equal(again, graph.diagram.loop.p_values)


def _filled(places: Any, p: np.ndarray) -> Any:
    if isinstance(places, list):
        return [_filled(inner, p) for inner in places]
    return 0.0 if places is None else float(p[places])


def test_gravity_is_listed_as_known_only_where_it_is() -> None:
    nothing = Verdict("not_applicable", Text())

    def says(name: str) -> dict[str, str]:
        return {slider.label: slider.description for slider in sliders_of(dm.load(name).diagram, nothing)}

    assert says("pd_torque")["robot.gravity"] == "Gravity."
    assert "the controller uses the changed value" in says("pendulum")["robot.gravity"]
    assert "uses" not in says("pendulum")["robot.inertia"]
    assert "the controller uses the changed value" in says("computed_torque")["robot.inertia"]


def test_the_command_of_a_page_holds_the_changes_that_its_graph_has() -> None:
    graph = dm.load("pd_torque").set({"command.K_e": 50})
    assert content_of_graph(graph)["command"]["text"] == "dmframe run pd_torque --set command.K_e=50"
    other = dm.load(graph.text, name="mine")
    assert content_of_graph(other)["command"]["text"] == "dmframe run mine.yaml"


def test_over_intervals_no_text_states_that_a_condition_fails_at_the_numbers(uncertain: Any) -> None:
    graph, data = uncertain
    holds, fails = str(graph.explain()), str(graph.set({"inverse.K_c": 0.5}).explain())
    plain = [" ".join(text.split()) for text in (holds, fails)]
    intervals = "the intervals of servo.K_D, servo.K_P and servo.K_I"
    assert f"conditions hold at the parameter values of this graph and anywhere in {intervals}." in plain[0]
    assert f"conditions fail somewhere in {intervals}" in plain[1]
    assert "at the parameter values of this graph" not in plain[1]
    assert "anywhere in the intervals of servo.K_D" in " ".join(judged(data, {})["sentences"])


def test_a_margin_that_rounding_may_have_turned_is_not_decided() -> None:
    """20.3 K_c + K_P - K_I / K_c is zero exactly, and -9e-16 in floating-point numbers; one step further it is not."""
    edge, beyond = ({"inverse.K_c": 0.3, "servo.K_P": 0.5, "servo.K_I": K_I} for K_I in (1.977, 1.97701))
    at, past = (judged(content("pendulum"), values) for values in (edge, beyond))
    assert (at["state"], past["state"]) == ("undecided", "fails")
    assert "are too close to zero for this page: inverse: M̄ ≥ 0" in " ".join(at["sentences"])


@pytest.mark.parametrize("nominal", [1.1, 7.64])
def test_a_number_that_moves_a_start_out_of_its_box_takes_the_proof_away(nominal: float) -> None:
    """An initial value that is a fraction of the true one changes with it, although no start was moved separately."""
    graph = dm.load("torque_direct_pid")
    page, verdict = (
        judged(content("torque_direct_pid"), {"model.nominal": nominal}),
        graph.set({"model.nominal": nominal}),
    )
    assert (page["state"] == "proved") is verdict.verify().proved is (nominal < 2)


def test_a_load_beyond_the_box_of_its_estimate_is_not_green() -> None:
    data = content("ur10_payload")
    masses = next(slider for slider in data["sliders"] if slider["label"] == "load.mass")
    p = [4 * value if 0 <= k - masses["at"] < masses["size"] else value for k, value in enumerate(data["p"])]
    at = list(range(masses["at"], masses["at"] + masses["size"]))
    (answer,) = answered(dict(data), judged=[{"p": p, "moved": {"p": True, "at": at, "run": False}}])["answers"]
    assert answer["state"] in ("fails", "undecided")
    assert not dm.load("ur10_payload").set({"load.mass": [1.2, 17.2, 1.2]}).verify().proved


def test_what_the_files_start_decided_is_open_where_the_start_has_moved() -> None:
    known = {"how": "exact", "value": 1.0, "holds": True, "strict": True, "opens": False}
    row = {"name": "starts inside", "at": None, "size": None, "reads": [2], **known}
    verdict = {"outcome": "proved", "headline": "proved", "reason": "the identity", "kappa": None, "conclusions": []}
    data = {"verdict": {**verdict, "conditions": [row]}, "clock": None}
    moves = [{"p": False, "start": True, "at": at, "run": True} for at in ([2], [3])]
    (moved, other) = answered(data, judged=[{"margins": [], "moved": move} for move in moves])["answers"]
    assert (moved["state"], other["state"]) == ("undecided", "proved")


@pytest.mark.parametrize("shift", [[0.5, -0.5], [0.1, 0.1]])
def test_a_start_that_was_moved_is_judged_as_verify_judges_it(shift: list[float]) -> None:
    graph, data = dm.load("torque_direct_pid"), content("torque_direct_pid")
    pose = data["pose"]
    first = data["state"][pose["at"] : pose["at"] + pose["size"]]
    start = [a + b for a, b in zip(first, shift, strict=True)]
    page = judged(data, {}, shift)
    assert (page["state"] == "proved") <= graph.set({"start.q": start}).verify().proved
