"""Over intervals no decision uses the graph's own values: "proved" then means that each single graph is proved."""

from __future__ import annotations

import ast
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, final

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Inequality, Square, StableLinear
from dmframe.block.model import SYMBOLIC
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import TIME, Input, Output, Side, State
from dmframe.certify import Verdict, verify
from dmframe.certify.over import NEEDED
from dmframe.certify.parameter_margins import parameter_margins
from dmframe.diagram import Diagram
from dmframe.exact.rational import Interval

CERTIFY = Path(dm.__file__).parent / "certify"


def over(*pairs: tuple[str, str]) -> list[Interval]:
    return [Interval(Fraction(low), Fraction(high)) for low, high in pairs]


@final
class Stepping(AbstractBlock):
    """A ramp with a jump by a parameter that is zero in a graph; another part jumps above two."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("r"),)
    jump: Scalar = Real("", "", default=0.0)
    late: Scalar = Real("", "", default=1.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        late = ca.if_else(p.late > 2, 1, 0) * ca.if_else(u.t > 3, 1, 0)
        return Equations(outputs={"r": u.t + p.jump * ca.if_else(u.t < 1, 0, 1) + late})


@final
class Follower(AbstractBlock):
    """V holds x - r; y is bounded where a and b agree, or where a is small."""

    inputs = (Input("r"), Input("dr", "", "1/s", derivative_of="r"))
    outputs = ()
    states = (State("x"), State("w"), State("y"))
    a: Scalar = Positive("", "", default=2.0)
    b: Scalar = Positive("", "", default=2.0)
    k: Scalar = Positive("", "", default=1.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        rates = {"x": u.dr - p.k * (x.x - u.r), "w": ca.SX(1), "y": -x.y + (p.a - p.b) * x.w}
        return Equations(rates=rates)

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        e = x.x - u.r
        more = (Inequality("a < 1", 1 - p.a, "test"),)
        weight = p.k * p.k - 2 * p.k + 2
        driven = (StableLinear((x.y,), ((-1,),), (x.y,), more),)
        return Certificate((Square(e, weight),), (Square(e, weight * p.k),), linear=driven)

    def start(self, u: Any, p: Any, truth: Any) -> dict[str, Any]:
        return {"x": ca.SX(0)}


def built(**values: float) -> Diagram:
    own = {name: values[name] for name in ("a", "b", "k") if name in values}
    path = {name: values[name] for name in ("jump", "late") if name in values}
    return Diagram.build({"toy": Follower(**own), "path": Stepping(**path)})


@cache
def own() -> Verdict:
    """Items that are proved at the graph's own values."""
    return verify(built(), trials=1)


@pytest.mark.parametrize(
    ("label", "interval", "holds"),
    [
        ("path.jump", ("-1", "1"), False),  # zero in the graph: a factor would keep it zero
        ("path.late", ("1", "3"), False),  # only a parameter switches a jump on
        ("toy.b", ("1", "3"), False),  # equal to a in the graph alone
        ("toy.k", ("1/2", "3"), True),  # k^2 - 2 k + 2 is at least one, which interval arithmetic does not show
        ("toy.k", ("9/10", "11/10"), True),
    ],
)
def test_what_depends_on_an_interval_is_decided_over_it_or_not_at_all(
    label: str, interval: tuple[str, str], holds: bool
) -> None:
    assert own().outcome == "proved", own().reason
    found = verify(built(), trials=1, uncertain={label: over(interval)})
    low, high = (float(Fraction(end)) for end in interval)
    singles = [
        verify(built(**{label.partition(".")[2]: value}), trials=1).outcome
        for value in np.random.default_rng(0).uniform(low, high, 3)
    ]
    assert (set(singles) == {"proved"}) is holds
    if not holds:
        assert found.outcome == "not_applicable"
        assert NEEDED in found.reason or "toy: a < 1" in found.reason
    elif found.outcome != "proved":
        assert all(item.how == "undecided" for item in found.conditions if not item.holds), "it fails nowhere"


def test_an_interval_that_is_too_wide_for_its_arithmetic_is_not_decided_and_does_not_fail() -> None:
    wide = verify(built(), uncertain={"toy.k": over(("1/2", "3"))})
    narrow = verify(built(), uncertain={"toy.k": over(("9/10", "11/10"))})
    assert narrow.outcome == "proved", narrow.reason
    assert wide.outcome == "not_applicable"
    assert "is not decided over the intervals" in wide.reason
    assert "fails" not in wide.reason


