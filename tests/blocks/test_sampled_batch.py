"""Runs of least squares in a batch; and the factorisation that it uses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from sampled_arm2 import sampled_arm2

import dmframe as dm
import dmframe.simulate.engine
from dmframe.batch.batch import Batch
from dmframe.block.linalg import inverse_factors, inverting
from dmframe.build.compiler import find_compiler
from dmframe.simulate.engine import FRACTIONS, SCALES, TAME, Trial


@pytest.fixture(scope="module")
def batch() -> Batch:
    graph = sampled_arm2(servo="p_pi", estimator="least_squares", retention=0.99, delay=2)
    graph["blocks"]["line"] = {"type": "transport_delay", "samples": 2}
    made = dm.load(graph)
    return Batch.of(made.diagram, 0.2, engine="compiled", **made.settings)


@pytest.mark.parametrize("scales", [SCALES, SCALES[:1]])
def test_a_library_is_tried_at_states_with_moderate_results(
    scales: tuple[float, ...], batch: Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dmframe.simulate.engine, "SCALES", scales)
    step = replace(batch.prepared.step, parts=batch._parts)
    trial = Trial.of(step, 1 + 0.01 * np.arange(8), after=1)
    results = [np.abs(item.full()).max() for run in range(8) for item in trial.tick(trial.states[:, run], run)]
    assert len(trial.given) == 2
    assert np.finfo(float).eps * TAME < 1e-9  # the absolute tolerance, for elements that are zero up to rounding
    assert (max(results) < TAME) == (scales == SCALES)  # large random numbers do not form a positive definite matrix


def test_a_longer_share_of_the_period_is_taken_where_the_shorter_one_overflows(
    batch: Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    period = float(batch.prepared.step.period)
    assert Trial.of(batch.prepared.step).step.period == pytest.approx(FRACTIONS[0] * period)
    overflows = property(lambda trial: trial.step.period > 1.01 * FRACTIONS[0] * period)
    monkeypatch.setattr(Trial, "_moderate", overflows)
    assert Trial.of(batch.prepared.step).step.period == pytest.approx(FRACTIONS[1] * period)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_its_runs_go_into_a_simd_batch(batch: Batch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path))
    assert batch.measure({"inverse.nu": [1e-5, 1e-4]}).engine.startswith("SIMD batch of ")


@pytest.mark.parametrize("n", [1, 2, 7])
def test_the_factors_multiply_to_the_inverse_and_their_pivots_are_assumed_positive(n: int) -> None:
    A, rows = ca.SX.sym("A", n, n), np.random.default_rng(n).normal(size=(n + 1, n))
    with inverting() as inverted:
        factors = inverse_factors(A)
    M, N = (np.asarray(item) for item in ca.Function("factors", [A], [*factors])(rows.T @ rows))
    np.testing.assert_allclose(M.T @ N @ rows.T @ rows, np.eye(n), atol=1e-10)
    np.testing.assert_array_equal(M, np.tril(M, -1) + np.eye(n))
    assert [len(item.pivots) for item in inverted] == [n]
