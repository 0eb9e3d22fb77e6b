"""Claim files over samples with false statements: each is refused before the test."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import casadi as ca
import pytest
from test_samples import Carts, Learner, Smoother

from dmframe.block import Equations
from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.common.errors import ValueFault
from dmframe.diagram import Diagram
from dmframe.prove.export import from_json, to_json
from dmframe.prove.identity import identity

Change = Callable[[dict[str, Any]], Any]


@cache
def text() -> str:
    blocks = {"learner": Learner(), "carts": Carts(), "smoother": Smoother()}
    return to_json(assembled(claim_of(Diagram.build(blocks))))


def part(found: dict[str, Any], block: str) -> dict[str, Any]:
    return next(item for item in found["parts"] if item["block"] == block)


def steps(found: dict[str, Any]) -> dict[str, Any]:
    own: dict[str, Any] = part(found, "learner")["steps"][0]
    return own


def redirect(found: dict[str, Any], name: str, other: str) -> None:
    """An output has the elements of another one."""
    outputs = {item[0]: item for item in found["program"]["outputs"]}
    outputs[name][4] = outputs[other][4][: len(outputs[name][4])]


def test_the_file_itself_is_read_and_holds() -> None:
    assert identity(from_json(text()), trials=1, seed=0).zero


FALSE: dict[str, tuple[Change, str]] = {
    "V that contains a state without a stated move": (
        lambda f: f.update(stored_states=[]),
        "V depends on smoother.f, which has no rate",
    ),
    "steps from something else than the state": (
        lambda f: redirect(f, "learner.theta: theta", "learner.theta: h0"),
        "expected the state learner.theta",
    ),
    "a delay line from something else than the state": (
        lambda f: redirect(f, "learner.rows: before", "learner.theta: h0"),
        "",
    ),
    "a true value that moves": (
        lambda f: redirect(f, "learner.theta: true", "learner.theta: h0"),
        "V depends on .*, which has no rate",
    ),
    "a gain that moves": (
        lambda f: redirect(f, "learner.theta: gain", "learner.theta: h0"),
        "V depends on .*, which has no rate",
    ),
    "a momentum that a sensor measures": (
        lambda f: next(s for s in f["symbols"] if s["label"] == "carts.v").update(kind="noise"),
        "",
    ),
    "rows beyond the parts": (lambda f: steps(f).update(rows=10**9), "expected 6 parts and 1000000000 rows"),
    "sizes that do not fit": (lambda f: steps(f).update(sizes=[2, 3]), "expected .5. elements, found 4"),
    "a part of no parameters": (lambda f: steps(f).update(sizes=[4, 0]), "expected 6 parts and"),
    "steps that are unknown": (lambda f: steps(f).update(rule="x"), "expected one of normalised, least_squares"),
    "least squares without a memory": (lambda f: steps(f).update(rule="least_squares"), "expected 8 parts"),
    "steps of what is no state": (lambda f: steps(f).update(estimate="gain"), "expected a move of learner.gain"),
    "a box that is a number": (lambda f: steps(f).update(box=1), "expected true or false, found 1"),
    "a line of what is no state": (
        lambda f: part(f, "learner")["lines"][0].update(state="x"),
        "expected a move of learner.x",
    ),
    "a weight over samples": (
        lambda f: part(f, "smoother").update(weight="kappa"),
        "none in discrete time, found kappa",
    ),
    "a flow of samples": (lambda f: f.update(operator="flow"), ""),
    "a move of time": (lambda f: f["moves"].update(t=f["moves"]["learner.count"]), "found one of t"),
    "a plant's move of a parameter": (
        lambda f: f["plant_moves"].update({"learner.gain": next(iter(f["plant_moves"].values()))}),
        "found one of learner.gain",
    ),
}


@pytest.mark.parametrize("fault", FALSE)
def test_a_false_file_over_samples_is_refused(fault: str) -> None:
    change, reports = FALSE[fault]
    found = json.loads(text())
    change(found)
    with pytest.raises(ValueFault, match=f"a claim: .*({reports})"):
        from_json(json.dumps(found))


class Divides(Learner):
    """A state that V does not contain becomes undefined."""

    by: Literal["what is always zero", "infinity"] = "infinity"

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        own, now = Learner.equations(self, u, x, p), x.count
        nothing = (now + 1) * (now - 1) - now * now + 1
        becomes = now / nothing if self.by == "what is always zero" else now + ca.inf
        return Equations(outputs=own.outputs, next={**own.next, "count": becomes})


@pytest.mark.parametrize(
    ("by", "reports"),
    [
        ("what is always zero", "a denominator vanishes at every random point"),
        ("infinity", "expected finite constants, found inf"),
    ],
)
def test_moves_that_are_nowhere_defined_are_no_proof_and_no_traceback(by: Any, reports: str) -> None:
    verdict = verify(Diagram.build({"learner": Divides(by=by), "carts": Carts()}))
    assert verdict.outcome == "not_applicable"
    assert reports in verdict.reason
