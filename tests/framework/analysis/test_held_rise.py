"""States from which V of a certificate rises on every fast clock, against runs; and the page of `verify --clock`."""

from __future__ import annotations

import json
from functools import cache

import casadi as ca
import jsonschema
import numpy as np
import pytest

import dmframe as dm
from dmframe.analysis.held_proof import prove_clock
from dmframe.analysis.held_rise import Rise, _Search, rise_of
from dmframe.block.model import SYMBOLIC
from dmframe.certify.claim import claim_of
from dmframe.certify.schema import verdict_schema
from dmframe.graph.graph import Graph


@cache
def still(name: str) -> Graph:
    """A packaged graph on a path at rest."""
    return dm.load(name).set({"path.amplitude": 0})


def found(graph: Graph, kappa: float = 1.0) -> Rise | None:
    with graph.placing(), SYMBOLIC:
        return rise_of(claim_of(graph.diagram, held=False, named=False), kappa=kappa, start=graph.start)


@pytest.mark.parametrize("name", ["slotine_li", "joint_tracking_pi", "joint_tracking_pid"])
def test_v_of_a_run_rises_by_rho_times_the_squared_interval(name: str) -> None:
    graph = still(name)
    kappa = graph.verify().verdict.kappa
    assert kappa is not None
    rise = found(graph, kappa.chosen)
    assert rise is not None
    assert rise.rho > 0
    for period in (1e-5, 2e-5):
        run = graph.set({"clock": period, "start": rise.state}).run(until=2 * period)
        V = run["V"].values
        np.testing.assert_allclose((V[1] - V[0]) / (rise.rho * period**2 / 2), 1, atol=0.05)


def test_without_adaptation_there_is_no_such_state() -> None:
    assert found(dm.load("pd_torque")) is None
    assert found(dm.load("computed_torque")) is None


def test_the_rate_of_an_estimate_is_named() -> None:
    rise = found(still("slotine_li"))
    assert rise is not None
    assert rise.because == "d dynamics.a_d_hat/dt"


def test_the_state_is_inside_the_boxes_of_the_estimates() -> None:
    rise = found(still("joint_tracking_pi"))
    assert rise is not None
    assert all(0 < value < 0.004 for value in rise.state["inverse.w"])
    assert all(-8 < value < 15 for value in rise.state["dynamics.a_d_hat"])


def test_a_loop_over_samples_or_with_a_residual_has_none() -> None:
    assert found(dm.load("ur10_slow_sampled")) is None
    assert found(dm.load("slotine_li").set({"dynamics.leak": 0.1})) is None


def test_a_dissipation_with_an_edge_at_rest_leaves_no_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of friction that is a sign: V then has a share of the first order in the velocity, which may outweigh rho."""
    honest = _Search._dissipation

    def edged(self: _Search) -> ca.SX:
        (dq,) = (v.symbol for v in self._loop.flowing if v.name == "dq")
        return honest(self) + ca.sum1(ca.fabs(dq))

    assert found(still("slotine_li")) is not None
    monkeypatch.setattr(_Search, "_dissipation", edged)
    assert found(still("slotine_li")) is None


def test_verify_prints_the_interval_next_to_the_clock() -> None:
    found = dm.load("pd_torque").verify(clock=True)
    text = str(found)
    assert "  clock 2 ms: proved on a clock for all sampling intervals up to 684 ms, equal or not\n" in text
    assert found.summary["sampling"]["covers_clock"] is True
    jsonschema.validate(json.loads(json.dumps(found.summary)), verdict_schema())
    slow = str(dm.load("pd_torque").set(clock="700 ms").verify(clock=True))
    assert (
        "clock 700 ms: proved on a clock for all sampling intervals up to 684 ms, equal or not: the clock is slower"
        in slow
    )


def test_verify_prints_why_a_loop_is_not_proved_on_its_clock() -> None:
    found = dm.load("arm2_joint").verify(clock=True)
    text = str(found)
    assert (
        "  clock 2 ms: not proved on a clock: the law is not linear: dynamics.a_d_hat is projected onto a set" in text
    )
    assert "V rises over every short sampling interval T" in text
    linearised = "linearised at its set-point, a storage function falls for all intervals up to 3.01 ms, equal or not"
    assert linearised in " ".join(text.split())
    assert found.summary["sampling"]["interval"] is None
    assert 0.003 < found.summary["sampling"]["linearised"] < 0.0031
    jsonschema.validate(json.loads(json.dumps(found.summary)), verdict_schema())
    assert "sampling" not in dm.load("pd_torque").verify().summary


def test_a_loop_without_a_certificate_may_have_an_interval() -> None:
    graph = dm.load("pd_torque")
    assert prove_clock(graph.diagram, None).interval == prove_clock(graph.diagram, 0.002).interval
    assert not prove_clock(graph.diagram, None).covers_clock


def test_the_restriction_to_continuous_time_is_printed_only_where_it_holds() -> None:
    graph, says = dm.load("pd_torque"), "sampling every 2 ms is not covered"
    assert says in " ".join(str(graph.verify()).split())
    assert says not in " ".join(str(graph.verify(clock=True)).split())
