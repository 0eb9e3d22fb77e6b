"""Conditions for the proof of a projection onto consistent parameters, and false statements that are refuted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import Input, Output, State
from dmframe.certify import claim_of, verify
from dmframe.certify.checked import Numbers
from dmframe.certify.projection_laws import check_law
from dmframe.certify.projections import projection_conditions
from dmframe.common.eigen import eigen, positive_part
from dmframe.common.errors import DmframeError, StartError
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import ClosedLoop
from dmframe.diagram.projection import Bodies, Projection
from dmframe.graph.graph import Graph
from dmframe.simulate import start_state

LAW = "dynamics.a_d_hat: law of the set of bodies"


def changed(**values: Any) -> Graph:
    dynamics = {"type": "consistent_compensator", "c": 2, "Gamma": 5, "floor": 0.3}
    graph = dm.load("pendulum").set({"model.nominal": 0.5, "blocks.dynamics": dynamics})
    return graph.set(values) if values else graph


@cache
def projected() -> tuple[ClosedLoop, Projection]:
    loop = changed().diagram.loop
    (projection,) = (item for item in loop.projections if item.block == "dynamics")
    assert check_law(projection, loop).holds
    return loop, projection


def failing(**values: Any) -> list[str]:
    """The conditions of the projection that fail."""
    claim = claim_of(changed(**values).diagram)
    checked, _ = projection_conditions(claim, Numbers(claim, {}))
    return [item.name for item in checked if not item.holds]


def test_it_is_proved_and_stated_to_stay_bodies() -> None:
    verdict = verify(changed().diagram, trials=1)
    assert verdict.outcome == "proved", verdict.reason
    assert all(control.refuted for control in verdict.controls)
    reported = {(item.signal, item.says) for item in verdict.statements}
    assert ("a_d_hat", "consists of bodies, each not less than its fraction of the nominal one") in reported


@pytest.mark.parametrize(
    ("label", "value", "names"),
    [
        ("model.nominal", 4, ["true value inside the set of bodies"]),  # 0.3 of it exceeds the true value
        ("dynamics.floor", 1.01, ["starts inside the set of bodies"]),
        ("dynamics.floor", 1, []),
    ],
)
def test_a_true_body_or_a_start_below_the_floor_is_no_proof(label: str, value: float, names: list[str]) -> None:
    assert failing(**{label: value}) == [f"dynamics.a_d_hat: {name}" for name in names]


def test_a_nominal_body_that_is_invalid_is_no_proof() -> None:
    assert LAW in failing(**{"model.nominal": 0})


def test_a_run_from_below_the_floor_is_refused_with_the_link() -> None:
    experiment = dm.load("ur10_consistent").set({"dynamics.floor": 0.5})
    diagram = experiment.diagram
    start = np.concatenate([0.5 * np.array(diagram.robot.inertia, dtype=float).ravel(), np.zeros(6)])
    start_state(diagram, {**experiment.start, "dynamics.a_d_hat": start})
    start[10:20] *= 0.4
    with pytest.raises(StartError, match=r"start at floor times its nominal one or above, found that of link 2 below"):
        start_state(diagram, {**experiment.start, "dynamics.a_d_hat": start})


def _link(kept: Bodies) -> Any:
    return next(iter(kept._links()))


def _rest(column: Any, state: Any) -> Any:
    return ca.vertcat(column, ca.SX.zeros(state.numel() - 10))


def _with(kept: Bodies, **changed: Any) -> Bodies:
    return Bodies(**{"nominal": kept.nominal, "share": kept.share, **changed})


def _taken_whole(kept: Bodies, s: Any, v: Any) -> Any:
    """The whole rate if its diagonal points outwards, also along the boundary."""
    link = _link(kept)
    values, V = eigen(link.at(s[:10]))
    out = ca.if_else(values <= 0, 1, 0)
    D = V.T @ link.transformed(v[:10]) @ V
    return _rest(link.parameters(V @ ca.diag(ca.fmax(-out * ca.diag(D), 0)) @ V.T), s)


LAWS: dict[str, Callable[..., Any]] = {
    "never stops": lambda b, s, v: 0 * v,
    "stops inside too": lambda b, s, v: -v,
    "takes too little": lambda b, s, v: Bodies.law(b, s, v) / 2,
    "takes what leads in": lambda b, s, v: Bodies.law(b, s, -v),
    "pushes out": lambda b, s, v: -Bodies.law(b, s, v),
    "looks at one direction at a time": _taken_whole,
    "begins above": lambda b, s, v: Bodies.law(_with(b, share=2 * b.share), s, v),
    "begins below": lambda b, s, v: Bodies.law(_with(b, share=b.share / 2), s, v),
    "is normal at another body": lambda b, s, v: Bodies.law(_with(b, nominal=b.nominal * ca.SX([2, *([1] * 9)])), s, v),
    "moves the friction": lambda b, s, v: Bodies.law(b, s, v) + ca.vertcat(ca.SX.zeros(10), 1e-3 * ca.SX.ones(1)),
    "has a branch far out": lambda b, s, v: Bodies.law(b, s, v) + ca.if_else(s > 1e6, 1, 0),
    "is no number": lambda b, s, v: Bodies.law(b, s, v) * ca.sqrt(-b.share),
}
HELD: dict[str, Callable[..., Any]] = {
    "holds nothing": lambda b, s: s,
    "goes to the nominal body": lambda b, s: _rest(b.nominal, s) + 0 * s,
    "clips at zero": lambda b, s: Bodies.held(_with(b, share=ca.SX(0)), s),
    "clips in the metric of the coordinates": lambda b, s: (
        s + _rest(_with(b, nominal=_unit())._all_estimates([_Unit.row(positive_part(-_link(b).at(s[:10])))], s[:10]), s)
    ),
    "shrinks": lambda b, s: 0.999 * Bodies.held(b, s),
    "reflects": lambda b, s: 2 * Bodies.held(b, s) - s,
    "moves the friction": lambda b, s: Bodies.held(b, s) * ca.vertcat(ca.SX.ones(10), 0.5),
}


class _Unit:
    """The body whose pseudo-inertia is 1."""

    @staticmethod
    def row(X: Any) -> Any:
        from dmframe.diagram.bodies import row

        return row(X)


def _unit() -> Any:
    return _Unit.row(ca.SX.eye(4))


FAULTS = [
    *(("law", name, fault) for name, fault in LAWS.items()),
    *(("held", name, fault) for name, fault in HELD.items()),
]


@pytest.mark.parametrize(("method", "name", "fault"), FAULTS, ids=[f"{method} {name}" for method, name, _ in FAULTS])
def test_a_fault_in_a_law_takes_the_proof(method: str, name: str, fault: Any) -> None:
    del name
    loop, projection = projected()
    wrong = type("Wrong", (Bodies,), {method: fault})(projection.set.nominal, projection.set.share)  # type: ignore[union-attr]
    assert not check_law(replace(projection, set=wrong), loop).holds


def test_another_metric_than_that_of_the_nominal_bodies_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    """Law and storage function remain a pair with a correct identity, but the projection is not the nearest point."""
    import dmframe.diagram.resolve as resolve

    def other(nominal: Any, share: Any) -> Bodies:
        return Bodies(nominal * ca.vertcat(2, ca.SX.ones(nominal.numel() - 1)), share)

    monkeypatch.setattr(resolve, "Bodies", other)
    assert "dynamics.a_d_hat: projected in the metric of V" in failing()


class Moving(AbstractBlock):
    """Its nominal bodies change with time."""

    inputs = (Input("q", "n", "rad"), Input("a_d_nominal", "p", ""))
    outputs = (Output("a_d_other", "p", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"a_d_other": u.a_d_nominal * (1 + u.q[0] * u.q[0])})


def test_nominal_bodies_that_move_are_refused() -> None:
    experiment = changed()
    blocks = {**experiment.blocks, "other": Moving()}
    wires = {**(experiment.file.wires or {}), "dynamics.a_d_nominal": "other.a_d_other"}
    with pytest.raises(DmframeError, match="floor requires constant nominal bodies, but a_d_nominal is not constant"):
        Diagram.build(blocks, wires, experiment.robot)


class Undeclared(AbstractBlock):
    """A set of bodies without half of its data."""

    inputs = (Input("a_d_nominal", "p", ""),)
    states = (State("a", "p", bodies="flor", nominal="a_nominal"),)
    floor: Scalar = Positive(default=1.0)
    other: Scalar = Real(default=1.0)


def test_a_set_of_bodies_names_its_share_and_its_nominal_bodies() -> None:
    texts = [fault.text for fault in Undeclared.contract("undeclared")]
    assert any("of bodies of a is flor, which is not a Positive parameter; did you mean floor" in t for t in texts)
    assert any("nominal bodies of a are a_nominal, which is not an input;" in t for t in texts)
