"""The linearised loop as a flow with held inputs, against the sampled linearisation, and its intervals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import dmframe as dm
from dmframe.analysis import held_linearised as module
from dmframe.analysis import linearise, linearised_period
from dmframe.analysis.held import HeldLoop, held_loop
from dmframe.analysis.held_linearised import held_linearised, linearised_interval
from dmframe.analysis.held_proof import prove_clock
from dmframe.analysis.held_storage import HeldSearch, find_storage, proved_interval
from dmframe.common.errors import DisagreementError
from dmframe.exact.ball_matrix import middles
from dmframe.exact.balls import UndecidedError
from dmframe.report.clock_text import clock_text


@cache
def linear(name: str) -> Any:
    graph = dm.load(name)
    return linearise(graph.diagram, start=graph.start, moving=True, clock=graph.clock)


@cache
def loop(name: str) -> HeldLoop:
    graph = dm.load(name)
    return held_linearised(graph.diagram, linear(name), graph.clock or 0.01, moving=True)


def radius(loop: HeldLoop, period: float) -> float:
    """Spectral radius of the map of the moving coordinates over one sample."""
    A, E, (C, D) = middles(loop.A), middles(loop.E), map(middles, loop.grown)
    after = expm(np.block([[A, E], [C, D]]) * period)[: len(A), : len(A)]
    return float(np.max(np.abs(np.linalg.eigvals(after))))


@pytest.mark.parametrize("name", ["arm2_joint", "joint_tracking_pi", "ur10_fast", "pd_torque"])
def test_its_map_over_a_sample_is_that_of_the_sampled_linearisation(name: str) -> None:
    for period in (0.0005, 0.003, 0.01, 0.02):
        assert radius(loop(name), period) == pytest.approx(linear(name).spectral_radius(period), abs=1e-6)


@pytest.mark.parametrize("name", ["arm2_joint", "joint_tracking_pi"])
def test_the_interval_is_below_the_first_unstable_period_and_covers_the_clock(name: str) -> None:
    graph = dm.load(name)
    found = linearised_interval(graph.diagram, graph.clock, start=graph.start)
    assert found is not None
    assert graph.clock is not None
    assert graph.clock < found < linearised_period(linear(name)).stable


def test_of_a_linear_loop_it_is_the_interval_of_the_loop() -> None:
    whole = find_storage(held_loop(dm.load("pd_torque").diagram)).interval
    assert find_storage(loop("pd_torque")).interval == pytest.approx(whole, rel=1e-3)


def test_seeded_faults_leave_no_interval() -> None:
    own = loop("arm2_joint")
    storage = find_storage(own)
    assert proved_interval(own, storage) == pytest.approx(storage.interval)
    assert own.rates is not None
    longer = replace(storage, beta=storage.beta / 1.4, gamma=storage.gamma / 1.4)
    assert proved_interval(own, longer) == 0
    assert proved_interval(replace(own, K=2 * own.K), storage) == 0  # another growth of the held error
    assert proved_interval(replace(own, rates=(own.rates[0], 2 * own.rates[1])), storage) == 0
    assert proved_interval(replace(own, E=2 * own.E), storage) == 0


def test_an_interval_that_floating_point_contradicts_is_withdrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = dm.load("pd_torque")
    longer = replace(find_storage(loop("pd_torque")), interval=0.9)
    monkeypatch.setattr(module, "find_storage", lambda _: longer)
    with pytest.raises(DisagreementError, match=r"withdrawn: sampled every 0\.9 s, it is unstable in floating point"):
        linearised_interval(graph.diagram, graph.clock, start=graph.start)


def test_a_search_without_a_first_solution_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HeldSearch, "longest", lambda *_: 0.0)
    for name in ("pd_torque", "joint_tracking_pi"):
        with pytest.raises(UndecidedError, match="no storage function of the form that is searched falls"):
            find_storage(loop(name))


def test_the_reason_is_printed_where_the_linearisation_has_none() -> None:
    graph = dm.load("slotine_li").set({"dynamics.leak": 0.1})
    found = replace(prove_clock(graph.diagram, graph.clock, start=graph.start), linearised=None)
    text = clock_text(replace(found, linearised_reason="too many"))
    assert "linearised at its set-point it has no such interval: too many" in text


def test_sampled_laws_and_many_held_signals_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = dm.load("ur10_slow_sampled")
    with pytest.raises(UndecidedError, match="the loop is not emulated: a block looks ahead"):
        held_linearised(graph.diagram, linear("arm2_joint"), 0.09)
    monkeypatch.setattr(module, "MOST", 5)
    with pytest.raises(UndecidedError, match="6 signals are held; the search is limited to 5"):
        held_linearised(dm.load("arm2_joint").diagram, linear("arm2_joint"), 0.002, moving=True)


@pytest.mark.parametrize("excess", [1, 20])
def test_a_compensation_of_friction_that_destabilises_at_rest_leaves_no_interval(excess: float) -> None:
    """The slope of the compensation at rest multiplies the gain of the position error; when moving it is zero."""
    friction = [5, 5, 2, *(excess * np.array([8, 8, 4]))]
    changes = {"model.nominal": 1, "dynamics.a_d_hat_box": None, "dynamics.a_d_hat": [*[0] * 30, *friction]}
    gains = {"dynamics.Gamma": 1, "inverse.w": [1 / 800, 1 / 800, 1 / 400], "inverse.w_box": None}
    graph = dm.load("joint_tracking_bounded").set({**changes, **gains})
    moving, at_rest = (linearise(graph.diagram, start=graph.start, moving=m, clock=0.002) for m in (True, False))
    assert moving.spectral_radius(0.15) < 1
    assert (at_rest.spectral_radius(0.15) < 1) == (excess == 1)
    if excess == 1:
        assert linearised_interval(graph.diagram, 0.002, start=graph.start) > 0.15
    else:
        with pytest.raises(UndecidedError, match="with the slope of Coulomb friction at rest it is unstable"):
            linearised_interval(graph.diagram, 0.002, start=graph.start)