def camera(low: str, high: str) -> Verdict:
    graph = dm.load("ur10_camera")
    own = graph.diagram.models["camera"].values["position"]
    pairs = [(str(x + float(Fraction(low))), str(x + float(Fraction(high)))) for x in own]
    with SYMBOLIC:
        return verify(graph.diagram, uncertain={"camera.position": over(*pairs)}, start=graph.start)


def test_a_weight_that_is_stated_positive_is_checked_over_the_whole_interval() -> None:
    near, far = camera("-0.05", "0.05"), camera("-3", "3")
    assert near.outcome == "proved", near.reason
    assert far.outcome == "not_applicable"
    assert "is above zero at the start" in far.reason


def test_a_start_may_lie_in_an_interval() -> None:
    graph = dm.load("arm2_joint")
    size = graph.diagram.models["dynamics"].states["a_d_hat"].numel()
    for reach, outcome in (("1/1000", "proved"), ("100", "not_applicable")):
        given = over(*[(f"-{reach}", reach)] * size)
        found = verify(graph.diagram, uncertain={"start.dynamics.a_d_hat": given}, start={})
        assert found.outcome == outcome, found.reason


def test_a_page_checks_a_moved_start_as_verify_checks_a_graph_with_it() -> None:
    graph = dm.load("arm2_joint")
    label, verdict = "dynamics.a_d_hat", graph.verify().verdict
    claim = verdict.claim
    assert claim is not None
    symbol = claim.starts[label]
    moved = parameter_margins(verdict.conditions, claim, {}, {label})
    for value in (0.0, 50.0):
        worst = 1.0
        for item in moved:
            if item.margin is not None and ca.depends_on(item.margin, symbol):
                function = ca.Function("margin", [claim.loop.p, symbol], [item.margin])
                worst = min(worst, float(ca.mmin(function(claim.loop.p_values, [value] * symbol.numel()))))
        single = verify(graph.diagram, start={"a_d_hat": [value] * symbol.numel()})
        assert (worst >= 0) is (single.outcome == "proved"), single.reason


def unlisted(verdict: Verdict) -> list[str]:
    """Conditions that hold, without a margin and without the parameters on which they depend."""
    return [item.name for item in verdict.conditions if item.holds and item.margin is None and item.reads is None]


@pytest.mark.parametrize("graph", ["arm2_joint", "pendulum", "ur10_camera", "ur10_fast_sampled"])
def test_every_condition_that_holds_has_a_margin_or_a_list_of_what_it_reads(graph: str) -> None:
    verdict = dm.load(graph).verify().verdict
    assert verdict.conditions
    assert unlisted(verdict) == []
    claim = verdict.claim
    for item in parameter_margins(verdict.conditions, claim, {}):
        assert item.margin is not None or item.reads is not None, item.checked.name


def constructions(source: str) -> list[str]:
    """Each `Checked(...)` of a module that may hold and has neither a margin nor a list, with its line."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Checked":
            fails = len(node.args) > 3 and isinstance(node.args[3], ast.Constant) and node.args[3].value is False
            listed = {word.arg for word in node.keywords} & {"margin", "reads"} or len(node.args) > 7
            if not fails and not listed:
                found.append(f"line {node.lineno}: {ast.unparse(node)[:80]}")
    return found


def test_no_condition_of_the_proof_is_made_without_a_margin_or_a_list() -> None:
    faults = {path.name: constructions(path.read_text(encoding="utf-8")) for path in sorted(CERTIFY.glob("*.py"))}
    assert {name: found for name, found in faults.items() if found} == {}


def test_the_lint_reports_a_condition_without_either() -> None:
    assert constructions('Checked("a", "b", None, holds, "c")')
    assert constructions('Checked("a", "b", 1.0, True, "c", how="exact")')
    assert not constructions('Checked("a", "b", None, False, "c")')
    assert not constructions('Checked("a", "b", 1.0, holds, "c", reads=read)')


@pytest.mark.parametrize(("low", "holds"), [("1.5", True), ("3", False)])
def test_an_estimate_has_to_start_inside_every_box_of_an_interval(low: str, holds: bool) -> None:
    """It starts at 2 inside the graph's own box, and the true value is 4: lower ends up to 3 exclude the start."""
    graph = dm.load("arm2_joint")
    ends = over(("0.5", low), ("0.5", low), ("20", "20"), ("20", "20"))
    found = verify(graph.diagram, trials=1, uncertain={"inverse.w_I_box": ends}, start=graph.start)
    assert (found.outcome == "proved") is holds
    assert ("inverse.w_I: starts inside the box" in found.reason) is not holds
